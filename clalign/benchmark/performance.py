"""What all measurements of speed share: the machine they were made on, fitted exponents, and tables."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from clalign.geometry.workers import processor_count
from clalign.storage.files import size_text


@dataclass(frozen=True)
class Machine:
    """Where figures were measured.

    processor, processors : name and number of those that the process may use.
    system : operating system and architecture.
    versions : of Python and the libraries that compute.
    load : processes that wanted to run in the last minute, on average; None where the system does not tell.
    """

    processor: str
    processors: int
    system: str
    versions: dict[str, str]
    load: float | None

    def __str__(self) -> str:
        versions = ", ".join(f"{name} {version}" for name, version in self.versions.items())
        load = "" if self.load is None else f"; load average {self.load:.1f}"
        return f"{self.processor}, {self.processors} processors, {self.system}; {versions}{load}"


def this_machine() -> Machine:
    """Return the facts of this machine, the load as it is now."""
    versions = {"python": platform.python_version()}
    for name in ("numpy", "scipy", "pyopencl"):
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    system = f"{platform.system()} {platform.machine()}"
    return Machine(_processor_name(), processor_count(), system, versions, load)


def _processor_name() -> str:
    facts = Path("/proc/cpuinfo")
    if facts.is_file():
        for line in facts.read_text(encoding="utf-8", errors="replace").splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name":
                return value.strip()
    return platform.processor() or platform.machine()


def fitted_exponent(sizes: Sequence[float], seconds: Sequence[float]) -> float | None:
    """Return p of the least-squares fit of seconds ∝ sizes^p, or None without two different sizes."""
    if len(set(sizes)) < 2 or min(seconds) <= 0:
        return None
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


def elapsed(run: Callable[[], object]) -> float:
    """Return the seconds that a call takes."""
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def seconds_text(seconds: float) -> str:
    """Return a duration with three digits and a unit."""
    for unit, factor in (("s", 1.0), ("ms", 1e3)):
        if seconds * factor >= 1.0:
            return f"{seconds * factor:.3g} {unit}" if seconds * factor < 1000 else f"{seconds * factor:.0f} {unit}"
    return f"{seconds * 1e6:.3g} µs"


def bytes_text(size: int | None) -> str:
    """Return a number of bytes as people read it, or a dash."""
    return "–" if size is None else size_text(size)


def exponent_text(exponent: float | None) -> str:
    """Return an exponent of n, or a dash."""
    return "–" if exponent is None else f"n^{exponent:.2f}"
