"""What a collection is measured by: seconds with different workers, equality of maps, errors before and after."""

from __future__ import annotations

import contextlib
import json
import math
import os
import pickle
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

from clalign.benchmark.pairs import TruthFiles, mirror_file, truth_file
from clalign.benchmark.table import markdown_table
from clalign.collection.cluster import wait_for_workers, worker_environment
from clalign.collection.members import DIGEST_LETTERS, Member
from clalign.collection.result import Collection
from clalign.collection.run import DEFAULT_LATENT, NETWORK_BYTES, match_collection
from clalign.collection.store import CACHE_FOLDER, PairMaps, PairRow, ShapeRow
from clalign.collection.work import EIGENVALUES, Settings, match_members
from clalign.errors import ClalignError, OptionError
from clalign.evaluation.errors import evaluate
from clalign.matching.loop import Progress
from clalign.mesh.mesh import Mesh, load_mesh
from clalign.options import Options
from clalign.storage.files import size_text, write_text

RunName = Literal["one", "two", "scheduler", "star", "tree"]
RUNS: tuple[RunName, ...] = ("one", "two", "scheduler", "star", "tree")
FEW_PAIRS: tuple[RunName, ...] = ("star", "tree")
"""Runs that match few pairs and derive the others."""

TIMES_FILE = "bench.json"
START_SECONDS = 60.0


@dataclass(frozen=True)
class RunTimes:
    """Seconds of one run: by the clock, and of the work on all workers together.

    Attributes
    ----------
    run : name of the run.
    workers : how many worked at a time.
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


def run_names(text: str) -> tuple[RunName, ...]:
    """Return the runs of a comma-separated list.

    Raises
    ------
    OptionError
        There is no such run.
    """
    known = {str(name): name for name in RUNS}
    words = [word.strip() for word in text.split(",")]
    unknown = [word for word in words if word not in known]
    if unknown:
        raise OptionError(f"unknown run {unknown[0]!r}; there are {', '.join(RUNS)}")
    return tuple(known[word] for word in words)


def run_one(
    name: RunName, shapes: Path, folder: Path, options: Options, progress: Progress | None = None
) -> tuple[Collection, RunTimes]:
    """Make one of the runs in its own folder, with its own prepared shapes; a run that is complete is only read.

    "one" and "two" match all pairs with so many local workers, "scheduler" with two workers started as on other
    machines, "star" and "tree" match few pairs with two workers and derive the others.

    Raises
    ------
    OptionError
        The run is there with other options.
    """
    out, known = folder / name, folder / name / TIMES_FILE
    if known.is_file():
        collection = Collection.load(out)
        collection.store.check_options(options)
        return collection, RunTimes(**json.loads(known.read_text(encoding="utf-8")))
    again = out.exists()
    workers = 1 if name == "one" else 2
    pairs = name if name in FEW_PAIRS else "all"
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
    write_text(known, json.dumps(asdict(times)) + "\n")
    return collection, times


def _work(collection: Collection) -> tuple[float, float, float]:
    direct = sum(row.seconds or 0.0 for row in direct_rows(collection))
    every = sum(row.seconds or 0.0 for row in collection.pairs)
    return sum(row.seconds or 0.0 for row in collection.shapes), direct, every - direct


def direct_rows(collection: Collection) -> list[PairRow]:
    """Return the rows of the pairs as they were matched, without what the network made of them."""
    return [collection.store.row("pairs", *names) for names in collection.store.pair_names("pairs")]


@contextlib.contextmanager
def hand_started(workers: int) -> Iterator[str]:
    """Start a scheduler and workers in processes of their own, as on other machines; yield the address.

    Raises
    ------
    ClalignError
        The scheduler did not start.
    """
    environment = {**os.environ, **worker_environment(workers)}
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
        address = str(json.loads(file.read_text(encoding="utf-8"))["address"])
        wait_for_workers(address, workers)
        yield address


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
    seed: int,
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
            if name not in meshes:
                meshes[name] = load_mesh(paths[name])
        source, target = meshes[row.source], meshes[row.target]
        truth, mirrored = _truth(paths[row.source], paths[row.target]).read(source, target)
        forward: NDArray[Any] = maps_of(row).target_of_source
        found = evaluate(forward, truth, source=source, target=target, mirrored=mirrored, points=points, seed=seed)
        means.append(found.mean)
        flips.append(found.flipped)
    known = [flip for flip in flips if flip is not None]
    return Errors(title, tuple(means), sum(known) if known else None)


def _truth(source: Path, target: Path) -> TruthFiles:
    mirror = mirror_file(source.parent)
    own, other = (truth_file(path.parent, path.stem) for path in (source, target))
    files = TruthFiles(own, other, mirror)
    return TruthFiles(mirror=mirror) if files.missing() else files


def error_rows(name: str, collection: Collection, points: int, seed: int = 0) -> list[Errors]:
    """Return the errors of a run: of the maps as matched, and of those that it ends with.

    So many `points` of each pair are measured, drawn with `seed`.
    """
    store = collection.store
    return [
        measured(f"{name}, {kind}", collection, [row for row in rows if row.ok], maps_of, points, seed)
        for kind, rows, maps_of in (
            ("as matched", direct_rows(collection), lambda row: store.read_maps("pairs", row.source, row.target)),
            ("consistent", collection.pairs, store.final_maps),
        )
    ]


def times_table(times: Sequence[RunTimes], differing: dict[str, int]) -> str:
    """Return the table of seconds, and of maps that differ from those of the first run."""
    header = ("run", "workers", "seconds", "shapes", "pairs", "consistency", "workers busy", "maps that differ")
    rows = [
        [
            one.run,
            str(one.workers),
            "resumed" if one.wall is None else f"{one.wall:.0f}",
            *(f"{seconds:.0f}" for seconds in (one.shapes, one.pairs, one.consistent)),
            "" if one.busy is None else f"{one.busy:.0%}",
            str(differing.get(one.run, "")),
        ]
        for one in times
    ]
    return markdown_table(header, rows)


def errors_table(errors: Sequence[Errors]) -> str:
    """Return the table of errors, times 100."""
    rows = []
    for entry in errors:
        values = 100 * np.array(entry.means)
        flips = "not known" if entry.flipped is None else str(entry.flipped)
        errors_text = [f"{value:.3f}" for value in (values.mean(), np.median(values), values.max())]
        rows.append([entry.maps, str(len(values)), flips, *errors_text])
    return markdown_table(("maps", "pairs", "flipped", "mean", "median", "worst"), rows)


@dataclass(frozen=True)
class Costs:
    """What one shape and one pair cost, as measured; bytes and seconds.

    Attributes
    ----------
    shape_seconds, shape_bytes : of preparing a shape, and of its entries in the cache.
    pair_seconds, pair_bytes : of matching a pair, and of its folder.
    loaded : prepared shapes that a worker fetched a pair.
    messages : bytes of a task and its row between scheduler and worker.
    worker_memory : of the largest worker at its peak.
    """

    shape_seconds: float
    shape_bytes: float
    pair_seconds: float
    pair_bytes: float
    loaded: float
    messages: float
    worker_memory: float

    def table(self, pairs: float = 1e6, workers: int = 100) -> str:
        """Return what so many pairs would cost, all of them matched."""
        shapes = (1 + math.sqrt(1 + 8 * pairs)) / 2
        hours = (shapes * self.shape_seconds + pairs * self.pair_seconds) / workers / 3600
        work = f"{self.shape_seconds:.2f} s a shape, {self.pair_seconds:.2f} s a pair"
        network_one, loaded = 8 * DEFAULT_LATENT**2, pairs * self.loaded * self.shape_bytes
        rows = [
            ("shapes", "1", f"{shapes:.0f}"),
            ("work", work, f"{hours * workers:.0f} h"),
            (f"time with {workers} workers", "", f"{hours:.1f} h"),
            ("memory of a worker", size_text(self.worker_memory), size_text(self.worker_memory)),
            ("memory of the network", size_text(network_one), size_text(min(NETWORK_BYTES, network_one * pairs))),
            ("disk, prepared shapes", size_text(self.shape_bytes), size_text(shapes * self.shape_bytes)),
            ("disk, pairs", size_text(self.pair_bytes), size_text(pairs * self.pair_bytes)),
            ("traffic, tasks", size_text(self.messages), size_text(pairs * self.messages)),
            ("traffic, prepared shapes", f"{self.loaded:.2f} a pair", size_text(loaded)),
        ]
        return markdown_table(("what", "one", f"{pairs:.0e} pairs"), rows, text_columns=3)


def costs(collection: Collection) -> Costs:
    """Return what the shapes and pairs of a collection did cost.

    The seconds of a pair are the median, as the first pair of a worker may wait for kernels to be compiled.

    Raises
    ------
    ClalignError
        No pair was matched.
    """
    rows = [row for row in direct_rows(collection) if row.ok]
    if not rows:
        raise ClalignError(f"{collection.folder}: no pair was matched, so there is nothing to measure")
    shapes = [row.seconds for row in collection.shapes if row.ok and row.seconds is not None]
    sizes = [_folder_bytes(collection.store.pair_folder("pairs", row.source, row.target)) for row in rows]
    member = Member(rows[0].source, str(collection.folder), DIGEST_LETTERS * "0", 0)
    settings = Settings(str(collection.folder), Options(), str(collection.folder), 0, "maps", DEFAULT_LATENT)
    prepared = ShapeRow(member.name, member.path, eigenvalues=(0.5,) * EIGENVALUES)
    task = (match_members, member, member, (prepared, prepared), settings)
    return Costs(
        shape_seconds=float(np.mean(shapes)),
        shape_bytes=_folder_bytes(collection.folder / CACHE_FOLDER) / max(len(shapes), 1),
        pair_seconds=float(np.median([row.seconds or 0.0 for row in rows])),
        pair_bytes=float(np.mean(sizes)),
        loaded=float(np.mean([row.loaded or 0 for row in rows])),
        messages=float(len(pickle.dumps(task)) + len(pickle.dumps(rows[0]))),
        worker_memory=float(max(row.peak_memory or 0 for row in rows)),
    )


def _folder_bytes(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
