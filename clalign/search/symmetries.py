"""Candidates from candidates: composition with the shapes' self-maps, and unfolding once more."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clalign.search.batch import Batch, Level, SamplePair, least_distorted, up_sample
from clalign.search.initial_maps import oriented_starts
from clalign.search.tree import PLAIN, grow

WIDE_LEVELS = tuple(Level(size, 200, 600) for size in (22, 25, 28, 32, 36, 40, 40))
NOT_THE_IDENTITY = 0.1
REFOLD_SIZES = (9, 12, 16)


def widened(pair: SamplePair, functional: NDArray[np.float32], most: int, radius: float = 0.02) -> Batch:
    """Up-sample candidates to 40 functions and drop duplicates, best distortion first."""
    batch = up_sample(pair, functional, WIDE_LEVELS)
    return least_distorted(pair, batch, pair.fit(WIDE_LEVELS[-1]).points, radius, most, among=3 * most)


def self_maps(pair: SamplePair, most: int) -> NDArray[np.float32]:
    """Return the best non-identical maps of a shape to itself, (B, k, k), at 40 functions.

    Parameters
    ----------
    pair : a shape paired with itself.
    """
    batch = widened(pair, grow(pair, PLAIN).functional, 4 * most)
    queries = batch.index.shape[0]
    own = np.arange(queries)
    distances = pair.source.distances[batch.index, own[:, None]]
    moved = pair.target.prefix_weights(queries) @ distances
    return batch.functional[moved > NOT_THE_IDENTITY][:most]


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


def unfolded_again(pair: SamplePair, functional: NDArray[np.float32], strengths: tuple[float, ...]) -> list[Batch]:
    """Unfold the leading blocks of candidates once more.

    It repairs a candidate whose parts are folded to different sides (legs right, torso front to back).
    """
    results = []
    for size in REFOLD_SIZES:
        if size <= functional.shape[1]:
            blocks = np.ascontiguousarray(functional[:, :size, :size])
            results.append(oriented_starts(pair, blocks, strengths))
    return results
