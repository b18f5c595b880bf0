"""Measurements of memory and time that the coefficients of `resources` are fitted to.

Peaks of memory do not depend on what else the machine does, and times are processor seconds, which that changes little.
"""

from __future__ import annotations

import multiprocessing
import tempfile
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import nnls

from clalign import resources
from clalign.benchmark.generated import generated_pair
from clalign.benchmark.memory import PeakMemory, processor_seconds
from clalign.benchmark.performance import Machine
from clalign.data import bundled_pair
from clalign.engine import open_backend
from clalign.geometry.shape import prepare_pair
from clalign.matching.loop import Clock
from clalign.matching.pair import match_shapes
from clalign.mesh.mesh import Mesh, load_mesh
from clalign.options import Options

SIZES = (1000, 4000, 10_000, 25_000)
"""Vertices of the generated pairs that are matched with default options."""
VARIED = 2500
VARIANTS: tuple[dict[str, Any], ...] = (
    {"engine.precision": "double"},
    {"engine.backend": "reference", "alignment.outer_iterations": 1},
    {"spectrum.scale_invariant": 700},
    {"spectrum.refinement": 600},
    {"spectrum.metric": "auto", "geodesics.search_samples": 300},
    {"search.method": "random", "alignment.samples": 0, "alignment.outer_iterations": 1},
    {"readout.refine": "none", "alignment.outer_iterations": 0, "readout.steps": 0},
    {"rules.rivals.doubtful": 1.1, "rules.rivals.slack": 1e9},
)
"""Changes of options whose cost is measured at `VARIED` vertices."""
WARM_UP = 1000
"""Vertices of a match that builds the programs, which takes memory and time of its own."""
IN_DOUBT = (1000, 10_000)
"""Vertices of the generated pairs that are matched as if the search were in doubt, with as many rivals as there are."""
STAGES = {"read": "start", "device": "start", "start of R": "alignment", "read-out": "alignment"}
"""Stage of the forecast that a stage of a match counts to, where it is not one itself."""

Draw = Callable[[Any, Path], None]


@dataclass(frozen=True)
class Measured:
    """One match in a process of its own.

    name : of the pair, "generated" or "bundled".
    vertices : of source and target.
    changes : of the default options.
    memory : peak bytes of the process and its helpers.
    device_memory : peak bytes in buffers of the device; 0 where there is none.
    work : processor seconds by stage of the forecast.
    serial : of these without `resources.SERIAL`, those of the thread that called; others take part in the rest.
    """

    name: str
    vertices: tuple[int, int]
    changes: dict[str, Any]
    memory: int
    device_memory: int
    work: dict[str, float]
    serial: float


def measurements(draw: Draw | None, watch: Callable[[Measured], None] = lambda _: None) -> list[Measured]:
    """Measure generated pairs of all `SIZES`, all `VARIANTS`, choices of pairs in doubt, and the bundled pair.

    `draw` writes what ``clalign match`` writes beside the result into a folder, of pairs with default options; `watch`
    is called after every match.
    """
    found = []
    for precision in ("single", "double"):
        measured("warm-up", _generated(WARM_UP), {"engine.precision": precision}, None)
    for name, meshes, changes in _plan():
        found.append(measured(name, meshes, changes, None if changes else draw))
        watch(found[-1])
    return found


def _plan() -> Iterator[tuple[str, tuple[Mesh, Mesh], dict[str, Any]]]:
    for size in SIZES:
        yield "generated", _generated(size), {}
    for changes in VARIANTS:
        yield "generated", _generated(VARIED), changes
    for size in IN_DOUBT:
        yield "generated", _generated(size), VARIANTS[-1]
    files = bundled_pair()
    yield "bundled", (load_mesh(files.source), load_mesh(files.target)), {}


def _generated(size: int) -> tuple[Mesh, Mesh]:
    problem = generated_pair(size)
    return problem.source, problem.target


def measured(name: str, meshes: tuple[Mesh, Mesh], changes: dict[str, Any], draw: Draw | None) -> Measured:
    """Match in a new process, draw if asked to, and return what it took."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_measured_here, name, meshes, changes, draw).result()


def _measured_here(name: str, meshes: tuple[Mesh, Mesh], changes: dict[str, Any], draw: Draw | None) -> Measured:
    options = Options().replace(changes)
    watch = _StageWork()
    clock = Clock(watch)
    with PeakMemory() as memory, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with clock.stage("start"):
            backend = open_backend(options.engine)
        begin = time.thread_time()
        with clock.stage("prepare"):
            shapes = prepare_pair(*meshes, options)
        result = match_shapes(*shapes, backend, options, clock)
        serial = round(time.thread_time() - begin, 2)
        watch("result")
        if draw is not None:
            with tempfile.TemporaryDirectory(prefix="clalign-") as folder:
                draw(result, Path(folder))
        watch("end")
    work = {stage: round(watch.seconds[stage], 2) for stage in resources.STAGES if stage in watch.seconds}
    if draw is None:
        del work["result"]
    device = getattr(backend, "device", None)
    vertices = meshes[0].n_vertices, meshes[1].n_vertices
    return Measured(name, vertices, changes, memory.peak or 0, device.most if device else 0, work, serial)


class _StageWork:
    """Processor seconds since the process began, of all threads and ended helpers, by stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._stage, self._before = "start", 0.0

    def __call__(self, stage: str, fraction: float = 0.0, message: str = "") -> None:
        now = processor_seconds()
        self.seconds[self._stage] = self.seconds.get(self._stage, 0.0) + now - self._before
        self._stage, self._before = STAGES.get(stage, stage), now


def fitted(found: Sequence[Measured]) -> dict[str, Any]:
    """Return the coefficients of `resources.terms`, and the share of the work that is done in parallel.

    Coefficients are not negative, and make the sum of squared relative errors least. Times are those on a device. The
    bundled pair is left out, so that it can show how good they are; matches that are made to choose among rivals tell
    only how long that takes, as their peak is another stage's.
    """
    fit = [one for one in found if one.name == "generated"]
    coefficients = {}
    on_device = [one for one in fit if one.device_memory]
    in_memory = [one for one in fit if one.changes != VARIANTS[-1]]
    buffers = [(_terms(one)[resources.DEVICE], one.device_memory) for one in in_memory if one.device_memory]
    coefficients[resources.DEVICE] = device = non_negative(buffers)
    host = []
    for one in in_memory:
        rows = _terms(one)
        beside = {resources.DEVICE: resources.weighted(rows[resources.DEVICE], device)}
        host.append((rows[resources.HOST] | beside, one.memory))
    coefficients[resources.HOST] = non_negative(host)
    for stage in resources.STAGES:
        coefficients[stage] = non_negative([(_terms(one)[stage], one.work.get(stage, 0.0)) for one in on_device])
    return {"coefficients": coefficients, "parallel": _parallel(fit)}


def _terms(one: Measured) -> dict[str, resources.Terms]:
    return resources.terms(*one.vertices, Options().replace(one.changes))


def non_negative(rows: Iterable[tuple[resources.Terms, float]]) -> dict[str, float]:
    """Return coefficients ≥ 0 of the weighted sums that are relatively nearest to the values (positive ones count)."""
    counted = [(found, value) for found, value in rows if value > 0 and any(found.values())]
    names = list(counted[0][0])
    matrix = np.array([[found[name] / value for name in names] for found, value in counted])
    # Columns of one length, as terms differ by orders of magnitude.
    lengths = np.linalg.norm(matrix, axis=0)
    lengths[lengths == 0] = 1.0
    solution, _ = nnls(matrix / lengths, np.ones(len(counted)))
    return {name: float(f"{value:.4g}") for name, value in zip(names, solution / lengths, strict=True)}


def _parallel(found: Sequence[Measured]) -> float:
    """Return p of Amdahl's law, seconds = work (1 − p + p / processors), from pairs with default options.

    The calling thread waits while others compute, so that what it does itself is the serial part.
    """
    default = [one for one in found if not one.changes]
    work = sum(seconds for one in default for stage, seconds in one.work.items() if stage not in resources.SERIAL)
    return round(1.0 - sum(one.serial for one in default) / work, 3)


def table(found: Sequence[Measured], machine: Machine) -> dict[str, Any]:
    """Return the content of `resources.TABLE`."""
    date = datetime.now(UTC).date().isoformat()
    return {"date": date, "machine": asdict(machine), **fitted(found), "measured": [asdict(one) for one in found]}
