"""The best of several maps, patch by patch.

A map can be right as a whole and wrong in a part: a hand with its fingers exchanged, an arm turned about its axis, a
snout with its sides exchanged, a sole that slid. Another ZoomOut schedule is wrong elsewhere. So the map is grown by
several, and every patch of the surface takes the map that explains it best, of those that do not turn it inside out.
The chosen map is grown again from its low functions, in a few ways, which forgets how its parts came about, and
compared with itself; whatever is better in a patch is kept.
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
from clalign.maps.functional_maps import polar_factor, singular_value_weighting, told_apart
from clalign.maps.nearest import point_maps
from clalign.maps.orientation import carried_products, index_pairs
from clalign.maps.point_maps import PointMaps
from clalign.maps.sampling import SampledBasis, nearest_samples, sample_functional_map, two_way_sample_steps
from clalign.refinement.zoomout import grown_map, sampled_bases
from clalign.rules import RefinementRules


def embedding_residuals(
    source: SampledBasis, target: SampledBasis, maps: PointMaps, rules: RefinementRules
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return how badly the maps' own functional map explains each match: (S_x,) and (S_y,) squared distances.

    Distances between matched points in the embeddings by all functions that the polar factor of the functional map
    turns onto each other. It is the compromise of the whole surface; where a part is turned or folded, no rotation of
    the functions brings both the part and its surroundings together. All directions weigh 1, so that maps can be
    compared: weighted by singular values a worse map would be forgiven more.
    """
    size = min(source.count, target.count, rules.compared)
    rotation = polar_factor(sample_functional_map(source, target, maps, size, rules.ridge)).astype(np.float32)
    at_x = source.at_samples(size) - target.functions[maps.target_of_source, :size] @ rotation
    at_y = target.at_samples(size) @ rotation - source.functions[maps.source_of_target, :size]
    return np.einsum("sk,sk->s", at_x, at_x), np.einsum("sk,sk->s", at_y, at_y)


Patches = tuple[NDArray[np.int64], NDArray[np.int64]]


@dataclass(frozen=True, eq=False)
class Orientations:
    """What tells whether a map keeps the orientation of a patch: triple products of the low LBO functions.

    Attributes
    ----------
    source, target : Laplace–Beltrami functions with the samples.
    source_tensor, target_tensor : (p, p, p), see `operators.orientation_tensor`.
    rules : how many products are compared.
    """

    source: SampledBasis
    target: SampledBasis
    source_tensor: NDArray[np.float64]
    target_tensor: NDArray[np.float64]
    rules: RefinementRules

    def agreements(self, maps: PointMaps) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return how far n · (∇φ_a × ∇φ_b) is carried along at each sample: (S_x,) and (S_y,), negative if turned over.

        The products of the first functions of the source are compared at matched vertices with those of what the map
        makes of them on the target, and multiplied by −1 where the map reverses the orientation as a whole.
        """
        size = min(len(self.source_tensor), len(self.target_tensor))
        functional = polar_factor(sample_functional_map(self.source, self.target, maps, size, self.rules.ridge))
        pairs = index_pairs(1, min(self.rules.oriented_products, size - 1))
        expected = self.source_tensor[pairs[:, 0], pairs[:, 1], :size]
        carried = carried_products(functional[None], self.target_tensor, pairs)[0, :, :size]
        own, others = self.source.at_samples(size), self.target.functions[maps.target_of_source, :size]
        at_x = np.einsum("sp,sp->s", own @ expected.T, others @ carried.T)
        own, others = self.target.at_samples(size), self.source.functions[maps.source_of_target, :size]
        at_y = np.einsum("sp,sp->s", own @ carried.T, others @ expected.T)
        whole = self.source.samples.weights @ at_x + self.target.samples.weights @ at_y
        return (-at_x, -at_y) if whole < 0 else (at_x, at_y)


def best_patches(
    source: SampledBasis,
    target: SampledBasis,
    patches: Patches,
    candidates: Sequence[PointMaps],
    rules: RefinementRules,
    orientations: Orientations | None = None,
) -> PointMaps:
    """Return the maps that take every patch from the candidate with the least residual there, on each shape.

    patches : (S_x,) and (S_y,), number of the patch that each sample lies in.
    orientations : with them a patch that a candidate turns inside out is taken from another one, if there is any.
        Residuals alone would not mind: what is mirrored as a whole fits as well but along its rim.
    """
    residuals = [embedding_residuals(source, target, maps, rules) for maps in candidates]
    agreements = None if orientations is None else [orientations.agreements(maps) for maps in candidates]
    matches = [(maps.target_of_source, maps.source_of_target) for maps in candidates]
    forward, backward = (
        _chosen(
            basis.samples.weights,
            patches[side],
            [pair[side] for pair in matches],
            [pair[side] for pair in residuals],
            None if agreements is None else [pair[side] for pair in agreements],
        )
        for side, basis in enumerate((source, target))
    )
    return PointMaps(forward, backward)


def _chosen(
    weights: NDArray[np.float64],
    patches: NDArray[np.int64],
    matches: list[NDArray[np.int64]],
    residuals: list[NDArray[np.float32]],
    agreements: list[NDArray[np.float64]] | None,
) -> NDArray[np.int64]:
    def totals(values: list[Any]) -> NDArray[np.float64]:
        return np.stack([np.bincount(patches, weights=weights * each) for each in values])

    costs = np.nan_to_num(totals(residuals), nan=np.inf, posinf=np.inf)
    if agreements is not None:
        inside_out = totals(agreements) < 0
        costs[inside_out & ~inside_out.all(axis=0)] = np.inf
    return np.stack(matches)[np.argmin(costs, axis=0)[patches], np.arange(patches.size)]


def patchwise_maps(
    source: Shape,
    target: Shape,
    scale_invariant: tuple[Spectrum, Spectrum],
    functional: NDArray[np.float64],
    size: int,
    rules: RefinementRules,
    backend: Backend,
) -> PointMaps:
    """Return the maps between all vertices that a functional map of the search leads to.

    Parameters
    ----------
    scale_invariant : eigenfunctions of both shapes, equally many.
    functional : (k, k), between Laplace–Beltrami functions.
    size : at most so many Laplace–Beltrami functions are used.
    """
    low = sampled_bases(source, target, (source.basis, target.basis), rules, backend)
    high = sampled_bases(source, target, scale_invariant, rules, backend)

    def settled(maps: PointMaps, bases: tuple[SampledBasis, SampledBasis], sizes: tuple[int, ...]) -> PointMaps:
        most = min(basis.count for basis in bases)
        cut = sorted({min(count, most) for count in sizes})
        return two_way_sample_steps(*bases, maps, cut, rules.ridge, backend)

    grown = []
    for schedule in rules.schedules:
        larger = grown_map(source, target, functional, min(size, rules.grown), schedule, rules, backend)
        started = nearest_samples(*low, (np.eye(len(larger)), polar_factor(larger)), None, backend)
        grown.append(settled(started, high, rules.settle))
    orientations = Orientations(*low, source.orientation, target.orientation, rules)
    patches = (
        source.patches(high[0].samples.vertices, rules.patches),
        target.patches(high[1].samples.vertices, rules.patches),
    )
    maps = best_patches(*high, patches, grown, rules, orientations)
    for _ in range(rules.generations):
        lower = settled(settled(maps, low, rules.regrow_low), high, rules.settle)
        maps = best_patches(*high, patches, [maps, settled(maps, high, rules.regrow), lower], rules, orientations)
    samples = sum(basis.samples.vertices.size for basis in high) // 2
    count = min(high[0].count, high[1].count, max(told_apart(samples), 1))
    factors = singular_value_weighting(sample_functional_map(*high, maps, count, rules.ridge))
    x, y = (basis.embedded(factor, backend) for basis, factor in zip(high, factors, strict=True))
    return point_maps(x, y, (source.order, target.order), backend=backend)
