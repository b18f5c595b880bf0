"""The best of several maps, piece by piece.

A map can be right as a whole and wrong in a part: a hand with its fingers exchanged, an arm turned about its axis, a
snout with its sides exchanged, a sole that slid. Another way of growing the same map is wrong elsewhere. So several are
grown, and every piece of the surface takes the map that explains it best, of those that do not turn it inside out. The
chosen map is grown again from its low functions, in a few ways, which forgets how its parts came about, and compared
with itself; whatever is better in a piece is kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.engine.backend import Backend
from clalign.geometry.shape import Shape
from clalign.geometry.spectra import Spectrum
from clalign.maps.functional_maps import PointMaps, orthogonalised, point_maps_in_order
from clalign.maps.orientation import carried_products, index_pairs
from clalign.maps.sampling import (
    SampledBasis,
    SampleMaps,
    coherent_factors,
    coherent_sample_steps,
    nearest_samples,
    quickly_orthogonalised,
    sample_functional_map,
    sampled_basis,
)
from clalign.refinement.zoomout import GROWTHS, up_sampled

GROWN = 140
"""Laplace–Beltrami functions that a map is grown to at first, before ..."""
SETTLING = (200,)
"""... steps with so many scale-invariant ones."""
REGROWTH = (60, 80, 110, 150, 200, 250)
"""Functions of the steps that grow a map again in the scale-invariant basis, ..."""
LOW_REGROWTH = (60, 90, 130, 170)
"""... and in the Laplace–Beltrami basis, before `SETTLING`."""
GENERATIONS = 2
TURNED = 11
"""Last function whose triple products tell the orientation of a piece."""
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


@dataclass(frozen=True, eq=False)
class Orientations:
    """What tells whether a map keeps the orientation of a piece: triple products of the low LBO functions.

    Attributes
    ----------
    source, target : Laplace–Beltrami functions with the samples.
    source_tensor, target_tensor : (p, p, p), see `operators.orientation_tensor`.
    """

    source: SampledBasis
    target: SampledBasis
    source_tensor: NDArray[np.float64]
    target_tensor: NDArray[np.float64]

    def agreements(self, maps: SampleMaps) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return how far n · (∇φ_a × ∇φ_b) is carried along at each sample: (S_x,) and (S_y,), negative if turned over.

        The products of the first functions of the source are compared at matched vertices with those of what the map
        makes of them on the target, and multiplied by −1 where the map reverses the orientation as a whole.
        """
        size = min(len(self.source_tensor), len(self.target_tensor))
        functional = quickly_orthogonalised(sample_functional_map(self.source, self.target, maps, size))
        pairs = index_pairs(1, min(TURNED, size - 1))
        expected = self.source_tensor[pairs[:, 0], pairs[:, 1], :size]
        carried = carried_products(functional[None], self.target_tensor, pairs)[0, :, :size]
        own, others = self.source.at_samples(size), self.target.functions[maps.target_of_source, :size]
        at_x = np.einsum("sp,sp->s", own @ expected.T, others @ carried.T)
        own, others = self.target.at_samples(size), self.source.functions[maps.source_of_target, :size]
        at_y = np.einsum("sp,sp->s", own @ carried.T, others @ expected.T)
        whole = self.source.samples.weights @ at_x + self.target.samples.weights @ at_y
        return (-at_x, -at_y) if whole < 0 else (at_x, at_y)


def best_pieces(
    source: SampledBasis,
    target: SampledBasis,
    candidates: Sequence[SampleMaps],
    orientations: Orientations | None = None,
) -> SampleMaps:
    """Return the maps that take every piece from the candidate with the least residual there, on each shape.

    orientations : with them a piece that a candidate turns inside out is taken from another one, if there is any.
        Residuals alone would not mind: what is mirrored as a whole fits as well but along its rim.
    """
    residuals = [embedding_residuals(source, target, maps) for maps in candidates]
    agreements = None if orientations is None else [orientations.agreements(maps) for maps in candidates]
    matches = [(maps.target_of_source, maps.source_of_target) for maps in candidates]
    forward, backward = (
        _chosen(
            basis,
            [pair[side] for pair in matches],
            [pair[side] for pair in residuals],
            None if agreements is None else [pair[side] for pair in agreements],
        )
        for side, basis in enumerate((source, target))
    )
    return SampleMaps(forward, backward)


def _chosen(
    basis: SampledBasis,
    matches: list[NDArray[np.int64]],
    residuals: list[NDArray[np.float32]],
    agreements: list[NDArray[np.float64]] | None,
) -> NDArray[np.int64]:
    weights, pieces = basis.samples.weights, basis.samples.patches

    def totals(values: list[Any]) -> NDArray[np.float64]:
        return np.stack([np.bincount(pieces, weights=weights * each) for each in values])

    costs = np.nan_to_num(totals(residuals), nan=np.inf, posinf=np.inf)
    if agreements is not None:
        turned = totals(agreements) < 0
        costs[turned & ~turned.all(axis=0)] = np.inf
    return np.stack(matches)[np.argmin(costs, axis=0)[pieces], np.arange(pieces.size)]


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
    spread, orders = (source.samples(), target.samples()), (source.order, target.order)
    low_x, low_y, high_x, high_y = (
        sampled_basis(backend, spectrum, own, order)
        for spectra in ((source.basis, target.basis), descriptors)
        for spectrum, own, order in zip(spectra, spread, orders, strict=True)
    )

    def settled(maps: SampleMaps, sizes: tuple[int, ...]) -> SampleMaps:
        return coherent_sample_steps(backend, high_x, high_y, maps, _up_to(sizes, high_x, high_y))

    grown = []
    for growth in GROWTHS:
        larger = up_sampled(backend, source, target, functional, min(size, GROWN), growth)
        started = nearest_samples(backend, low_x, low_y, (np.eye(len(larger)), orthogonalised(larger)))
        grown.append(settled(started, SETTLING))
    orientations = Orientations(low_x, low_y, source.orientation, target.orientation)
    maps = best_pieces(high_x, high_y, grown, orientations)
    for _ in range(GENERATIONS):
        lower = coherent_sample_steps(backend, low_x, low_y, maps, _up_to(LOW_REGROWTH, low_x, low_y))
        maps = best_pieces(high_x, high_y, [maps, settled(maps, REGROWTH), settled(lower, SETTLING)], orientations)
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
