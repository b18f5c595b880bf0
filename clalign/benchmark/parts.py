"""The pairs of a folder with one mesh, or both, cut down to a part in the ways of `clalign.benchmark.cut`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clalign.benchmark.cut import KINDS, Kind, part_of
from clalign.benchmark.layouts import Layout, animals, humans
from clalign.benchmark.pairs import BenchmarkPair, LoadedPair
from clalign.errors import OptionError, ResultError
from clalign.evaluation.truth import Truth
from clalign.mesh.mesh import Mesh, mesh_from_arrays

GOLDEN = 0.6180339887498949
"""Steps of this size spread over (0, 1) evenly, however many there are."""


@dataclass(frozen=True)
class PartPair:
    """A pair whose source is a part, with its vertices shuffled.

    name : of the pair.
    pair : before.
    kind : one of `KINDS`.
    share : of the source's area that is left.
    factor : by which the part is larger in its file than it was.
    seed : of what is drawn.
    """

    name: str
    pair: BenchmarkPair
    kind: str
    share: float
    factor: float = 1.0
    seed: int = 0

    def load(self) -> LoadedPair:
        """Read the pair and take the part.

        Raises
        ------
        ClalignError
            The pair is not usable.
        """
        whole, rng = self.pair.load(), np.random.default_rng(self.seed)
        part, of_source = taken(whole.source, KINDS[self.kind], self.share, rng, self.factor)
        known = of_source[whole.truth.source_points] >= 0
        truth = _moved(whole.truth, of_source, known)
        mirrored = None if whole.mirrored is None else _moved(whole.mirrored, of_source, known)
        return LoadedPair(self.name, part, whole.target, truth, mirrored)


def taken(
    mesh: Mesh, kind: Kind, share: float, rng: np.random.Generator, factor: float = 1.0
) -> tuple[Mesh, NDArray[np.int64]]:
    """Return a part of a mesh, and for every vertex of its file the vertex there, −1 for one that has gone."""
    faces = mesh.file_faces
    left = faces[part_of(mesh.file_positions(), faces, kind, share, rng)]
    used = rng.permutation(np.unique(left))
    of_file = np.full(mesh.file_count, -1, dtype=np.int64)
    of_file[used] = np.arange(len(used))
    part = mesh_from_arrays(factor * mesh.file_positions()[used], rng.permutation(of_file[left]), f"{mesh.name} (part)")
    # What touches the rest in one vertex only is left out when the part is read.
    of_file[used[part.vertex_of_file < 0]] = -1
    return part, of_file


def _moved(truth: Truth, of_source: NDArray[np.int64], known: NDArray[np.bool_]) -> Truth:
    return Truth(of_source[truth.source_points[known]], truth.target_points[known])


def parts(
    path: str | Path, kinds: Sequence[str] = tuple(KINDS), count: int = 20, factor: float = 1.0
) -> tuple[Layout, ...]:
    """Return one suite for each kind: `count` pairs of a folder, spread over its suites, with parts of all sizes.

    Parameters
    ----------
    path : a folder in the layout of the humans, or folders of frames of one connectivity.
    kinds : of `KINDS`.
    count : pairs of each kind.
    factor : by which the parts are larger in their files than they were.

    Raises
    ------
    OptionError
        No such kind.
    ResultError
        No such folder.
    """
    unknown = [kind for kind in kinds if kind not in KINDS]
    if unknown:
        raise OptionError(f"unknown kind of part {unknown[0]!r}; there are {', '.join(KINDS)}")
    layouts = _layouts(path)
    pairs = [pair for layout in layouts for pair in layout.pairs]
    chosen = [pairs[(number * len(pairs)) // count] for number in range(count)]
    problems = tuple(problem for layout in layouts for problem in layout.problems)
    return tuple(
        Layout(
            f"{Path(path).resolve().name}/{kind}",
            tuple(_part_pair(pair, kind, factor, number) for number, pair in enumerate(chosen)),
            problems,
        )
        for kind in kinds
    )


def _layouts(path: str | Path) -> tuple[Layout, ...]:
    """Return the suites of a folder of humans, or of frames where it has neither truth nor lists of pairs."""
    root = Path(path)
    if any(root.glob("**/pairs*.txt")) or not root.is_dir():
        return humans(path)
    try:
        return animals(path)
    except ResultError:
        return humans(path)


def _part_pair(pair: BenchmarkPair, kind: str, factor: float, number: int) -> PartPair:
    low, high = KINDS[kind].shares
    share = low + (high - low) * ((number + 0.5) * GOLDEN % 1.0)
    return PartPair(f"{pair.name} {share:.0%}", pair, kind, share, factor, number)
