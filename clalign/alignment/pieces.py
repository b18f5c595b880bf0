"""The best of several maps, piece by piece.

A map can be right as a whole and wrong in a part: a hand with its fingers exchanged, an arm turned about its axis, a
sole that slid. Another way of growing the same map is wrong elsewhere. So several are grown, and every piece of the
surface takes the map that explains it best. The chosen map is grown again from its low functions, in a few ways, which
forgets how its parts came about, and compared with itself; whatever is better in a piece is kept.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clalign.alignment.maps import PointMaps, orthogonalised, point_maps_in_order
from clalign.alignment.nearness import VertexOrder
from clalign.alignment.refine import GROWTHS, up_sampled
from clalign.alignment.samples import (
    SampledBasis,
    SampleMaps,
    coherent_factors,
    coherent_sample_steps,
    nearest_samples,
    quickly_orthogonalised,
    sample_functional_map,
    sampled_basis,
    spread_samples,
)
from clalign.engine.backend import Backend
from clalign.geometry.shape import Shape
from clalign.geometry.spectra import Spectrum

GROWN = 140
"""Laplace–Beltrami functions that a map is grown to at first, before ..."""
SETTLING = (200,)
"""... steps with so many scale-invariant ones."""
REGROWTH = (60, 80, 110, 150, 200, 250)
"""Functions of the steps that grow a map again in the scale-invariant basis, ..."""
LOW_REGROWTH = (60, 90, 130, 170)
"""... and in the Laplace–Beltrami basis, before `SETTLING`."""
GENERATIONS = 2
LIMIT = 250
"""Functions that pieces are compared with."""


def embedding_residuals(
    source: SampledBasis, target: SampledBasis, maps: SampleMaps
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return how badly the maps' own functional map explains each match: (S_x,) and (S_y,) squared distances.

    Distances between matched points in the embeddings by all functions that the orthogonalised functional map turns
    onto each other. It is the compromise of the whole surface; where a part is turned or folded, no rotation of the
    functions brings both the part and its surroundings together. All directions weigh 1, so that maps can be compared:
    weighted by coherence a worse map would be forgiven more.
    """
    size = min(source.count, target.count, LIMIT)
    turn = quickly_orthogonalised(sample_functional_map(source, target, maps, size)).astype(np.float32)
    at_x = source.at_samples(size) - target.functions[maps.target_of_source, :size] @ turn
    at_y = target.at_samples(size) @ turn - source.functions[maps.source_of_target, :size]
    return np.einsum("sk,sk->s", at_x, at_x), np.einsum("sk,sk->s", at_y, at_y)


def best_pieces(source: SampledBasis, target: SampledBasis, candidates: Sequence[SampleMaps]) -> SampleMaps:
    """Return the maps that take every piece from the candidate with the least residual there, on each shape."""
    residuals = [embedding_residuals(source, target, maps) for maps in candidates]
    forward = _chosen(source, [maps.target_of_source for maps in candidates], [pair[0] for pair in residuals])
    backward = _chosen(target, [maps.source_of_target for maps in candidates], [pair[1] for pair in residuals])
    return SampleMaps(forward, backward)


def _chosen(
    basis: SampledBasis, matches: list[NDArray[np.int64]], residuals: list[NDArray[np.float32]]
) -> NDArray[np.int64]:
    weights, pieces = basis.samples.weights, basis.samples.pieces
    totals = np.stack([np.bincount(pieces, weights=weights * residual) for residual in residuals])
    totals = np.nan_to_num(totals, nan=np.inf, posinf=np.inf)
    return np.stack(matches)[np.argmin(totals, axis=0)[pieces], np.arange(pieces.size)]


def piecewise_maps(
    backend: Backend,
    source: Shape,
    target: Shape,
    descriptors: tuple[Spectrum, Spectrum],
    functional: NDArray[np.float64],
    size: int,
) -> PointMaps:
    """Return the maps between all vertices that a functional map of the search leads to.

    Parameters
    ----------
    descriptors : scale-invariant eigenfunctions of both shapes, equally many.
    functional : (k, k), between Laplace–Beltrami functions.
    size : at most so many Laplace–Beltrami functions are used.
    """
    spread = spread_samples(source), spread_samples(target)
    orders = VertexOrder.in_space(source.mesh.vertices), VertexOrder.in_space(target.mesh.vertices)
    low_x, low_y, high_x, high_y = (
        sampled_basis(backend, spectrum, own, order)
        for spectra in ((source.basis, target.basis), descriptors)
        for spectrum, own, order in zip(spectra, spread, orders, strict=True)
    )

    def settled(maps: SampleMaps, sizes: tuple[int, ...]) -> SampleMaps:
        return coherent_sample_steps(backend, high_x, high_y, maps, _up_to(sizes, high_x, high_y))

    grown = []
    for growth in GROWTHS:
        larger = up_sampled(backend, source, target, functional, min(size, GROWN), growth, orders)
        started = nearest_samples(backend, low_x, low_y, (np.eye(len(larger)), orthogonalised(larger)))
        grown.append(settled(started, SETTLING))
    maps = best_pieces(high_x, high_y, grown)
    for _ in range(GENERATIONS):
        lower = coherent_sample_steps(backend, low_x, low_y, maps, _up_to(LOW_REGROWTH, low_x, low_y))
        maps = best_pieces(high_x, high_y, [maps, settled(maps, REGROWTH), settled(lower, SETTLING)])
    # More functions than half the equations of the least squares would fit its noise.
    count = min(high_x.count, high_y.count, max((spread[0].vertices.size + spread[1].vertices.size) // 4, 1))
    factors = coherent_factors(sample_functional_map(high_x, high_y, maps, count))
    x, y = (
        backend.product(basis.uploaded, backend.array(factor), leading=True)
        for basis, factor in zip((high_x, high_y), factors, strict=True)
    )
    return point_maps_in_order(backend, x, y, orders)


def _up_to(sizes: tuple[int, ...], source: SampledBasis, target: SampledBasis) -> tuple[int, ...]:
    """Return the sizes cut to what both shapes have."""
    most = min(source.count, target.count)
    return tuple(sorted({min(size, most) for size in sizes}))
