"""Commands run in this process, a pair that matches in a fraction of a second, and a small disk."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import malformed
import pytest
import shapes
from quick import QUICK, Run, Shown

from clalign.cli import doctor
from clalign.cli.main import main


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command in this process."""

    def command(*arguments: str | Path) -> Shown:
        capsys.readouterr()
        status = main([str(argument) for argument in arguments])
        return Shown(status, *capsys.readouterr())

    return command


@pytest.fixture
def match(run: Run, pair: tuple[Path, Path]) -> Run:
    """Match two files (default: `pair`) with numpy and the quick options, into the folder `out`."""

    def command(out: Path, *extra: str, files: tuple[Path, Path] = pair, device: str = "reference") -> Shown:
        return run("match", *files, "--out", out, "--device", device, *QUICK, *extra)

    return command


@pytest.fixture(scope="session")
def pair(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two files of 162 vertices: a bumpy sphere and the same one bent."""
    folder = tmp_path_factory.mktemp("pair")
    vertices, faces = shapes.bumpy_sphere(2)
    target = shapes.write_off(folder / "target.off", shapes.bent(vertices, 0.3), faces)
    return shapes.write_off(folder / "source.off", vertices, faces), target


@pytest.fixture(scope="session")
def collection(tmp_path_factory: pytest.TempPathFactory) -> dict[str, malformed.MalformedFile]:
    """The files of every malformed mesh, by name."""
    return {case.name: case for case in malformed.write_collection(tmp_path_factory.mktemp("malformed"))}


@pytest.fixture
def facts(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Lines in place of the question to the drivers, which takes seconds."""
    lines = ["OpenCL: loader and driver", "next: a command"]
    monkeypatch.setattr(doctor, "brief", lambda message="": lines)
    return lines


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A folder on a file system of its own with room for 100 kB."""
    folder = tmp_path / "small-disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=100k", "tmpfs", str(folder)]
    if os.name != "posix" or os.geteuid() or subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("file systems cannot be mounted here")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)
