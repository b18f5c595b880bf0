"""Where candidates start on shapes of other proportions: extremities that are matched with each other.

Limbs of other lengths reorder the low eigenfunctions, so that no sign pattern of these is near the right map. Tips of
limbs are still tips, and stay about as far from each other, counted in factors.
"""

from __future__ import annotations

from itertools import combinations, permutations

import numpy as np
from numpy.typing import NDArray

from clalign.maps.nearest import nearest_rows
from clalign.rules import SearchRules, TipRules
from clalign.search.batch import Batch, SampledShape, SamplePair, least_distorted, up_sample
from clalign.search.symmetries import widened

LEAST_TIPS = 3
"""Distances to fewer points tell hardly any part of a surface from another."""


def tips(distances: NDArray[np.float64], weights: NDArray[np.float64], rules: TipRules) -> NDArray[np.int64]:
    """Return the extremities of a shape, farthest out first: at most `rules.most` of its samples.

    They are the local maxima of the mean geodesic distance to the surface: ends of limbs, the top of a head.

    Parameters
    ----------
    distances, weights : (S, S) between the samples, and (S,) area shares.
    """
    mean = distances @ weights
    neighbours = distances < rules.radius
    largest = np.where(neighbours, mean[None, :], 0.0).max(axis=1)
    maxima = np.flatnonzero(mean >= largest)
    return maxima[np.argsort(-mean[maxima], kind="stable")][: rules.most]


def assignments(
    source: SampledShape, target: SampledShape, rules: TipRules
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return samples of X and of Y, (A, t) each, whose columns are matched with each other, the likeliest rows first.

    An assignment costs the mean of |ln(a / b)| over the distances a and b between its tips, in units of the mean
    distance on either shape, and the same over the mean distances of the tips: a limb that is half as long again costs
    ln 1.5 in what leads to it, and no more the longer it is.

    Returns
    -------
    Without rows where a shape has fewer than three tips.
    """
    own, others = (tips(shape.distances, shape.weights, rules) for shape in (source, target))
    count = min(rules.assigned, own.size, others.size)
    if count < LEAST_TIPS:
        return np.zeros((0, 1), dtype=np.int64), np.zeros((0, 1), dtype=np.int64)
    ordered = np.array([each for chosen in combinations(own, count) for each in permutations(chosen)])
    chosen = np.array(list(combinations(others, count)))
    of_source, of_target = _relations(source, ordered, rules), _relations(target, chosen, rules)
    pairs = of_source.shape[1] - count
    differences = np.abs(of_source[None] - of_target[:, None])
    costs = differences[:, :, :pairs].mean(axis=2) + differences[:, :, pairs:].mean(axis=2)
    best = np.argsort(costs, axis=None, kind="stable")[: rules.tried]
    target_row, source_row = np.unravel_index(best, costs.shape)
    return ordered[source_row], chosen[target_row]


def _relations(shape: SampledShape, tuples: NDArray[np.int64], rules: TipRules) -> NDArray[np.float64]:
    """Return (T, t (t − 1) / 2 + t): logarithms of distances between the tips of each row, then of their mean ones."""
    mean = shape.distances @ shape.weights
    typical = shape.weights @ mean
    first, second = np.triu_indices(tuples.shape[1], 1)
    between = shape.distances[tuples[:, first], tuples[:, second]]
    return np.log(np.maximum(np.concatenate([between, mean[tuples]], axis=1) / typical, rules.least_distance))


def tip_initial_maps(pair: SamplePair, rules: TipRules) -> Batch:
    """Return the maps that send every sample of Y to the one of X with the most similar distances to matched tips.

    Distances to each tip count in units of their mean over the surface, which forgives a longer limb. All assignments
    are searched at once: with p and q the distances of two samples to all tips, and 0 or 1 for each tip that an
    assignment takes, |p − q|² over its tips is −2 (q · p − ½ p² · taken) and what only depends on q.
    """
    own, others = assignments(pair.source, pair.target, rules)
    level = pair.fitted(rules.first)
    count = len(own)
    if not count:
        nothing = np.zeros((0, level.size, level.size), dtype=np.float32)
        return Batch(nothing, np.zeros((level.queries, 0), dtype=np.int32))
    used, places = np.unique(own, return_inverse=True)
    points = _to_tips(pair.source, used)[: level.points]
    wanted = _to_tips(pair.target, others.ravel())[: level.queries].reshape(level.queries, count, -1)
    queries = np.zeros((level.queries, count, 2 * used.size), dtype=np.float32)
    rows, places = np.arange(count)[:, None], places.reshape(own.shape)
    queries[:, rows, places] = wanted
    queries[:, rows, used.size + places] = -0.5
    index, _ = pair.backend.nearest(
        pair.backend.array(queries.reshape(-1, 2 * used.size)),
        pair.backend.array(np.concatenate([points, points**2], axis=1)),
    )
    index = index.reshape(level.queries, count)
    return pair.download(pair.functional_maps(index, level.size, level), index)


def _to_tips(shape: SampledShape, chosen: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return (S, t): distances of all samples to tips, in units of the mean distance of each tip."""
    distances = shape.distances[:, chosen]
    return distances / (shape.weights @ distances)


def tip_candidates(pair: SamplePair, rules: SearchRules) -> NDArray[np.float32]:
    """Return candidates from matched tips, (B, k, k) of the size at which all candidates are compared; maybe none."""
    return settled_candidates(pair, tip_initial_maps(pair, rules.tips), rules)


def given_candidates(pair: SamplePair, rules: SearchRules) -> NDArray[np.float32]:
    """Return the candidate, if any, from samples with the most similar descriptors of the user."""
    level = pair.fitted(rules.first_given)
    if pair.source.given is None or pair.target.given is None:
        return np.zeros((0, level.size, level.size), dtype=np.float32)
    points, queries = pair.source.given.values[: level.points], pair.target.given.values[: level.queries]
    index = nearest_rows(queries, points, backend=pair.backend).astype(np.int32)[:, None]
    functional = pair.functional_maps(pair.backend.array(index), level.size, level)
    return settled_candidates(pair, pair.download(functional, pair.backend.array(index)), rules)


def settled_candidates(pair: SamplePair, started: Batch, rules: SearchRules) -> NDArray[np.float32]:
    """Return initial maps brought to the size at which all candidates are compared, those that keep the orientation."""
    if not started.count:
        return started.functional
    settled = up_sample(pair, started.functional, rules.settle)
    settled = settled.take(pair.orientations(settled, rules.scored_products) > rules.settled_orientation)
    if not settled.count:
        return settled.functional
    few = least_distorted(pair, settled, pair.fitted(rules.settle.last).points, rules.wide_radius, rules.tips.kept)
    wide = widened(pair, few.functional, rules.tips.kept, rules)
    return wide.functional[pair.orientations(wide, rules.scored_products) > rules.joined_orientation]
