"""Candidates from candidates: composition with the shapes' self-maps, and unfolding once more."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clalign.rules import SearchRules
from clalign.search.batch import Batch, SamplePair, least_distorted, up_sample
from clalign.search.initial_maps import oriented_initial_maps
from clalign.search.tree import grow


def widened(pair: SamplePair, functional: NDArray[np.float32], most: int, rules: SearchRules) -> Batch:
    """Bring candidates to the size at which they are compared and drop duplicates, least distortion first."""
    batch = up_sample(pair, functional, rules.wide)
    points = pair.fitted(rules.wide.last).points
    return least_distorted(pair, batch, points, rules.wide_radius, most, among=rules.wide_among * most)


def self_maps(pair: SamplePair, rules: SearchRules) -> NDArray[np.float32]:
    """Return the best non-identical maps of a shape to itself, (B, k, k), of the size of `widened`.

    Parameters
    ----------
    pair : a shape paired with itself.
    """
    batch = widened(pair, grow(pair, rules.plain, rules).functional, rules.self_maps_among, rules)
    queries = batch.index.shape[0]
    own = np.arange(queries)
    distances = pair.source.distances[batch.index, own[:, None]]
    moved = pair.target.prefix_weights(queries) @ distances
    return batch.functional[moved > rules.not_identity][: rules.self_maps]


def composed(
    functional: NDArray[np.float32], source_maps: NDArray[np.float32], target_maps: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return every candidate composed with every self-map of X (on the right) and of Y (on the left)."""
    size = functional.shape[1]
    results = [functional]
    # The self-maps of the larger shape may be in more functions than the smaller one has.
    own_source, own_target = source_maps[:, :size, :size], target_maps[:, :size, :size]
    if len(own_source):
        results.append(np.einsum("bij,sjk->bsik", functional, own_source).reshape(-1, size, size))
    if len(own_target):
        results.append(np.einsum("tij,bjk->btik", own_target, functional).reshape(-1, size, size))
    return np.concatenate(results).astype(np.float32)


def unfolded_again(pair: SamplePair, functional: NDArray[np.float32], rules: SearchRules) -> list[Batch]:
    """Unfold the leading blocks of candidates once more.

    It repairs a candidate whose parts are folded to different sides (legs right, torso front to back).
    """
    results = []
    for size in rules.unfold_sizes:
        if size <= functional.shape[1]:
            blocks = functional[:, :size, :size]
            results.append(oriented_initial_maps(pair, blocks, rules.oriented.strengths, rules))
    return results
