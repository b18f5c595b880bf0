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

from clalign.correspondence import Correspondence
from clalign.storage import recover

PROGRAM = [sys.executable, "-m", "clalign.cli.main"]
SMALL = ["--preset", "fast", "--set", "geodesics.search_samples=200"]


def command(files: tuple[Path, ...], out: Path, *extra: str) -> list[str]:
    return [*PROGRAM, "match", str(files[0]), str(files[1]), "--out", str(out), *SMALL, *extra]


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
        process.send_signal(signal.SIGKILL)
        process.wait(timeout=60)
        # Nothing there at all is the only right answer beside a whole result.
        recover(out)
        if out.exists():
            Correspondence.load(out)
    done = subprocess.run(command(bumpy_files, out, "--quiet", "--force", "--no-report"), check=False, timeout=300)
    assert done.returncode == 0
    assert Correspondence.load(out).source.n_vertices == 642
    assert hidden(tmp_path) == []


@pytest.mark.parametrize(("stage", "delay"), [("source", 0.0), ("prepare", 0.2), ("alignment", 0.3)])
def test_interrupt_keeps_the_best_or_says_that_there_is_nothing(
    tmp_path: Path, bumpy_files: tuple[Path, ...], stage: str, delay: float
) -> None:
    out = tmp_path / "result"
    extra = ["--set", "alignment.rounds=50", "--set", "alignment.iterations=1000", "--no-report", "--no-picture"]
    process = subprocess.Popen(
        command(bumpy_files, out, *extra),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    assert process.stderr is not None
    while not process.stderr.readline().startswith(stage):
        assert process.poll() is None
    time.sleep(delay)
    process.send_signal(signal.SIGINT)
    shown, errors = process.communicate(timeout=300)
    assert "Traceback" not in errors
    if process.returncode == 0:
        assert "warning: interrupted: " in errors
        assert any(warning.startswith("interrupted") for warning in Correspondence.load(out).warnings)
        assert "confidence" in shown
    else:
        # Python ends itself by the signal (a shell shows 130 for that, too) if it interrupted some `exec` of a library.
        assert process.returncode in (130, -signal.SIGINT)
        assert errors.splitlines()[-1].startswith("interrupted")
        assert not out.exists()
    assert hidden(tmp_path) == []
