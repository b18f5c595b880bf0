"""What a collection is measured by: seconds with different workers, equality of maps, errors before and after."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clalign.collection.cluster import shared_out
from clalign.collection.result import Collection
from clalign.collection.rows import PairRow
from clalign.collection.run import Progress, match_collection
from clalign.collection.store import PairMaps
from clalign.errors import ClalignError, OptionError
from clalign.evaluation.errors import evaluate
from clalign.evaluation.pairs import TruthFiles
from clalign.geometry.mesh import Mesh, load_mesh
from clalign.options import Options

RunName = Literal["one", "two", "scheduler", "star", "tree"]
RUNS: tuple[RunName, ...] = ("one", "two", "scheduler", "star", "tree")
TIMES_FILE = "bench.json"
START_SECONDS = 60.0


@dataclass(frozen=True)
class RunTimes:
    """Seconds of one run: by the clock, and of the work on all workers together.

    Attributes
    ----------
    wall : by the clock; None for a run that was interrupted and gone on with.
    shapes, pairs, consistent : of the work, by stage.
    """

    run: str
    workers: int
    wall: float | None
    shapes: float
    pairs: float
    consistent: float

    @property
    def busy(self) -> float | None:
        """Share of the workers' time that was work."""
        return None if self.wall is None else (self.shapes + self.pairs + self.consistent) / (self.workers * self.wall)


@dataclass(frozen=True)
class Errors:
    """Errors of some maps: `means` is the mean geodesic error of each in sqrt(area), `flipped` how many are flips."""

    maps: str
    means: tuple[float, ...]
    flipped: int | None

    def text(self) -> str:
        """Return a row of the table."""
        values = 100 * np.array(self.means)
        flips = "not known" if self.flipped is None else str(self.flipped)
        errors = f"{values.mean():.3f} | {np.median(values):.3f} | {values.max():.3f}"
        return f"| {self.maps} | {len(values)} | {flips} | {errors} |"


def run_one(
    name: RunName, shapes: Path, folder: Path, options: Options, progress: Progress | None = None
) -> tuple[Collection, RunTimes]:
    """Make one of the runs in its own folder, with its own prepared shapes; a run that is complete is only read.

    "one" and "two" match all pairs with so many local workers, "scheduler" with two workers started as on other
    machines, "star" and "tree" match few pairs with two workers and derive the others.
    """
    if name not in RUNS:
        raise OptionError(f"unknown run {name!r}; there are {', '.join(RUNS)}")
    out, known = folder / name, folder / name / TIMES_FILE
    if known.is_file():
        return Collection.load(out), RunTimes(**json.loads(known.read_text(encoding="utf-8")))
    again = out.exists()
    workers = 1 if name == "one" else 2
    pairs = name if name in ("star", "tree") else "all"
    with hand_started(workers) if name == "scheduler" else contextlib.nullcontext() as address:
        started = time.perf_counter()
        collection = match_collection(
            shapes,
            out,
            options,
            pairs=pairs,
            scheduler=address,
            workers=None if address else workers,
            resume=again,
            progress=progress,
        )
        wall = time.perf_counter() - started
    times = RunTimes(name, workers, None if again else wall, *_work(collection))
    known.write_text(json.dumps(asdict(times)) + "\n", encoding="utf-8")
    return collection, times


def _work(collection: Collection) -> tuple[float, float, float]:
    direct = sum(row.seconds or 0.0 for row in direct_rows(collection))
    every = sum(row.seconds or 0.0 for row in collection.pairs)
    return sum(row.seconds or 0.0 for row in collection.shapes), direct, every - direct


def direct_rows(collection: Collection) -> list[PairRow]:
    """Return the rows of the pairs as they were matched, without what the network made of them."""
    rows = []
    for source, target in collection.store.pair_names("pairs"):
        folder = collection.store.pair_folder("pairs", source, target)
        rows.append(PairRow(**json.loads((folder / "pair.json").read_text(encoding="utf-8"))["row"]))
    return rows


@contextlib.contextmanager
def hand_started(workers: int) -> Iterator[str]:
    """Start a scheduler and workers in processes of their own, as on other machines; yield the address.

    Raises
    ------
    ClalignError
        The scheduler did not start.
    """
    environment = {**os.environ, **shared_out(workers)}
    with tempfile.TemporaryDirectory(prefix="clalign-dask-") as folder, contextlib.ExitStack() as stack:
        file = Path(folder) / "scheduler.json"

        def start(program: str, *arguments: str) -> None:
            process = subprocess.Popen(
                [sys.executable, "-m", f"distributed.cli.{program}", "--scheduler-file", str(file), *arguments],
                env=environment,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            stack.callback(process.wait)
            stack.callback(process.terminate)

        start("dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        limit = time.monotonic() + START_SECONDS
        while not file.is_file():
            if time.monotonic() > limit:
                raise ClalignError(f"the Dask scheduler did not start within {START_SECONDS:.0f} s")
            time.sleep(0.05)
        for _ in range(workers):
            start("dask_worker", "--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", folder)
        yield str(json.loads(file.read_text(encoding="utf-8"))["address"])


def different_maps(first: Collection, second: Collection) -> list[str]:
    """Return the pairs whose matched maps differ in any bit between two collections, or that only one has."""
    names = set(first.store.pair_names("pairs")) | set(second.store.pair_names("pairs"))
    return [" ".join(pair) for pair in sorted(names) if not _equal(first, second, pair)]


def _equal(first: Collection, second: Collection, pair: tuple[str, str]) -> bool:
    try:
        ours, theirs = (collection.store.read_maps("pairs", *pair) for collection in (first, second))
    except ClalignError:
        return False
    fields = ("target_of_source", "source_of_target", "functional_map")
    return all(np.array_equal(getattr(ours, name), getattr(theirs, name)) for name in fields)


def measured(
    title: str,
    collection: Collection,
    rows: Sequence[PairRow],
    maps_of: Callable[[PairRow], PairMaps],
    points: int,
) -> Errors:
    """Measure maps against the truth that lies beside the meshes, in the layout of the humans.

    ``X.truth.txt`` beside every mesh X (line i of any two is the same point), else vertex i is vertex i; ``mirror.txt``
    tells flips.
    """
    paths = {row.name: Path(row.path) for row in collection.shapes}
    meshes: dict[str, Mesh] = {}
    means, flips = [], []
    for row in sorted(rows, key=lambda row: (row.source, row.target)):
        for name in (row.source, row.target):
            meshes.setdefault(name, load_mesh(paths[name]))
        source, target = meshes[row.source], meshes[row.target]
        truth, mirrored = _truth(paths[row.source], paths[row.target]).read(source, target)
        forward: NDArray[Any] = maps_of(row).target_of_source
        found = evaluate(forward, truth, source=source, target=target, mirrored=mirrored, points=points)
        means.append(found.mean)
        flips.append(found.flipped)
    known = [flip for flip in flips if flip is not None]
    return Errors(title, tuple(means), sum(known) if known else None)


def _truth(source: Path, target: Path) -> TruthFiles:
    mirror = source.parent / "mirror.txt"
    lines = [path.with_name(f"{path.stem}.truth.txt") for path in (source, target)]
    if all(path.is_file() for path in lines):
        return TruthFiles("lines", lines[0], lines[1], mirror if mirror.is_file() else None)
    return TruthFiles("identity", mirror=mirror if mirror.is_file() else None)


def error_rows(name: str, collection: Collection, points: int) -> list[Errors]:
    """Return the errors of a run: of the maps as matched, and of those that it ends with."""
    store = collection.store
    matched = [row for row in direct_rows(collection) if row.ok]
    final = [row for row in collection.pairs if row.ok]
    return [
        measured(
            f"{name}, as matched",
            collection,
            matched,
            lambda row: store.read_maps("pairs", row.source, row.target),
            points,
        ),
        measured(f"{name}, consistent", collection, final, store.final_maps, points),
    ]


def times_table(times: Sequence[RunTimes], differing: dict[str, int]) -> str:
    """Return the table of seconds, and of maps that differ from those of the first run."""
    lines = [
        "| run | workers | seconds | shapes | pairs | consistency | workers busy | maps that differ |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for entry in times:
        wall = "resumed" if entry.wall is None else f"{entry.wall:.0f}"
        busy = "" if entry.busy is None else f"{entry.busy:.0%}"
        work = f"{entry.shapes:.0f} | {entry.pairs:.0f} | {entry.consistent:.0f}"
        lines.append(f"| {entry.run} | {entry.workers} | {wall} | {work} | {busy} | {differing.get(entry.run, '')} |")
    return "\n".join(lines)


def errors_table(errors: Sequence[Errors]) -> str:
    """Return the table of errors."""
    head = "| maps | pairs | flipped | mean | median | worst |\n|---|---:|---:|---:|---:|---:|"
    return "\n".join([head, *(entry.text() for entry in errors)])
