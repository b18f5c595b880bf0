"""Choosing maps patch by patch: what is right in some candidate is right in the result."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from prepared import PreparedPair, true_functional_map

from clalign.engine import Reference
from clalign.geometry.geodesics import all_pairs
from clalign.maps.point_maps import PointMaps
from clalign.maps.sampling import SampledBasis
from clalign.refinement.patches import Patches, best_patches, embedding_residuals, patchwise_maps
from clalign.rules import RefinementRules

RULES = RefinementRules()
PATCHES = 12


@pytest.fixture
def bases(middle: PreparedPair, reference: Reference) -> tuple[SampledBasis, SampledBasis]:
    source, target = (
        SampledBasis.of(shape.scale_invariant, shape.samples(1000), shape.order, reference) for shape in middle[:2]
    )
    return source, target


@pytest.fixture
def patches(middle: PreparedPair, bases: tuple[SampledBasis, SampledBasis]) -> Patches:
    x, y = (shape.patches(each.samples.vertices, PATCHES) for shape, each in zip(middle[:2], bases, strict=True))
    return x, y


def wrong_in(maps: PointMaps, patches: Patches, some: NDArray[np.int64], rng: np.random.Generator) -> PointMaps:
    """Exchange the matches inside some patches of both shapes at random."""

    def exchanged(matches: NDArray[np.int64], own: NDArray[np.int64]) -> NDArray[np.int64]:
        changed = matches.copy()
        inside = np.flatnonzero(np.isin(own, some))
        changed[inside] = matches[rng.permutation(inside)]
        return changed

    return PointMaps(exchanged(maps.target_of_source, patches[0]), exchanged(maps.source_of_target, patches[1]))


def test_every_patch_comes_from_the_candidate_that_is_right_there(
    middle: PreparedPair, bases: tuple[SampledBasis, SampledBasis], patches: Patches, rng: np.random.Generator
) -> None:
    truth = PointMaps(
        middle.truth.target_of_source[bases[0].samples.vertices],
        middle.truth.source_of_target[bases[1].samples.vertices],
    )
    candidates = [wrong_in(truth, patches, np.array(some), rng) for some in ((0, 3, 4), (1, 2), (5, 6, 7))]
    assert all((maps.target_of_source != truth.target_of_source).mean() > 0.1 for maps in candidates)
    best = best_patches(*bases, patches, candidates, RULES)
    np.testing.assert_array_equal(best.target_of_source, truth.target_of_source)
    np.testing.assert_array_equal(best.source_of_target, truth.source_of_target)
    for maps, some in zip(candidates, ((0, 3, 4), (1, 2), (5, 6, 7)), strict=True):
        residual, _ = embedding_residuals(*bases, maps, RULES)
        wrong = np.isin(patches[0], some)
        assert residual[wrong].mean() > 3.0 * residual[~wrong].mean()


def test_patchwise_maps_sharpen_a_coarse_map(
    middle: PreparedPair, reference: Reference, rng: np.random.Generator
) -> None:
    source, target, truth = middle
    coarse = true_functional_map(source.basis, target.basis, truth.source_of_target, 12)
    coarse += 0.1 * rng.normal(size=coarse.shape)
    invariant = source.scale_invariant, target.scale_invariant
    maps = patchwise_maps(source, target, invariant, coarse, 60, RULES, reference)
    distances = all_pairs(target.mesh)
    # Neighbouring vertices are about 0.04 apart.
    assert distances[maps.target_of_source, truth.target_of_source].mean() < 0.01
    assert (maps.source_of_target == truth.source_of_target).mean() > 0.8
    again = patchwise_maps(source, target, invariant, coarse, 60, RULES, reference)
    np.testing.assert_array_equal(again.target_of_source, maps.target_of_source)
