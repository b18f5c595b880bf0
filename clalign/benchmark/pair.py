"""Time and memory of whole pairs, each match in a fresh process, so that imports and program builds count."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clalign.benchmark.generated import generated_pair
from clalign.benchmark.pair_process import Request
from clalign.benchmark.performance import bytes_text, exponent_text, fitted_exponent, seconds_text
from clalign.benchmark.table import markdown_table
from clalign.errors import ClalignError
from clalign.mesh.writing import save_mesh
from clalign.options import Options
from clalign.storage.files import KERNEL_VARIABLE

START = "start"
"""Stage of the interpreter and its imports: what a process takes beside the match."""

WARM_UP_VERTICES = 1000


@dataclass(frozen=True)
class PairTime:
    """One match in one process.

    label : what ran, "cold cache".
    seconds : from the start of the process to its end.
    stages : seconds of each stage; `START` is what no stage covers.
    work : seconds of processor time in all threads, which other processes hardly change.
    peak : most bytes held, helper processes included, or None; see `memory.PeakMemory`.
    device : where the arithmetic ran.
    """

    label: str
    seconds: float
    stages: dict[str, float]
    work: float
    peak: int | None
    device: str


@dataclass(frozen=True)
class ScaleTime:
    """One generated pair: vertices of each mesh, its time, and the mean distance to the true vertex in sqrt(area)."""

    vertices: int
    time: PairTime
    error: float


def timed_process(request: Request, label: str, environment: Mapping[str, str]) -> PairTime:
    """Run one match in a new process, with some variables of its environment changed.

    Raises
    ------
    ClalignError
        The match failed; the message is the last line that it left.
    """
    with tempfile.TemporaryDirectory(prefix="clalign-") as folder:
        file = Path(folder) / "request.json"
        file.write_text(json.dumps(asdict(request)), encoding="utf-8")
        command = [sys.executable, "-W", "ignore", "-m", f"{__package__}.pair_process", str(file)]
        start = time.perf_counter()
        done = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, **environment})
        seconds = time.perf_counter() - start
    if done.returncode != 0:
        last = (done.stderr.strip() or f"status {done.returncode}").splitlines()[-1]
        raise ClalignError(f"{label}: the match of {request.source} with {request.target} failed: {last}")
    answer = json.loads(done.stdout.splitlines()[-1])
    stages = {START: seconds - sum(answer["stages"].values()), **answer["stages"]}
    return PairTime(label, seconds, stages, answer["work"], answer["peak"], answer["device"])


@contextmanager
def _empty_driver_caches() -> Iterator[dict[str, str]]:
    """Yield variables that give OpenCL programs a cache of their own, empty at first."""
    with tempfile.TemporaryDirectory(prefix="clalign-") as folder:
        drivers = Path(folder) / "pocl"
        drivers.mkdir()
        yield {KERNEL_VARIABLE: str(drivers), "XDG_CACHE_HOME": folder}


def measure_pair(
    source: str | Path,
    target: str | Path,
    options: Options,
    repeats: int = 3,
    peer: bool = False,
    watch: Callable[[PairTime], None] = lambda _: None,
) -> list[PairTime]:
    """Time a pair of files: the first match ever on the machine, then in turn with a cold and a warm shape cache.

    Parameters
    ----------
    repeats : rounds of cold and warm (and of pyFM); of each the run of median time is returned.
    peer : whether pyFM matches the pair as well, in the same rounds.
    watch : called after every match.

    Returns
    -------
    list
        "first use", in which OpenCL programs are built too, "cold cache", "warm cache" and, with `peer`, "pyFM".
    """
    files, values = (str(source), str(target)), options.as_dict()
    runs: dict[str, list[PairTime]] = {}
    with _empty_driver_caches() as environment, tempfile.TemporaryDirectory(prefix="clalign-") as folder:

        def run(label: str, method: str = "clalign", cache: str = "") -> None:
            found = timed_process(Request(*files, method, values, cache), label, environment)
            runs.setdefault(label, []).append(found)
            watch(found)

        run("first use", cache=str(Path(folder) / "first"))
        for number in range(repeats):
            cache = str(Path(folder) / str(number))
            run("cold cache", cache=cache)
            run("warm cache", cache=cache)
            if peer:
                run("pyFM", method="pyfm")
    return [sorted(times, key=lambda one: one.seconds)[(len(times) - 1) // 2] for times in runs.values()]


def measure_scale(
    sizes: Sequence[int], options: Options, seed: int = 0, watch: Callable[[ScaleTime], None] = lambda _: None
) -> list[ScaleTime]:
    """Time generated pairs of several numbers of vertices without a shape cache, programs being built beforehand.

    `watch` is called after every match.
    """
    times = []
    with _empty_driver_caches() as environment:
        _generated_match(min(WARM_UP_VERTICES, *sizes), options, seed, environment)
        for size in sizes:
            found = _generated_match(size, options, seed, environment)
            times.append(found)
            watch(found)
    return times


def _generated_match(size: int, options: Options, seed: int, environment: Mapping[str, str]) -> ScaleTime:
    pair = generated_pair(size, seed)
    with tempfile.TemporaryDirectory(prefix="clalign-") as folder:
        files = Path(folder) / "source.ply", Path(folder) / "target.ply"
        for file, mesh in zip(files, (pair.source, pair.target), strict=True):
            save_mesh(file, mesh.vertices, mesh.faces)
        found = Path(folder) / "map.npy"
        request = Request(str(files[0]), str(files[1]), "clalign", options.as_dict(), map=str(found))
        taken = timed_process(request, f"{size:,} vertices", environment)
        target_of_source: NDArray[np.int64] = np.load(found)
    vertices = pair.target.vertices
    missed = vertices[target_of_source] - vertices[pair.truth.target_points]
    return ScaleTime(size, taken, float(np.linalg.norm(missed, axis=1).mean()))


def stage_names(times: Sequence[PairTime]) -> list[str]:
    """Return the names of all stages in the order in which they first appear."""
    return list(dict.fromkeys(name for one in times for name in one.stages))


def stage_exponents(times: Sequence[ScaleTime]) -> dict[str, float | None]:
    """Return p of the fit seconds ∝ n^p for every stage, for "total" and for "work"."""
    sizes = [one.vertices for one in times]
    names = stage_names([one.time for one in times])
    stages = {name: [one.time.stages.get(name, 0.0) for one in times] for name in names}
    totals = {"total": [one.time.seconds for one in times], "work": [one.time.work for one in times]}
    return {name: fitted_exponent(sizes, seconds) for name, seconds in (stages | totals).items()}


def pair_table(times: Sequence[PairTime], stages: bool = True) -> str:
    """Return a Markdown table with a column for every run, and a row for every stage unless only totals are wanted."""
    rows = [
        [name, *("–" if name not in one.stages else seconds_text(one.stages[name]) for one in times)]
        for name in (stage_names(times) if stages else [])
    ]
    rows.append(["**total**", *(f"**{seconds_text(one.seconds)}**" for one in times)])
    rows.append(["processor time", *(seconds_text(one.work) for one in times)])
    rows.append(["peak memory", *(bytes_text(one.peak) for one in times)])
    reference = next((one.seconds for one in times if one.label == "pyFM"), None)
    if reference is not None:
        rows.append(["pyFM's time over it", *(f"{reference / one.seconds:.2f}×" for one in times)])
    return markdown_table(["stage" if stages else "", *(one.label for one in times)], rows)


def scale_table(times: Sequence[ScaleTime]) -> str:
    """Return a Markdown table with a row for every size and one for the fitted exponents."""
    names = stage_names([one.time for one in times])
    rows = [
        [
            f"{one.vertices:,}",
            *(seconds_text(one.time.stages.get(name, 0.0)) for name in names),
            f"**{seconds_text(one.time.seconds)}**",
            seconds_text(one.time.work),
            bytes_text(one.time.peak),
            f"{100 * one.error:.2f}",
        ]
        for one in times
    ]
    exponents = stage_exponents(times)
    rows.append(["fit", *(exponent_text(exponents[name]) for name in [*names, "total", "work"]), "", ""])
    return markdown_table(["n", *names, "total", "processor", "peak memory", "error × 100"], rows, text_columns=0)
