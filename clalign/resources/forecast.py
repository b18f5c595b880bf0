"""Time and memory of a match, predicted from the sizes of its arrays before anything is computed.

Memory is a sum over the arrays that are alive at the same time in each stage, in bytes, with the factors of the sparse
matrices estimated from the number of vertices. Time is a sum over the loops of each stage, operations divided by rates
that were measured on one core of a server processor of 2021 (`RATES`); expect it to be right within a factor of two,
and too long for a GPU. Kernels that are built for the first time take some ten seconds more.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clalign.alignment.soft_map import evaluation_cost
from clalign.errors import MemoryBudgetError
from clalign.geometry.geodesics import affordable_samples
from clalign.geometry.heat_process import WORTH_A_PROCESS
from clalign.geometry.workers import processor_count
from clalign.options import Options
from clalign.resources.growth_cost import growth_operations, pieces_are_grown

_DOUBLE, _INDEX = 8, 4

RESULT = "result"
"""The stage that draws and writes; what is computed is complete before it."""


@dataclass(frozen=True)
class Sizes:
    """Lengths of the arrays of a match, after the caps of small meshes.

    Attributes
    ----------
    source, target : vertices.
    basis : k, functions of the functional map.
    functions : Laplace–Beltrami functions computed in all.
    descriptors : d.
    samples : S, geodesic samples, of the larger mesh.
    rows : N, samples with full rows.
    losses : vertices where the losses are evaluated.
    """

    source: int
    target: int
    basis: int
    functions: int
    descriptors: int
    samples: int
    rows: int
    losses: int

    @property
    def rank(self) -> int:
        """Rank r of the distance factors."""
        return max(self.rows // 2, 1)

    @property
    def both(self) -> int:
        """Vertices of the two meshes together."""
        return self.source + self.target


@dataclass(frozen=True)
class Forecast:
    """What a match will need.

    Attributes
    ----------
    host : bytes of the process and its helpers without what lies on the device, by stage.
    device : bytes in buffers of the device, by stage.
    largest_buffer : bytes of the largest one.
    stages : seconds by stage, on the processors of this machine.
    shared : the device computes in the memory of the process (a CPU), so that both count together.
    """

    host: Mapping[str, int]
    device: Mapping[str, int]
    largest_buffer: int
    stages: Mapping[str, float]
    shared: bool

    @property
    def memory(self) -> int:
        """Peak bytes of the processes, with the pictures of ``clalign match``."""
        return max(self._process_bytes(stage) for stage in self.host)

    @property
    def match_memory(self) -> int:
        """Peak bytes of the processes until the result is there."""
        return max(self._process_bytes(stage) for stage in self.host if stage != RESULT)

    def _process_bytes(self, stage: str) -> int:
        return self.host[stage] + (self.device.get(stage, 0) if self.shared else 0)

    @property
    def device_memory(self) -> int:
        """Peak bytes in buffers of the device."""
        return max(self.device.values(), default=0)

    @property
    def seconds(self) -> float:
        """Time of the whole match, the sum over `stages`."""
        return sum(self.stages.values())


def sizes(source: int, target: int, options: Options) -> Sizes:
    """Return the lengths of the arrays of a match of two meshes with so many vertices."""
    smaller, larger = min(source, target), max(source, target)
    spectrum, geodesics = options.spectrum, options.geodesics
    cap = max(smaller // 3, 1)
    samples = affordable_samples(larger, geodesics.search_samples, geodesics.factor_samples)
    wanted = options.alignment.samples
    on_all = wanted == 0 or wanted >= source or samples >= source
    return Sizes(
        source=source,
        target=target,
        basis=min(spectrum.basis, spectrum.descriptors, cap),
        functions=min(max(spectrum.basis, spectrum.refinement), cap),
        descriptors=min(spectrum.descriptors, cap),
        samples=samples,
        rows=min(geodesics.factor_samples, samples),
        losses=source if on_all else min(wanted, samples),
    )


BASE_BYTES = 220 * 2**20
"""Interpreter, libraries, a CPU driver and the code of the kernels."""
PICTURE_BYTES = 850 * 2**20
"""Drawing ``match.png`` and the page, beside what the result itself takes."""
FILL = 40.0
"""Entries of a sparse factor per vertex and unit of log2(vertices) / 10."""
HELPER_BYTES = 55 * 2**20
"""A second interpreter with what the heat method imports."""
HEAT_BYTES = 3100.0
"""Of the heat method, per vertex and unit of log2(vertices) / 10, while it factorises: two matrices and its mesh."""
RETAINED = 1.3
"""Temporaries of numpy and what the allocator keeps of arrays that are gone, as a share of the arrays, ..."""
MOST_RETAINED = 350 * 2**20
"""... and at most: memory of large arrays goes back to the system at once."""

RATES: Mapping[str, float] = {
    "eigensolver": 4e9,
    "factorisation": 1e9,
    "distances": 2e6,
    "search": 600.0,
    "losses": 45e9,
    "nearest": 60e9,
    "dense": 30e9,
}
"""On one core and a second: floating-point operations; for "distances" vertices, for "search" samples.

Measured with `progress` of `match` and the processor's clock, on bumpy spheres of 642 to 40,962 vertices; "dense" and
`SPARED` on human bodies of 6,890 and generated ones of 25,000.
"""
FIXED_SECONDS = {"start": 2.0, "picture": 10.0}
SPARED = 2500
"""Vertices from which on points are given up before all functions are compared: the more there are, the earlier."""
KRYLOV = 2.5
"""Columns of the eigensolver's basis for every wanted pair."""
SLICE = 176
"""Pairs that the eigensolver finds with one factorisation."""


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
    size = sizes(source, target, options)
    real = 8 if options.engine.precision == "double" or options.engine.backend == "reference" else 4
    cores = processor_count() if processors is None else processors
    host, device = _host_bytes(size, options, cores), _device_bytes(size, options, real)
    largest = real * max(size.source, size.target) * size.descriptors
    return Forecast(host, device, largest, _seconds(size, options, cores), shared)


def _factor_bytes(vertices: int) -> float:
    """Return the bytes of one sparse factorisation of a matrix over the mesh (L and U)."""
    return 2 * (_DOUBLE + _INDEX) * FILL * vertices * math.log2(max(vertices, 2)) / 10


def _kept_bytes(size: Sizes, vertices: int) -> float:
    """Return the bytes of one prepared shape: mesh, spectra, distances, factors and point descriptors."""
    columns = size.functions + size.descriptors + size.rank + 0.5 * size.rows + 30
    return _DOUBLE * (vertices * columns + 2.0 * size.samples**2)


def _distance_bytes(size: Sizes, options: Options, cores: int) -> tuple[float, float]:
    """Return the bytes of the heat method of as many meshes as are at work at a time: in this process, and in helpers.

    An answer lies in this process twice when it comes: as it was sent, and as arrays, which are kept.
    """
    here, elsewhere = [], []
    for vertices in (size.source, size.target):
        samples = affordable_samples(vertices, options.geodesics.search_samples, size.rows)
        heat = HEAT_BYTES * vertices * math.log2(max(vertices, 2)) / 10 + _INDEX * samples * vertices
        helped = cores > 1 and samples * vertices >= WORTH_A_PROCESS
        here.append(_INDEX * (size.rows * vertices + samples**2) if helped else heat)
        elsewhere.append(HELPER_BYTES + heat if helped else 0.0)
    at_a_time = sum if cores > 1 else max
    return at_a_time(here), at_a_time(elsewhere)


def _host_bytes(size: Sizes, options: Options, cores: int) -> dict[str, int]:
    larger = max(size.source, size.target)
    kept = _kept_bytes(size, size.source) + _kept_bytes(size, size.target)
    slices = min(2, -(-size.descriptors // SLICE))
    krylov = slices * (KRYLOV * min(SLICE + 12, size.descriptors) * _DOUBLE * larger + _factor_bytes(larger))
    # Rows of all slices, joined, orthonormal and in the order of the mesh; one set is part of `kept` already.
    joined = 3.0 * _DOUBLE * larger * size.descriptors
    distances, helpers = _distance_bytes(size, options, cores)
    prepare = kept + max(krylov, joined) + distances
    # Descriptors with signs, the contiguous part of the basis, and two products that are read out.
    aligned = _DOUBLE * size.both * (2 * size.descriptors + size.basis + 2 * size.rank) + kept
    # The page and the arrays in single precision, while the result is still there.
    saved = kept + _INDEX * size.both * (size.basis + size.descriptors)
    stages = {"preparation": prepare, "alignment": aligned, RESULT: saved}
    if pieces_are_grown(options):
        # Functions in single precision, and the embeddings that the last step compares, in both.
        stages["up-sampling"] = kept + size.both * (4 * size.functions + (4 + 12) * size.descriptors)
    peaks = {stage: int(BASE_BYTES + held + min(RETAINED * held, MOST_RETAINED)) for stage, held in stages.items()}
    # What a helper holds was measured with what its allocator keeps.
    beside = {"preparation": int(helpers), RESULT: PICTURE_BYTES}
    return {stage: peak + beside.get(stage, 0) for stage, peak in peaks.items()}


def _device_bytes(size: Sizes, options: Options, real: int) -> dict[str, int]:
    """Return bytes of buffers: descriptors (one carried over, too), bases, packed moments, and a read-out's scratch.

    A read-out holds two embeddings (n, d), their copies in order, and one of them packed.
    """
    pairs = size.basis * (size.basis + 1) // 2
    fixed = pairs * size.rank + 12 * size.descriptors**2 + size.losses * (3 * size.basis + 4 * size.rank)
    meshes = size.both * (size.descriptors + size.basis + size.rank) + size.source * size.descriptors
    read_out = (2 * size.both + max(size.source, size.target)) * size.descriptors
    search = 3 * 200 * 40 * 400 + 2 * size.samples**2
    stages = {"preparation": 0, "alignment": real * (fixed + meshes + read_out + search), RESULT: 0}
    if pieces_are_grown(options):
        uploaded = size.both * (size.functions + size.descriptors)
        stages["up-sampling"] = real * (uploaded + read_out + search)
    return stages


def _seconds(size: Sizes, options: Options, cores: int) -> dict[str, float]:
    eigen, rows = 0.0, 0.0
    for vertices in (size.source, size.target):
        for count in (size.functions, size.descriptors):
            eigen += _eigensolver_seconds(vertices, count)
        rows += vertices * affordable_samples(vertices, options.geodesics.search_samples, size.rows)
    evaluations = options.alignment.outer_iterations * (options.alignment.iterations + 3) + 1
    soft_map = evaluation_cost(size.losses, size.target, size.basis, size.rank)
    # A multiplication and an addition each, and half as much again for the products around the soft map.
    evaluation = 3.0 * (soft_map[0] if options.alignment.cycle else min(soft_map))
    evaluation += 20.0 * size.descriptors**2 * size.basis
    read_outs = 2 + options.alignment.outer_iterations + options.readout.steps
    functions = size.descriptors * read_outs + (0 if pieces_are_grown(options) else size.functions)
    nearest = 4.0 * size.source * size.target * functions / math.sqrt(max(min(size.source, size.target) / SPARED, 1.0))
    alignment = evaluations * evaluation / RATES["losses"] + nearest / RATES["nearest"]
    grown, dense = growth_operations(size, options)
    search = 0.0 if options.search.method == "random" else size.samples / RATES["search"]
    metric = 0.0
    if options.spectrum.metric == "auto":
        tried = len(options.rules.alignment.exponents) - 1
        metric = tried * sum(_eigensolver_seconds(each, size.descriptors) for each in (size.source, size.target))
    return {
        "start": FIXED_SECONDS["start"],
        "preparation": max(rows / RATES["distances"], eigen / min(cores, 2)),
        "search": search / cores,
        "up-sampling": (grown / RATES["nearest"] + dense / RATES["dense"]) / cores,
        "metric": metric / min(cores, 2),
        "alignment": alignment / cores,
        RESULT: FIXED_SECONDS["picture"],
    }


def _eigensolver_seconds(vertices: int, count: int) -> float:
    """Return the time of block Lanczos: basis, Ritz vectors and solves of every slice, and factorisations."""
    slices = -(-count // SLICE)
    wanted = count / slices + 12
    columns = KRYLOV * wanted
    entries = _factor_bytes(vertices) / (_DOUBLE + _INDEX)
    steps = vertices * (2 * columns**2 + 2 * columns * wanted) + 4 * entries * columns
    return slices * (steps / RATES["eigensolver"] + 3 * entries**1.5 / vertices**0.5 / RATES["factorisation"])


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
        "use --preset fast, fewer functions (spectrum.descriptors, spectrum.refinement), a decimated mesh, or a larger "
        "engine.memory"
    )
    counts = f"a match of {source:,} with {target:,} vertices"
    if limit and predicted.match_memory > limit:
        raise MemoryBudgetError(
            f"{counts} needs about {_mib(predicted.match_memory)}, {origin} {_mib(limit)}; {way_out} if you know better"
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
                f"{counts} needs about {_mib(needed)} {what}, {device.get('device', 'which')} has {_mib(available)}; "
                f"{way_out}; or another device: clalign doctor lists them, --device reference uses numpy"
            )
    return predicted


def _mib(size: int) -> str:
    return f"{size / 2**30:.1f} GiB" if size >= 2**30 else f"{size / 2**20:.0f} MiB"
