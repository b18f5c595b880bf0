"""Where candidates start: sign patterns of the lowest eigenfunctions, unfolded by the triple products they carry."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clalign.maps.orientation import carried_products, index_pairs
from clalign.rules import SearchRules
from clalign.search.batch import Batch, SamplePair, up_sample


def sign_patterns(size: int) -> NDArray[np.float32]:
    """Return all (2^(size−1), size, size) diagonal ±1 maps that keep the constant function."""
    bits = (np.arange(2 ** (size - 1))[:, None] >> np.arange(size - 1)) & 1
    signs = np.concatenate([np.ones((len(bits), 1)), 1.0 - 2.0 * bits], axis=1)
    maps = np.zeros((len(bits), size, size), dtype=np.float32)
    maps[:, np.arange(size), np.arange(size)] = signs
    return maps


def unfold(pair: SamplePair, blocks: NDArray[np.float32], strength: float, rules: SearchRules) -> NDArray[np.float32]:
    """Return the functional maps of the point maps that carry low functions *and* their triple products.

    The low eigenfunctions of a thin body are even from its front to its back, so matching them alone fixes a map only
    up to a fold and which side it falls to is noise. Triple products of even functions are odd: carried along with the
    sign of an orientation-preserving map they unfold it at once and everywhere to the same side.

    Parameters
    ----------
    blocks : (B, k0, k0), the map of the low functions of each candidate.
    strength : τ; the triple products are scaled to have τ² times the variance of the functions.

    Returns
    -------
    (B, k, k) float32 with k = 16 (fewer on small shapes).
    """
    level = pair.fitted(rules.unfold)
    low = blocks.shape[1]
    size = min(pair.source.tensor.shape[0], pair.source.functions.shape[1])
    size_y = min(pair.target.tensor.shape[0], pair.target.functions.shape[1])
    pairs = index_pairs(1, min(rules.triple_products, low - 1))
    weights = pair.source.prefix_weights(level.points)

    coefficients = pair.source.tensor[pairs[:, 0], pairs[:, 1], :size]
    products = pair.source.functions[: level.points, :size] @ coefficients.T
    mean = weights @ products
    variance = float(np.sum(weights @ (products - mean) ** 2))
    scale = strength * np.sqrt(low / max(variance, 1e-30))
    points = np.concatenate([pair.source.functions[: level.points, :low], scale * products], axis=1)

    columns = np.zeros((len(blocks), low + len(pairs), size_y), dtype=np.float32)
    columns[:, :low, :low] = blocks.transpose(0, 2, 1)
    columns[:, low:] = scale * carried_products(blocks, pair.target.tensor, pairs)[:, :, :size_y]
    embedded = pair.backend.product(
        pair.synthesis(level.queries, size_y),
        pair.backend.array(columns.transpose(2, 0, 1).reshape(size_y, -1)),
    )
    index, _ = pair.backend.nearest(
        embedded.reshape(level.queries * len(blocks), low + len(pairs)),
        pair.backend.array(points),
        pair.backend.array(0.5 * np.sum(points**2, axis=1)),
    )
    index = index.reshape(level.queries, len(blocks))
    functional = pair.functional_maps(index, level.size, level)
    return pair.download(functional, index).functional


def oriented_initial_maps(
    pair: SamplePair, blocks: NDArray[np.float32], strengths: tuple[float, ...], rules: SearchRules
) -> Batch:
    """Unfold every block at every strength, settle by ZoomOut steps, and drop what is mirrored."""
    started = np.concatenate([unfold(pair, blocks, strength, rules) for strength in strengths])
    batch = up_sample(pair, started, rules.settle)
    return batch.take(pair.orientations(batch, rules.scored_products) > rules.settled_orientation)
