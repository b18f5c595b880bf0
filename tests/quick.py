"""A match that takes a fraction of a second, and what a command left behind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from skips import backend

#: Few functions, no search, one short round: every stage runs, none for long.
QUICK = [
    *(
        "--no-picture",
        "--no-report",
        "--quiet",
        "--set",
        "search.method=random",
        "--set",
        "alignment.outer_iterations=1",
    ),
    *("--set", "alignment.iterations=5", "--set", "spectrum.scale_invariant=24", "--set", "spectrum.basis=16"),
    *("--set", "spectrum.refinement=16", "--set", "geodesics.search_samples=60", "--set", "readout.steps=0"),
]


class Shown(NamedTuple):
    """What a command left: its exit status and what it printed."""

    status: int
    out: str
    err: str


Run = Callable[..., Shown]


def device() -> list[str]:
    """Arguments of commands that are to run on any machine: none, or numpy where there is no OpenCL device."""
    return [] if backend() == "opencl" else ["--device", "reference"]


def left_in(folder: Path) -> list[str]:
    """Names of all files and folders below, hidden ones too."""
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))
