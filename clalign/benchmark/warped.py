"""The pairs of a folder with other proportions, in the ways of `clalign.benchmark.warp`, or with touching parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clalign.benchmark.layouts import Layout, humans
from clalign.benchmark.pairs import BenchmarkPair, LoadedPair
from clalign.benchmark.perturb import Perturbed, decimate, renumber, same_vertices
from clalign.benchmark.touching import TouchingPair
from clalign.benchmark.warp import WARPS
from clalign.errors import OptionError
from clalign.evaluation.truth import Truth
from clalign.mesh.mesh import Mesh

TOUCHING = "touching"
ALL_WARPS = (*WARPS, TOUCHING)


@dataclass(frozen=True)
class WarpedPair:
    """A pair of which the source, or both meshes, are warped, and the target shuffled.

    name : of the pair.
    pair : before.
    warp : one of `WARPS`.
    share : of the target's faces that are left when it is remeshed; 1 keeps its triangles.
    seed : of what is drawn.
    """

    name: str
    pair: BenchmarkPair
    warp: str
    share: float = 1.0
    seed: int = 0

    def load(self) -> LoadedPair:
        """Read the pair and warp it.

        Raises
        ------
        ClalignError
            The pair is not usable, or remeshing needs a package that is not installed.
        """
        before, warp, rng = self.pair.load(), WARPS[self.warp], np.random.default_rng(self.seed)
        source = same_vertices(before.source, warp.points(before.source, rng), self.warp)
        steps = [same_vertices(before.target, warp.points(before.target, rng), self.warp)] if warp.both else []
        if self.share < 1:
            steps.append(decimate(steps[-1].mesh if steps else before.target, self.share))
        steps.append(renumber(steps[-1].mesh if steps else before.target, self.seed))
        of_source = _new_numbers(before.source, [source])
        of_target = _new_numbers(before.target, steps)
        truths = [before.truth] if before.mirrored is None else [before.truth, before.mirrored]
        moved = [(of_source[each.source_points], of_target[each.target_points]) for each in truths]
        known = np.all([(x >= 0) & (y >= 0) for x, y in moved], axis=0)
        truth, *mirrored = (Truth(x[known], y[known]) for x, y in moved)
        return LoadedPair(self.name, source.mesh, steps[-1].mesh, truth, mirrored[0] if mirrored else None)


def _new_numbers(mesh: Mesh, steps: Sequence[Perturbed]) -> NDArray[np.int64]:
    """Return the number of every file vertex of a mesh after some steps; -1 where it has gone."""
    numbers = np.arange(mesh.file_count)
    for step in steps:
        following = np.full(max(int(step.truth.source_points.max()), int(numbers.max())) + 2, -1, dtype=np.int64)
        following[step.truth.source_points] = step.truth.target_points
        numbers = following[numbers]
    return numbers


def _changed(pair: BenchmarkPair, warp: str, share: float, seed: int) -> BenchmarkPair:
    if warp == TOUCHING:
        return TouchingPair(pair.name, pair, seed)
    return WarpedPair(pair.name, pair, warp, share, seed)


def warped(
    path: str | Path, warps: Sequence[str] = ALL_WARPS, share: float = 1.0, pairs: str | None = None
) -> tuple[Layout, ...]:
    """Return one suite for each warp, of all pairs of a folder in the layout of the humans.

    share : of the target's faces that are left when it is remeshed, which pairs with touching parts are not.

    Raises
    ------
    OptionError
        No such warp, or a share outside (0, 1].
    ResultError
        No such folder or pairs file.
    """
    unknown = [warp for warp in warps if warp not in ALL_WARPS]
    if unknown:
        raise OptionError(f"unknown warp {unknown[0]!r}; there are {', '.join(ALL_WARPS)}")
    if not 0 < share <= 1:
        raise OptionError(f"the share of faces to keep must lie in (0, 1], got {share!r}")
    return tuple(
        Layout(
            f"{layout.name}/{warp}",
            tuple(_changed(pair, warp, share, number) for number, pair in enumerate(layout.pairs)),
            layout.problems,
        )
        for warp in warps
        for layout in humans(path, pairs)
    )
