"""What ``clalign match`` shows and writes, with the match itself replaced by a result made from the truth."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import pytest
from quick import device

import clalign
from clalign.cli.main import main
from clalign.correspondence import Correspondence
from clalign.errors import ConvergenceError, DeviceError, MemoryBudgetError
from clalign.mesh.mesh import Mesh
from clalign.options import Options

FILES = {"target_of_source.txt", "source_of_target.txt", "result.npz", "result.json"}


@pytest.fixture
def perfect(monkeypatch: pytest.MonkeyPatch, true_correspondence: Correspondence) -> list[Options]:
    """Replace the match by one that returns the truth; the list collects the options that it was called with."""
    seen: list[Options] = []

    def match(source: Mesh, target: Mesh, options: Options, *, progress: Any = None, **_: Any) -> Correspondence:
        seen.append(options)
        for stage in ("source", "target", "alignment"):
            for part in range(3):
                progress(stage, part / 2, f"loss {3 - part}")
        return dataclasses.replace(true_correspondence, source=source, target=target, options=options)

    monkeypatch.setitem(vars(clalign), "match", match)
    return seen


def failing(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    def match(*_: Any, **__: Any) -> Correspondence:
        raise error

    monkeypatch.setitem(vars(clalign), "match", match)


def arguments(files: tuple[Path, ...], out: Path, *extra: str) -> list[str]:
    plain = ["--no-picture", "--no-report", *device()]
    return ["match", str(files[0]), str(files[1]), "--out", str(out), *plain, *extra]


@pytest.mark.usefixtures("perfect")
@pytest.mark.usefixtures("opencl")
def test_summary_goes_to_stdout_and_progress_to_stderr(
    tmp_path: Path, bumpy_files: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments(bumpy_files, tmp_path / "out", "--truth", str(bumpy_files[2]))) == 0
    shown = capsys.readouterr()
    for word in ("device", "timings", "confidence", "error", "mean 0.000", "exact 100.0%", str(tmp_path / "out")):
        assert word in shown.out
    for word in (
        "device: 0:0",
        "bumpy-source.off",
        "642 vertices",
        "alignment",
        "loss",
        "warning: a warning with an umlaut: ü",
    ):
        assert word in shown.err
    assert "\x1b" not in shown.out + shown.err
    assert {path.name for path in (tmp_path / "out").iterdir()} == FILES | {"evaluation.json"}


@pytest.mark.usefixtures("perfect")
def test_json_is_one_document(
    tmp_path: Path, bumpy_files: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments(bumpy_files, tmp_path / "out", "--truth", str(bumpy_files[2]), "--json")) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["folder"] == str(tmp_path / "out")
    assert document["source"]["path"] == str(bumpy_files[0])
    assert document["evaluation"]["per_sqrt_area"]["mean"] == 0
    stored = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    assert stored.items() <= document.items()


@pytest.mark.usefixtures("perfect")
def test_quiet_shows_only_warnings(
    tmp_path: Path, bumpy_files: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments(bumpy_files, tmp_path / "out", "--quiet")) == 0
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err == "warning: a warning with an umlaut: ü\n"


@pytest.mark.usefixtures("opencl")
def test_named_arguments_and_set_reach_the_options(
    tmp_path: Path, bumpy_files: tuple[Path, ...], perfect: list[Options]
) -> None:
    extra = ["--preset", "fast", "--device", "cpu", "--seed", "5", "--orientation", "any", "--metric", "euclidean"]
    extra += ["--alternatives", "2", "--set", "alignment.weight=50", "--set", "spectrum.basis = 40", "--quiet"]
    assert main(arguments(bumpy_files, tmp_path / "out", *extra)) == 0
    expected = Options.preset("fast").replace(
        {
            "engine.device": "cpu",
            "seed": 5,
            "search.orientation": "any",
            "search.alternatives": 2,
            "spectrum.metric": "euclidean",
            "alignment.weight": 50,
            "spectrum.basis": 40,
        }
    )
    assert perfect == [expected]


@pytest.mark.usefixtures("perfect")
@pytest.mark.usefixtures("opencl")
def test_missing_device_is_told_before_the_match(
    tmp_path: Path, bumpy_files: tuple[Path, ...], perfect: list[Options], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments(bumpy_files, tmp_path / "out", "--device", "abacus")) == 1
    errors = capsys.readouterr().err
    assert "no OpenCL device matches 'abacus'; there are: 0:0" in errors
    assert "clalign doctor" in errors
    assert perfect == []


def test_device_reference_is_the_numpy_backend(
    tmp_path: Path, bumpy_files: tuple[Path, ...], perfect: list[Options]
) -> None:
    assert main(arguments(bumpy_files, tmp_path / "out", "--device", "reference", "--quiet")) == 0
    assert perfect[0].engine.backend == "reference"


@pytest.mark.usefixtures("perfect")
def test_force_replaces_and_the_default_refuses(tmp_path: Path, bumpy_files: tuple[Path, ...]) -> None:
    assert main(arguments(bumpy_files, tmp_path / "out", "--quiet")) == 0
    assert main(arguments(bumpy_files, tmp_path / "out", "--quiet")) == 2
    assert main(arguments(bumpy_files, tmp_path / "out", "--quiet", "--force")) == 0


@pytest.mark.usefixtures("perfect")
def test_picture_and_report_land_in_the_same_folder(tmp_path: Path, bumpy_files: tuple[Path, ...]) -> None:
    command = arguments(bumpy_files, tmp_path / "out", "--quiet")
    assert main([word for word in command if not word.startswith("--no-")]) == 0
    assert (tmp_path / "out" / "match.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "out" / "report.html").read_text(encoding="utf-8").lower().startswith("<!doctype html>")
    assert {path.name for path in (tmp_path / "out").iterdir()} == FILES | {"match.png", "report.html"}


@pytest.mark.usefixtures("perfect")
def test_failing_picture_does_not_cost_the_match(
    tmp_path: Path,
    bumpy_files: tuple[Path, ...],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fail(_: Correspondence, path: Path) -> None:
        path.write_bytes(b"half")
        raise ValueError("no colours left")

    monkeypatch.setattr("clalign.presentation.picture.save_match_picture", fail)
    command = arguments(bumpy_files, tmp_path / "out", "--quiet")
    assert main([word for word in command if word != "--no-picture"]) == 0
    assert "warning: match.png was not drawn: ValueError: no colours left\n" in capsys.readouterr().err
    assert {path.name for path in (tmp_path / "out").iterdir()} == FILES


@pytest.mark.parametrize(
    ("error", "status", "message"),
    [
        (DeviceError("no platform"), 1, "clalign doctor"),
        (MemoryBudgetError("needs 9 GB, there are 2"), 1, "needs 9 GB"),
        (ConvergenceError("residual 1e-3"), 1, "residual 1e-3"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (ZeroDivisionError("division by zero"), 1, "CLALIGN_DEBUG=1"),
        (MemoryError(), 1, "--preset fast"),
    ],
)
def test_failures_are_told_apart(
    tmp_path: Path,
    bumpy_files: tuple[Path, ...],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    status: int,
    message: str,
) -> None:
    failing(monkeypatch, error)
    assert main(arguments(bumpy_files, tmp_path / "out", "--quiet")) == status
    shown = capsys.readouterr()
    assert shown.out == ""
    assert message in shown.err
    assert "Traceback" not in shown.err
    assert not (tmp_path / "out").exists()
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


@pytest.mark.usefixtures("perfect")
def test_disk_full_is_a_failure_not_bad_input(
    tmp_path: Path,
    bumpy_files: tuple[Path, ...],
    capsys: pytest.CaptureFixture[str],
) -> None:
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, hard))
    try:
        assert main(arguments(bumpy_files, tmp_path / "out", "--quiet")) == 1
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert "nothing was left half-written" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
