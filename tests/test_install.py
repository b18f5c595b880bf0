"""Installed from a wheel or editable, clalign works outside its checkout and finds its kernels."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

PROBE = """
import clalign, clalign.data
from clalign.engine.programs import kernel_folder
names = sorted(path.name for path in kernel_folder().glob("*.cl"))
print(clalign.__file__)
print(" ".join(names))
print(all(path.is_file() for path in clalign.data.bundled_pair()))
"""


def run(*command: str | Path, cwd: Path = ROOT) -> str:
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(
        [str(part) for part in command], cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def fresh_environment(folder: Path) -> Path:
    """Make a virtual environment that sees this one's packages, but not its clalign; return its Python."""
    venv.create(folder, with_pip=False, symlinks=os.name == "posix")
    python = folder / ("bin" if os.name == "posix" else "Scripts") / "python"
    site = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=folder).strip())
    # A plain line adds the folder without reading the .pth files inside it, such as that of an editable clalign.
    (site / "packages.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    return python


def install(python: Path, *what: str) -> None:
    run(
        *(sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps", "--no-index"),
        *("--no-build-isolation", "--ignore-installed", *what),
    )


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    run(
        *(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-index", "--no-build-isolation"),
        *("--wheel-dir", folder, ROOT),
    )
    (built,) = folder.glob("*.whl")
    return built


def check_outside(python: Path, folder: Path, *, home: Path) -> None:
    where, kernels, data = run(python, "-c", PROBE, cwd=folder).splitlines()
    assert Path(where).is_relative_to(home)
    assert kernels.split() == sorted(path.name for path in (ROOT / "kernels").glob("*.cl"))
    assert data == "True"
    assert run(python.parent / "clalign", "--version", cwd=folder).startswith("clalign ")


def test_wheel_holds_package_kernels_and_data_and_nothing_else(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        assert archive.testzip() is None
    expected = {f"clalign/kernels/{path.name}" for path in (ROOT / "kernels").iterdir() if path.is_file()}
    assert expected
    assert expected <= names
    assert {"clalign/py.typed", "clalign/data/human_source.ply", "clalign/cli/main.py"} <= names
    assert {name.split("/")[0] for name in names if ".dist-info" not in name} == {"clalign"}
    assert wheel.stat().st_size < 2_000_000


def test_wheel_works_outside_the_checkout(wheel: Path, tmp_path: Path) -> None:
    python = fresh_environment(tmp_path / "env")
    install(python, str(wheel))
    check_outside(python, tmp_path, home=tmp_path / "env")


def test_editable_install_works_outside_the_checkout(tmp_path: Path) -> None:
    python = fresh_environment(tmp_path / "env")
    install(python, "--editable", str(ROOT))
    check_outside(python, tmp_path, home=ROOT)
