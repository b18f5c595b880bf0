"""``match_collection``: a whole set of shapes as one job, from the pairs to the network and what it mends."""

from __future__ import annotations

import itertools
import logging
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from clalign.collection.cluster import Task, open_client, outcomes, worker_count
from clalign.collection.forecast import Needs, check_disk, needs, workers_that_fit
from clalign.collection.members import (
    PAIRINGS,
    Member,
    Pairs,
    all_pairs,
    listed_pairs,
    read_members,
    spectrum_distances,
    star_pairs,
    tree_pairs,
)
from clalign.collection.network import MapEdges, Network, cycle_errors, cycle_weights, synchronise
from clalign.collection.result import Collection
from clalign.collection.store import CACHE_FOLDER, PairRow, ShapeRow, Store, merged, pair_key
from clalign.collection.work import PageWriter, Settings, derive_members, explained, match_members, prepare_member
from clalign.correspondence import finite_or_none
from clalign.errors import OptionError
from clalign.geometry.workers import processor_count
from clalign.maps.functional_maps import polar_factor
from clalign.matching.loop import Progress
from clalign.options import Options, given_options
from clalign.rules import CollectionRules
from clalign.storage.files import duration_text

if TYPE_CHECKING:
    from distributed import Client, Future

logger = logging.getLogger(__name__)

Consistency = Literal["auto", "none", "repair", "all"]

DEFAULT_LATENT = 60
CACHE_SLACK = 1.2
NETWORK_BYTES = 4e9
"""Maps of the network in memory at most; a larger set is joined over fewer functions."""


def match_collection(
    shapes: str | Path | Sequence[str | Path],
    out: str | Path,
    options: Options | None = None,
    *,
    pairs: str | Path = "all",
    consistency: Consistency = "auto",
    scheduler: str | None = None,
    workers: int | None = None,
    resume: bool = False,
    keep: Literal["maps", "full"] = "maps",
    latent: int = DEFAULT_LATENT,
    cache: str | Path | None = None,
    cache_limit: int | None = None,
    pages: PageWriter | None = None,
    progress: Progress | None = None,
) -> Collection:
    """Match the pairs of a set of shapes in parallel, and make their maps consistent.

    Parameters
    ----------
    shapes : a folder of meshes, a text file that lists meshes, or mesh files.
    out : folder of the collection; it and the meshes must be seen by all workers.
    options : of every match; see `Options`.
    pairs : "all", "star" (one shape in the middle), "tree" (every shape with one like it), or a file of pairs of names.
    consistency : "repair" replaces maps that contradict the others, "all" makes the maps of all other pairs from the
        network too, "none" does neither; "auto" is "all" for a star and a tree and "repair" otherwise.
    scheduler : address of a Dask scheduler; None starts workers on this machine.
    workers : local processes, None for as many as there are processors and memory for. They are spawned: a program that
        calls this needs ``if __name__ == "__main__":`` around it.
    resume : go on with a collection in `out`: only what is missing, failed or out of date is computed.
    keep : "maps" stores both maps and C of a pair, "full" the whole `Correspondence` besides.
    latent : number L of LBO functions in the network.
    cache, cache_limit : folder of prepared shapes, seen by all workers, and bytes that it may grow to.
    pages : writes a page into each pair's folder.
    progress : called as ``progress(stage, fraction, message)``.

    Returns
    -------
    Collection
        With the row of every pair and shape; what failed is named there and does not stop the rest.

    Raises
    ------
    ResultError
        The meshes, the pairs file or the folder cannot be used as asked.
    OptionError
        A value outside its range, no scheduler, or other options than those of the collection gone on with.
    MemoryBudgetError
        The workers need more memory than there is.
    """
    _require_values(keep=keep, consistency=consistency, latent=latent, workers=workers)
    plan = _planned(shapes, pairs, given_options(options), keep=keep, latent=latent, pages=pages is not None)
    store = Store(out)
    store.begin(plan.options, {"pairs": str(pairs), "latent": latent, "keep": keep}, resume=resume)
    held = str(Path(cache or store.folder / CACHE_FOLDER).expanduser().absolute())
    limit = round(CACHE_SLACK * plan.need.cache) if cache_limit is None else cache_limit
    check_disk(plan.need.pairs + (0.0 if resume else min(limit, plan.need.cache)), store.folder)
    settings = Settings(str(store.folder), plan.options, held, limit, keep, latent, pages)
    return _carried_out(plan, settings, consistency, scheduler, workers, progress or _unwatched)


@dataclass(frozen=True)
class Plan:
    """What a collection is asked for.

    Attributes
    ----------
    options : of every match.
    members : the shapes.
    pairing : "all", "star", "tree", or the name of a file of pairs.
    listed : the pairs of that file; None where the shapes say which.
    need : of memory and disk.
    """

    options: Options
    members: Sequence[Member]
    pairing: str
    listed: Pairs | None
    need: Needs


def _unwatched(stage: str, fraction: float, message: str) -> None:
    """Watch nothing."""


def _require_values(*, keep: str, consistency: str, latent: int, workers: int | None) -> None:
    if keep not in ("maps", "full") or consistency not in ("auto", "none", "repair", "all"):
        raise OptionError(
            f"keep is 'maps' or 'full' and consistency 'auto', 'none', 'repair' or 'all'; got {keep!r} and "
            f"{consistency!r}"
        )
    if latent < 2 or (workers is not None and workers < 1):
        raise OptionError(f"latent must be at least 2 and workers at least 1; got {latent} and {workers}")


def _planned(
    shapes: str | Path | Sequence[str | Path],
    pairs: str | Path,
    options: Options,
    *,
    keep: str,
    latent: int,
    pages: bool,
) -> Plan:
    members = read_members(shapes)
    listed = None if str(pairs) in PAIRINGS else listed_pairs(pairs, [member.name for member in members])
    count = len(listed) if listed is not None else len(members) * (len(members) - 1) // 2
    need = needs(members, count, options, keep=keep, latent=latent, pages=pages)
    return Plan(options, members, str(pairs), listed, need)


def _carried_out(
    plan: Plan,
    settings: Settings,
    consistency: Consistency,
    scheduler: str | None,
    workers: int | None,
    report: Progress,
) -> Collection:
    local = 0 if scheduler else workers_that_fit(plan.need.worker, workers, processor_count())
    job = Job(plan.members, settings, report)
    if consistency == "auto":
        consistency = "all" if plan.pairing in ("star", "tree") else "repair"
    with job.store.lock(), open_client(scheduler, local, job.store.folder) as client:
        job.report("start", 1.0, plan.need.text(worker_count(client)))
        job.match(client, plan.pairing, plan.listed)
        if consistency != "none":
            job.make_consistent(client, everything=consistency == "all")
    return job.finished()


def checked_by_network(
    store: Store, names: Sequence[str], rows: Sequence[PairRow], rules: CollectionRules
) -> tuple[Network, list[PairRow]]:
    """Synchronise the maps of all direct rows that are "ok"; return the network, and the rows with their errors in it.

    Parameters
    ----------
    store : has the maps.
    names : of the shapes; the network numbers them so.
    rows : of matched pairs.
    """
    number = {name: index for index, name in enumerate(names)}
    used = [row for row in rows if row.ok]
    size = max(2, int(np.sqrt(NETWORK_BYTES / (8 * max(len(used), 1)))))
    maps = [store.read_maps("pairs", row.source, row.target).functional_map[:size, :size].copy() for row in used]
    size = min((len(functional) for functional in maps), default=1)
    edges = MapEdges(
        len(names),
        np.array([(number[row.source], number[row.target]) for row in used], dtype=np.int64).reshape(-1, 2),
        polar_factor(np.stack([functional[:size, :size] for functional in maps])) if maps else np.ones((0, 1, 1)),
        np.ones(len(used)),
    )
    cycles = cycle_errors(edges)
    confidence = np.array([row.confidence or 0.0 for row in used])
    network = synchronise(replace(edges, weights=cycle_weights(confidence, cycles, rules)), rules)
    errors = zip(cycles, network.residuals, strict=True)
    checked = []
    for row in rows:
        if row.ok:
            cycle, residual = map(finite_or_none, next(errors))
            row = replace(row, cycle_error=cycle, network_error=residual)
        checked.append(row)
    return network, checked


def missing_pairs(network: Network, names: Sequence[str], matched: set[frozenset[str]]) -> list[tuple[str, str]]:
    """Return the pairs of shapes, by name, that the network joins and that were not matched."""
    joined = network.component[:, None] == network.component
    pairs = ((names[i], names[j]) for i, j in np.argwhere(np.triu(joined, 1)).tolist())
    return [pair for pair in pairs if frozenset(pair) not in matched]


class Job:
    """The run of one collection: what is known so far, and what is still to do."""

    def __init__(self, members: Sequence[Member], settings: Settings, report: Progress) -> None:
        self.members, self.settings, self.report, self.store = members, settings, report, settings.store
        self.by_name = {member.name: member for member in members}
        self.shapes = {row.name: row for row in self.store.shapes.read() if row.name in self.by_name}
        self.direct: dict[tuple[str, str], PairRow] = {}
        self.final: dict[tuple[str, str], PairRow] = {}

    def match(self, client: Client, pairing: str, listed: Pairs | None) -> None:
        """Prepare shapes and match pairs, each as soon as its shapes are there; what is done already is left alone."""
        futures: dict[str, Future] = {}
        shapes: Sequence[Member] = ()
        if pairing in ("star", "tree"):
            for task, value in outcomes(client, self._shape_tasks(self.members), futures):
                self._take_shape(task, value, len(self.members))
            waiting = self._missing(self._chosen_by_likeness(pairing))
        else:
            waiting = self._missing(listed if listed is not None else all_pairs(len(self.members)))
            shapes = [self.members[index] for index in sorted({index for pair in waiting for index in pair})]
        estimate = Estimate(len(waiting))
        tasks = itertools.chain(self._shape_tasks(shapes), self._pair_tasks(waiting, futures))
        for task, value in outcomes(client, tasks, futures):
            if task.function is prepare_member:
                self._take_shape(task, value, len(shapes))
                continue
            futures.pop(task.name).release()
            row = _pair_row(task, value)
            self.direct[row.source, row.target] = row
            self.store.pairs.append(row)
            self.report("pairs", *estimate.step(row))
        self.final.update(self.direct)
        for future in futures.values():
            future.release()

    def _shape_tasks(self, members: Iterable[Member]) -> Iterator[Task]:
        for member in members:
            yield Task(f"shape-{member.name}", prepare_member, (member, self.settings))

    def _pair_tasks(self, pairs: Pairs, futures: dict[str, Future]) -> Iterator[Task]:
        for pair in pairs:
            source, target = (self.members[index] for index in pair)
            prepared = tuple(futures[f"shape-{member.name}"] for member in (source, target))
            arguments = (source, target, prepared, self.settings)
            yield Task(f"pair-{source.name}-{target.name}", match_members, arguments)

    def _take_shape(self, task: Task, value: Any, total: int) -> None:
        member: Member = task.arguments[0]
        if isinstance(value, Exception):
            value = ShapeRow(member.name, member.path, "failed", explained(value))
        self.shapes[member.name] = value
        done = sum(1 for row in self.shapes.values() if row.eigenvalues or not row.ok)
        message = member.name if value.ok else f"{member.name} FAILED: {value.message}"
        self.report("shapes", min(1.0, done / max(total, 1)), message)

    def _chosen_by_likeness(self, pairing: str) -> Pairs:
        """Return the star or the tree over the shapes that could be prepared; the others have no pair."""
        usable = [index for index, member in enumerate(self.members) if self.shapes[member.name].ok]
        if len(usable) < 2:
            return []
        values = [self.shapes[self.members[index].name].eigenvalues for index in usable]
        shortest = min(len(row) for row in values)
        distances = spectrum_distances(np.array([row[:shortest] for row in values]))
        chosen = star_pairs(distances) if pairing == "star" else tree_pairs(distances)
        return [(usable[i], usable[j]) for i, j in chosen]

    def _missing(self, pairs: Pairs) -> Pairs:
        """Take the rows of all pairs that are done, and return those of `pairs` that are not."""
        for names in self.store.pair_names("pairs"):
            if self.by_name.keys() >= set(names):
                key = pair_key(self.by_name[names[0]], self.by_name[names[1]], self.settings.options)
                row = self.store.finished("pairs", *names, key)
                if row is not None:
                    self.direct[names] = row
        done = {frozenset(names) for names in self.direct}
        missing = [(i, j) for i, j in pairs if {self.members[i].name, self.members[j].name} not in done]
        logger.info("%d pairs, %d of them done", len(pairs), len(pairs) - len(missing))
        return missing

    def make_consistent(self, client: Client, *, everything: bool) -> None:
        """Synchronise the network, repair what contradicts it, and derive the other pairs if that is asked for."""
        names, rules = list(self.by_name), self.settings.options.rules.collection
        self.report("network", 0.0, "")
        network, rows = checked_by_network(self.store, names, list(self.direct.values()), rules)
        self.store.write_network(names, network)
        wrong = [row for row in rows if row.network_error is not None and row.network_error > rules.wrong]
        self.report("network", 1.0, f"{len(wrong)} maps contradict the others")
        self.final = {(row.source, row.target): row for row in rows}
        # The distortion of the map that the pair has, None where it has none.
        todo: list[tuple[str, str, float | None]] = [(row.source, row.target, row.distortion) for row in wrong]
        if everything:
            matched = {frozenset(pair) for pair, row in self.direct.items() if row.ok}
            todo += [(*pair, None) for pair in missing_pairs(network, names, matched)]
        tasks = [self._derivation(*pair, network) for pair in todo]
        estimate = Estimate(len(tasks))
        for task, value in outcomes(client, tasks):
            row = self._derived_row(task, value)
            # The pair may have failed in the other order; what is there now stands for it.
            self.final.pop((row.target, row.source), None)
            self.final[row.source, row.target] = row
            self.report("consistent", *estimate.step(row))

    def _derivation(self, source: str, target: str, distortion: float | None, network: Network) -> Task:
        first, second = self.by_name[source], self.by_name[target]
        functional = network.functional(self.members.index(first), self.members.index(second))
        arguments = (first, second, functional, distortion, network.digest, self.settings)
        return Task(f"consistent-{source}-{target}", derive_members, arguments)

    def _derived_row(self, task: Task, value: Any) -> PairRow:
        """Return the row of a pair after its repair or derivation; a repair that is no better is not taken."""
        source, target, _, distortion = task.arguments[:4]
        before = self.final.get((source.name, target.name))
        row = _pair_row(task, value)
        if distortion is None or before is None:
            return replace(row, kind="derived")
        worse = self.settings.options.rules.collection.worse * distortion
        return before if not row.ok or row.distortion is None or row.distortion > worse else merged(before, row)

    def finished(self) -> Collection:
        """Write the index anew, in the order of the shapes, and return the collection."""
        place = {name: index for index, name in enumerate(self.by_name)}
        rows = sorted(self.final.values(), key=lambda row: (place[row.source], place[row.target]))
        shapes = [self.shapes[name] for name in place if name in self.shapes]
        self.store.pairs.write(rows)
        self.store.shapes.write(shapes)
        return Collection(self.store, tuple(shapes), tuple(rows))


def _pair_row(task: Task, value: PairRow | Exception) -> PairRow:
    if isinstance(value, PairRow):
        return value
    source, target = task.arguments[:2]
    return PairRow(source.name, target.name, status="failed", message=explained(value))


@dataclass
class Estimate:
    """How far a stage is and how long it will take, from the pace so far."""

    total: int
    done: int = 0
    started: float = field(default_factory=time.monotonic)

    def step(self, row: PairRow) -> tuple[float, str]:
        """Count a pair; return the fraction done and a line that tells of it."""
        self.done += 1
        left = (time.monotonic() - self.started) / self.done * (self.total - self.done)
        if row.ok:
            said = row.kind if row.confidence is None else f"confidence {row.confidence:.2f}"
        else:
            said = f"{row.status.upper()}: {row.message}"
        when = f", about {duration_text(left)} left" if self.done < self.total else ""
        return self.done / self.total, f"{self.done}/{self.total}{when}; {row.source} {row.target}: {said}"
