"""The most memory that this process and those that it starts hold together, and their processor time."""

from __future__ import annotations

import os
import sys
import threading
from pathlib import Path

from clalign.geometry.workers import processor_count

PERIOD = 0.05
"""Seconds between two looks: a helper's work takes many, and a look less than a thousandth."""
PROCESSES = Path("/proc")


def processor_seconds() -> float:
    """Return the processor time of this process since it began: of all its threads and of the children that ended."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


class PeakMemory:
    """Watches memory while its ``with`` block runs; `peak` is final after it.

    Where there is ``/proc``, it is the largest sum, over moments `PERIOD` apart, of what this process and its children
    hold, and at least what this process has held by itself at any moment. Pages that they share, such as the code of
    libraries, count once for each. A child's child is not counted; clalign starts none. Elsewhere it is an upper bound:
    the peak of this process and, for as many helpers as work at a time, that of the largest child. Where the system
    tells neither, as Windows, it is None.
    """

    def __init__(self) -> None:
        self._own = str(os.getpid())
        self._sum = 0
        self._children: dict[str, bool] = {}
        self._seen: set[str] = set()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> PeakMemory:
        if _has_proc():
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()

    @property
    def peak(self) -> int | None:
        """Bytes, or None where the system does not tell."""
        if _has_proc():
            return max(self._sum, _status_bytes(self._own, "VmHWM"))
        return _bound()

    def _watch(self) -> None:
        while not self._ended.wait(PERIOD):
            self._look()

    def _look(self) -> None:
        present = {entry for entry in os.listdir(PROCESSES) if entry.isdecimal()}
        # A process that is being started has the memory of its parent for a moment, so it counts from the second look.
        for number in (present & self._seen) - self._children.keys():
            self._children[number] = _status(number, "PPid") == self._own
        self._children = {number: child for number, child in self._children.items() if number in present}
        self._seen = present
        family = [self._own, *(number for number, child in self._children.items() if child)]
        self._sum = max(self._sum, sum(_status_bytes(number, "VmRSS") for number in family))


def _has_proc() -> bool:
    return (PROCESSES / "self" / "status").is_file()


def _status_bytes(number: str, wanted: str) -> int:
    return 1024 * int((_status(number, wanted) or "0").split()[0])


def _status(number: str, wanted: str) -> str | None:
    """Return a line of a process's status; None where it is gone, or has ended and holds nothing."""
    try:
        text = (PROCESSES / number / "status").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    return next((line.split(":")[1].strip() for line in text.splitlines() if line.startswith(f"{wanted}:")), None)


def _bound() -> int | None:
    try:
        import resource
    except ImportError:
        return None
    own, children = (resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return (own + min(2, processor_count()) * children) * (1 if sys.platform == "darwin" else 1024)
