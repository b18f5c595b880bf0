"""Growing candidates in frequency, branching where a function is not carried by the map so far."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clalign.maps.orientation import orientation_scores
from clalign.search.batch import Batch, Level, SamplePair, distortions, map_distances, up_sample, without_duplicates
from clalign.search.initial_maps import oriented_starts, sign_patterns

LOOKAHEAD = 6


@dataclass(frozen=True)
class TreeRules:
    """How candidates are grown and thinned.

    functions : the sign patterns of this many functions are the starts.
    sizes : the numbers of functions at which the tree branches.
    strengths : of the triple products in the oriented unfolding; empty starts from bare sign patterns.
    carried : a column (row) of C with a smaller squared norm counts as not carried (not reached).
    least_orientation : candidates below are dropped at every size; −1 keeps all.
    slack, margin : candidates with distortion above slack · best + margin are dropped.
    radius : candidates closer than this (mean geodesic distance) are duplicates.
    most : at most so many candidates go on.
    """

    functions: int
    sizes: tuple[int, ...]
    strengths: tuple[float, ...] = ()
    carried: float = 0.55
    least_orientation: float = -1.0
    slack: float = 3.0
    margin: float = 0.01
    radius: float = 0.03
    most: int = 80


ORIENTED = TreeRules(functions=9, sizes=(16, 18, 20), strengths=(0.5, 1.0), least_orientation=0.2, most=120)
PLAIN = TreeRules(functions=7, sizes=(8, 9, 10, 11, 12, 14, 16, 18, 20), carried=0.6)


def branched(functional: NDArray[np.float32], carried: float) -> NDArray[np.float32]:
    """Return the candidates, and for each that leaves a function out two copies that send it to one not reached.

    Swapped or shifted eigenfunctions show as a column of C with a small norm (a function of X that the map does not
    carry) and a row with a small norm (one of Y that nothing reaches). The first such pair is joined with +1 and −1.
    """
    squares = functional**2
    columns = squares.sum(axis=1)
    rows = squares.sum(axis=2)
    columns[:, 0] = rows[:, 0] = np.inf
    which = np.flatnonzero((columns < carried).any(axis=1) & (rows < carried).any(axis=1))
    if which.size == 0:
        return functional
    column = np.argmax(columns[which] < carried, axis=1)
    row = np.argmax(rows[which] < carried, axis=1)
    copies = [functional]
    for sign in (1.0, -1.0):
        copy = functional[which].copy()
        copy[np.arange(which.size), :, column] = 0.0
        copy[np.arange(which.size), row, :] = 0.0
        copy[np.arange(which.size), row, column] = sign
        copies.append(copy)
    return np.concatenate(copies)


def thinned(pair: SamplePair, batch: Batch, level: Level, rules: TreeRules) -> Batch:
    """Drop mirrored, distorted and duplicate candidates, best distortion first."""
    if rules.least_orientation > -1.0:
        scores = orientation_scores(batch.functional, pair.source.tensor, pair.target.tensor)
        kept = scores > rules.least_orientation
        batch = batch.take(kept if kept.any() else scores == scores.max())
    values = distortions(pair, batch.index, pair.fit(level).points)
    order = np.argsort(values, kind="stable")
    order = order[values[order] < rules.slack * values[order[0]] + rules.margin][: 4 * rules.most]
    batch = batch.take(order)
    between = map_distances(pair, batch.index, pair.fit(level).points)
    kept_candidates = without_duplicates(between, np.arange(batch.count), rules.radius, rules.most)
    return batch.take(np.array(kept_candidates))


def grow(pair: SamplePair, rules: TreeRules) -> Batch:
    """Return the candidates of one tree, at about `rules.sizes[-1] + 6` functions."""
    largest = pair.fit(Level(rules.functions, 200, 400)).size
    patterns = sign_patterns(min(rules.functions, largest))
    if rules.strengths:
        functional = oriented_starts(pair, patterns, rules.strengths).functional
        if len(functional) == 0:
            functional = patterns
    else:
        functional = patterns
    batch = None
    for size in rules.sizes:
        if batch is not None or not rules.strengths:
            lookahead = Level(size, 150, 300)
            functional = up_sample(pair, functional, [lookahead]).functional
        wide = Level(size + LOOKAHEAD, 150, 300)
        functional = up_sample(pair, functional, [wide]).functional
        batch = up_sample(pair, branched(functional, rules.carried), [wide])
        batch = thinned(pair, batch, wide, rules)
        functional = batch.functional
    if batch is None:
        raise ValueError("TreeRules.sizes must not be empty")
    return batch
