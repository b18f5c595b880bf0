"""``clalign bench --jobs 2`` as a process that is ended: its workers end with it, whatever they are at."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import datasets
import pytest
from waiting import wait_until

fcntl = pytest.importorskip("fcntl", reason="the test finds living workers by their locks")

BENCH = """
import sys
from datasets import EndlessMethod
from clalign.benchmark import methods
workers = sys.argv.pop()
methods.named_methods = lambda *arguments: [EndlessMethod(workers)]
from clalign.cli.main import program
program()
"""
TESTS = Path(__file__).resolve().parents[1]
PROJECT = TESTS.parent


def alive(workers: Path) -> list[str]:
    """Names of the files that a living process holds locked."""
    held = []
    for path in workers.iterdir():
        with path.open(encoding="ascii") as stream:
            try:
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                held.append(path.name)
    return held


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
@pytest.mark.parametrize("whole_group", [True, False])
def test_workers_end_with_the_run(tmp_path: Path, ending: signal.Signals, whole_group: bool) -> None:
    """A terminal sends Ctrl-C to the whole group of processes, `kill` to one."""
    datasets.write_poses(tmp_path / "egg", ["egg1", "egg2", "egg3"])
    workers = tmp_path / "workers"
    workers.mkdir()
    run = ["bench", "animals", str(tmp_path / "egg"), "--out", str(tmp_path / "out"), "--jobs", "2", str(workers)]
    process = subprocess.Popen(
        [sys.executable, "-c", BENCH, *run],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(TESTS), str(PROJECT)]),
        },
        start_new_session=True,
    )
    try:
        wait_until(lambda: len(alive(workers)) == 2 or process.poll() is not None)
        assert process.poll() is None
        (os.killpg if whole_group else os.kill)(process.pid, ending)
        shown, errors = process.communicate(timeout=120)
        wait_until(lambda: not alive(workers))
    finally:
        process.kill()
        process.communicate()
        for name in alive(workers):
            os.kill(int(name), signal.SIGKILL)
    assert shown == ""
    assert "Traceback" not in errors
    if ending == signal.SIGINT:
        assert process.returncode == 130
        assert errors.splitlines()[-1].startswith("warning: interrupted: what is done is in ")
    else:
        assert process.returncode == -ending
