"""``clalign match`` as a process of its own on small meshes: results, interrupts and kills."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from quick import device
from skips import posix

from clalign.correspondence import Correspondence
from clalign.storage.folders import recover

PROGRAM = [sys.executable, "-m", "clalign.cli.main"]
ENDLESS = """
import sys
from clalign.matching import pair, stages
from clalign.cli.main import program
module, name = {"prepare": (pair, "prepare_pair"), "search": (stages, "find_isometry")}[sys.argv.pop(1)]
once = getattr(module, name)
def again_and_again(*arguments):
    while True:
        once(*arguments)
setattr(module, name, again_and_again)
program()
"""
SMALL = ["--preset", "fast", "--set", "geodesics.search_samples=200"]


def command(files: tuple[Path, ...], out: Path, *extra: str) -> list[str]:
    return [*PROGRAM, "match", str(files[0]), str(files[1]), "--out", str(out), *SMALL, *device(), *extra]


def hidden(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir() if path.name.startswith(".")]


def test_match_finds_the_map_and_writes_it(tmp_path: Path, bumpy_files: tuple[Path, ...]) -> None:
    out = tmp_path / "deep" / "result"
    done = subprocess.run(
        command(bumpy_files, out, "--truth", str(bumpy_files[2]), "--json", "--quiet"),
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document["evaluation"]["per_sqrt_area"]["mean"] < 0.04
    result = Correspondence.load(out)
    text = np.loadtxt(out / "target_of_source.txt", dtype=np.int64)
    np.testing.assert_array_equal(text, result.target_of_source)
    assert (out / "match.png").is_file()
    assert (out / "report.html").is_file()
    assert hidden(out.parent) == []


def test_killed_match_leaves_nothing_half_written(
    tmp_path: Path, bumpy_files: tuple[Path, ...], rng: np.random.Generator
) -> None:
    """Kill the process at moments around the writing of the result; what is there afterwards is whole."""
    out = tmp_path / "result"
    for delay in rng.uniform(0.0, 0.15, size=3):
        process = subprocess.Popen(command(bumpy_files, out, "--quiet", "--no-report", "--force"))
        limit = time.monotonic() + 300
        before = out.stat().st_mtime_ns if out.exists() else None
        while process.poll() is None and time.monotonic() < limit:
            started = hidden(tmp_path) or (out.exists() and out.stat().st_mtime_ns != before)
            if started:
                break
            time.sleep(0.002)
        time.sleep(delay)
        process.kill()
        process.wait(timeout=60)
        # Nothing there at all is the only right answer beside a whole result.
        recover(out)
        if out.exists():
            Correspondence.load(out)
    done = subprocess.run(command(bumpy_files, out, "--quiet", "--force", "--no-report"), check=False, timeout=300)
    assert done.returncode == 0
    assert Correspondence.load(out).source.n_vertices == 642
    assert hidden(tmp_path) == []


def interrupted(
    files: tuple[Path, ...], out: Path, stage: str, delay: float, endless: bool = False
) -> tuple[int, str, str]:
    """Match, press Ctrl-C `delay` seconds after `stage` has begun, and return the exit status and what was printed.

    An endless stage is repeated until the interrupt comes: on so small a pair it may be over before.
    """
    # Long enough for the interrupt to come in time, however busy the machine is.
    changes = (
        ["readout.steps=500"] if stage == "read-out" else ["alignment.outer_iterations=50", "alignment.iterations=1000"]
    )
    extra = [word for change in changes for word in ("--set", change)]
    words = command(files, out, *extra, "--no-report", "--no-picture")
    process = subprocess.Popen(
        [sys.executable, "-c", ENDLESS, stage, *words[len(PROGRAM) :]] if endless else words,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    with process:
        assert process.stderr is not None
        while not process.stderr.readline().startswith(stage):
            assert process.poll() is None
        time.sleep(delay)
        process.send_signal(signal.SIGINT)
        shown, errors = process.communicate(timeout=300)
    assert "Traceback" not in errors
    assert hidden(out.parent) == []
    return process.returncode, shown, errors


@posix
@pytest.mark.parametrize(("stage", "delay"), [("source", 0.0), ("prepare", 0.2), ("search", 0.0)])
def test_interrupt_before_the_first_map_leaves_nothing(
    tmp_path: Path, bumpy_files: tuple[Path, ...], stage: str, delay: float
) -> None:
    status, shown, errors = interrupted(bumpy_files, tmp_path / "result", stage, delay, endless=stage != "source")
    assert (status, shown) == (130, "")
    assert errors.splitlines()[-1] == "interrupted: there was nothing to keep yet"
    assert not (tmp_path / "result").exists()


@pytest.mark.parametrize(
    ("stage", "delay"), [("refinement", 0.0), ("start of R", 0.0), ("alignment", 0.3), ("read-out", 0.0)]
)
def test_interrupt_from_the_first_map_on_keeps_the_best(
    tmp_path: Path, bumpy_files: tuple[Path, ...], stage: str, delay: float
) -> None:
    status, shown, errors = interrupted(bumpy_files, tmp_path / "result", stage, delay)
    assert status == 0, errors
    assert "warning: interrupted: " in errors
    assert "confidence" in shown
    result = Correspondence.load(tmp_path / "result")
    assert result.warnings[0].startswith("interrupted: ")
    truth = np.loadtxt(bumpy_files[2], dtype=np.int64)
    missed = result.target.vertices[result.target_of_source] - result.target.vertices[truth]
    assert np.linalg.norm(missed, axis=1).mean() < 0.1
