"""Memory of a process and its helpers, against what they allocate."""

from __future__ import annotations

import subprocess
import sys

import pytest

from clalign.benchmark import memory
from clalign.benchmark.memory import PeakMemory

MIB = 2**20
HOLD = "import sys; held = bytearray(b'1') * (int(sys.argv[1]) << 20); print(flush=True); sys.stdin.read()"


def holding(mebibytes: int) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(mebibytes)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    process.stdout.readline()
    return process


needs_proc = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")


@needs_proc
@pytest.mark.parametrize("together", [True, False])
def test_helpers_at_the_same_time_add_up(monkeypatch: pytest.MonkeyPatch, together: bool) -> None:
    monkeypatch.setattr(memory, "PERIOD", 1000.0)
    with PeakMemory() as watched:
        watched._look()
        own = watched._sum
        helpers = []
        for _ in range(2):
            helpers.append(holding(400))
            # A process counts from the second look at it.
            watched._look()
            watched._look()
            if not together:
                helpers[-1].communicate()
        for helper in helpers[: 2 * together]:
            helper.communicate()
    assert watched.peak is not None
    expected = 400 * MIB * len(helpers) if together else 400 * MIB
    assert expected <= watched._sum - own < 1.3 * expected
    assert watched.peak >= watched._sum


@needs_proc
def test_a_peak_between_two_looks_is_not_missed_in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "PERIOD", 1000.0)
    before = memory._status_bytes("self", "VmRSS")
    with PeakMemory() as watched:
        held = bytearray(b"1") * (200 * MIB)
        del held
    assert watched.peak is not None
    assert watched.peak >= before + 150 * MIB


def test_without_proc_it_is_an_upper_bound(
    monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    pytest.importorskip("resource")
    monkeypatch.setattr(memory, "PROCESSES", tmp_path_factory.mktemp("empty"))
    monkeypatch.setattr(memory, "processor_count", lambda: 8)
    with PeakMemory() as watched:
        holding(300).communicate()
    assert watched.peak is not None
    assert watched.peak >= 2 * 300 * MIB
