"""Growing candidates in frequency, branching where a function is not carried by the map so far."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clalign.rules import Level, SearchRules, TreeRules
from clalign.search.batch import Batch, SamplePair, distinct, distortions, up_sample
from clalign.search.initial_maps import oriented_initial_maps, sign_patterns


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


def thinned(pair: SamplePair, batch: Batch, level: Level, rules: TreeRules, products: int) -> Batch:
    """Drop mirrored, distorted and duplicate candidates, best distortion first."""
    if rules.least_orientation > -1.0:
        scores = pair.orientations(batch, products)
        kept = scores > rules.least_orientation
        batch = batch.take(kept if kept.any() else scores == scores.max())
    points = pair.fitted(level).points
    values = distortions(pair, batch.index, points)
    order = np.argsort(values, kind="stable")
    order = order[values[order] < rules.slack * values[order[0]] + rules.margin][: rules.among * rules.most]
    return distinct(pair, batch.take(order), points, rules.radius, rules.most)


def grow(pair: SamplePair, tree: TreeRules, rules: SearchRules) -> Batch:
    """Return the candidates of one tree, at about `tree.sizes[-1] + tree.lookahead` functions."""
    largest = pair.fit(tree.functions, rules.unfold.queries, rules.unfold.points).size
    functional = patterns = sign_patterns(min(tree.functions, largest))
    if tree.strengths:
        oriented = oriented_initial_maps(pair, patterns, tree.strengths, rules).functional
        functional = oriented if len(oriented) else patterns
    batch = None
    for size in tree.sizes:
        if batch is not None or not tree.strengths:
            functional = up_sample(pair, functional, [Level(size, tree.queries, tree.points)]).functional
        wide = Level(size + tree.lookahead, tree.queries, tree.points)
        functional = up_sample(pair, functional, [wide]).functional
        batch = thinned(
            pair, up_sample(pair, branched(functional, tree.carried), [wide]), wide, tree, rules.scored_products
        )
        functional = batch.functional
    if batch is None:
        raise ValueError("a tree has at least one size")
    return batch
