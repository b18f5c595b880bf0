"""Memory and time of a match, predicted from its sizes before anything is computed.

Every prediction is a sum of a few terms in the numbers of vertices, functions and samples (`terms`), whose coefficients
``clalign bench forecast`` fits to matches that it measures, and keeps in `TABLE` together with what it measured. The
model does not follow the steps of a match: after a change of the method, run the command again.
"""

from __future__ import annotations

import functools
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clalign.errors import MemoryBudgetError
from clalign.geometry.geodesics import affordable_samples
from clalign.geometry.workers import processor_count
from clalign.maps.nearest import EXHAUSTIVE
from clalign.options import Options
from clalign.storage.files import size_text

TABLE = Path(__file__).resolve().parent / "data" / "forecast.json"
"""Coefficients, and the measurements that they were fitted to."""

HOST, DEVICE = "host", "device"
STAGES = ("start", "prepare", "search", "choice", "refinement", "metric", "alignment", "result")
"""Of the forecast: "start" has what comes before the meshes are prepared, "choice" is that of a pair in doubt with as
many rivals as there may be, "alignment" all between the map that is refined and the result, which "result" draws and
writes."""
SERIAL = ("start", "result")
"""Stages that one processor does."""

Terms = dict[str, float]


@dataclass(frozen=True)
class Forecast:
    """What a match will need.

    Attributes
    ----------
    memory : peak bytes of the process and its helpers, with what lies on the device where that computes in the memory
        of the process.
    device_memory : peak bytes in buffers of the device.
    largest_buffer : bytes of the largest one.
    stages : seconds by stage, as `STAGES`, on a processor such as the one of the calibration.
    """

    memory: int
    device_memory: int
    largest_buffer: int
    stages: Mapping[str, float]

    @property
    def seconds(self) -> float:
        """Time of the whole match, the sum over `stages` but for the choice, which only pairs in doubt need."""
        return sum(seconds for stage, seconds in self.stages.items() if stage != "choice")


def terms(source: int, target: int, options: Options) -> dict[str, Terms]:
    """Return the terms of bytes on the `HOST` and in buffers of the `DEVICE`, and of processor seconds by stage.

    Terms of bytes are bytes of arrays of that kind, so that their coefficients are about how many such arrays there are
    at a time; "cells" stands for copies in the order of the cells that a search in large sets looks into, "factors" for
    the n^1.5 operations that make a sparse factor.
    """
    spectrum, alignment = options.spectrum, options.alignment
    both, smaller = source + target, min(source, target)
    scale_invariant = _function_count(spectrum.scale_invariant, smaller)
    functions = _function_count(max(spectrum.basis, spectrum.refinement), smaller)
    basis = min(spectrum.basis, scale_invariant)
    wanted = options.geodesics.search_samples, options.geodesics.factor_samples
    samples = affordable_samples(max(source, target), *wanted)
    rows = min(wanted[1], samples)
    sampled = float(sum(n * affordable_samples(n, *wanted) for n in (source, target)))
    losses = min(alignment.samples or source, source)
    evaluations = alignment.outer_iterations * alignment.iterations + 1
    searched = float(options.search.method != "random")
    maps = searched * (1 + options.search.alternatives) * (options.readout.refine != "none")
    rivals = searched * options.rules.rivals.most
    real = _real_bytes(options)
    columns = both * (functions + scale_invariant + rows)
    cells = real * both * scale_invariant * (source * target > EXHAUSTIVE)
    return {
        HOST: {"fixed": 1.0, "functions": 8.0 * columns, "distances": 4 * sampled + 16 * samples**2},
        DEVICE: {"fixed": real, "functions": real * columns, "cells": cells, "samples": real * samples**2,
                 "losses": real * losses * (basis + rows), "rotation": real * scale_invariant**2},
        "start": {"fixed": 1.0, "vertices": both},
        "prepare": {"functions": both * (functions + scale_invariant), "distances": sampled, "factors": both**1.5},
        "search": {"fixed": searched, "samples": searched * samples},
        "choice": {"fixed": rivals, "functions": rivals * both * sum(options.rules.rivals.sizes)},
        "refinement": {"fixed": maps, "functions": maps * both * (functions + scale_invariant)},
        "metric": {"functions": both * scale_invariant * (spectrum.metric == "auto")},
        "alignment": {"losses": evaluations * losses * basis**2.0, "rotation": evaluations * scale_invariant**2.0,
                      "maps": both**1.25 * scale_invariant * (1 + options.readout.steps)},
        "result": {"fixed": 1.0, "vertices": both},
    }  # fmt: skip


def _function_count(wanted: int, vertices: int) -> int:
    """Return how many eigenfunctions there are of the smaller mesh: at most one for three vertices."""
    return min(wanted, max(vertices // 3, 1))


def _real_bytes(options: Options) -> int:
    """Return the bytes of a number on the device; numpy, which stands for one, computes in double precision."""
    return 8 if options.engine.precision == "double" or options.engine.backend == "reference" else 4


@functools.cache
def calibration() -> dict[str, Any]:
    """Return the content of `TABLE`."""
    found: dict[str, Any] = json.loads(TABLE.read_text(encoding="utf-8"))
    return found


def weighted(found: Terms, coefficients: Mapping[str, float]) -> float:
    """Return the sum of terms times their coefficients."""
    return sum(coefficients[name] * value for name, value in found.items())


def forecast(
    source: int, target: int, options: Options, *, shared: bool = True, processors: int | None = None
) -> Forecast:
    """Predict memory and time of a match.

    Parameters
    ----------
    source, target : vertices of the meshes.
    options : of the match.
    shared : whether the device uses the memory of the machine, as a CPU does.
    processors : number of cores; None for those of this machine.
    """
    table, found = calibration(), terms(source, target, options)
    coefficients = table["coefficients"]
    device = weighted(found[DEVICE], coefficients[DEVICE])
    memory = weighted(found[HOST] | {DEVICE: shared * device}, coefficients[HOST])
    scale_invariant = _function_count(options.spectrum.scale_invariant, min(source, target))
    cores = processor_count() if processors is None else processors
    # Amdahl: the share of the work that other processors take part in.
    pace = dict.fromkeys(STAGES, 1 - table["parallel"] + table["parallel"] / cores) | dict.fromkeys(SERIAL, 1.0)
    return Forecast(
        memory=int(memory),
        device_memory=int(device),
        largest_buffer=_real_bytes(options) * max(source, target) * scale_invariant,
        stages={stage: pace[stage] * weighted(found[stage], coefficients[stage]) for stage in STAGES},
    )


def available_memory() -> int | None:
    """Return the bytes that this machine can still give to a process, or None where it does not tell.

    The smaller of what the system has free and what a container's limit leaves.
    """
    found = [value for value in (_system_memory(), _group_memory()) if value is not None]
    return min(found, default=None)


def _system_memory() -> int | None:
    meminfo = Path("/proc/meminfo")
    if meminfo.is_file():
        for line in meminfo.read_text(encoding="ascii").splitlines():
            name, _, value = line.partition(":")
            if name == "MemAvailable":
                return int(value.split()[0]) * 1024
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return None


def _group_memory(folder: Path = Path("/sys/fs/cgroup")) -> int | None:
    """Return what the limit of the control group (version 2) leaves; caches that can be given back count as free."""
    try:
        limit, used = ((folder / name).read_text(encoding="ascii").strip() for name in ("memory.max", "memory.current"))
        statistics = dict(line.split() for line in (folder / "memory.stat").read_text(encoding="ascii").splitlines())
    except (OSError, ValueError):
        return None
    if not limit.isdigit():
        return None
    return int(limit) - int(used) + int(statistics.get("inactive_file", 0)) + int(statistics.get("active_file", 0))


def require_memory(source: int, target: int, options: Options, device: Mapping[str, Any] | None = None) -> Forecast:
    """Refuse a match that will not fit into memory, before anything is computed.

    Parameters
    ----------
    source, target : vertices of the meshes.
    options : of the match; `engine.memory` takes the place of what the machine has free.
    device : facts of the device (``describe()`` of a backend: "device", "kind", "memory", "largest_buffer"); None
        where numpy computes.

    Raises
    ------
    MemoryBudgetError
        Saying how much is needed, where, and what to change.
    """
    predicted = forecast(source, target, options, shared=device is None or device.get("kind") == "cpu")
    limit, origin = options.engine.memory, "engine.memory allows"
    if not limit:
        limit, origin = available_memory() or 0, "this machine has free"
    way_out = (
        "use --preset fast, fewer functions (spectrum.scale_invariant, spectrum.refinement), a decimated mesh, or a "
        "larger engine.memory"
    )
    counts = f"a match of {source:,} with {target:,} vertices"
    if limit and predicted.memory > limit:
        raise MemoryBudgetError(
            f"{counts} needs about {size_text(predicted.memory)}, {origin} {size_text(limit)}; "
            f"{way_out} if you know better"
        )
    if device is None:
        return predicted
    for needed, key, what in (
        (predicted.device_memory, "memory", "on the device"),
        (predicted.largest_buffer, "largest_buffer", "in one buffer"),
    ):
        available = int(device.get(key, 0))
        if available and needed > available:
            raise MemoryBudgetError(
                f"{counts} needs about {size_text(needed)} {what}, {device.get('device', 'which')} has "
                f"{size_text(available)}; {way_out}; or another device: clalign doctor lists them, "
                "--device reference uses numpy"
            )
    return predicted
