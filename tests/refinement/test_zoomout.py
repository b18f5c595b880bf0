"""ZoomOut schedules and two-way steps, started from maps that are right but coarse, or disturbed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from prepared import PreparedPair, true_functional_map

from clalign.engine import Reference
from clalign.geometry.geodesics import all_pairs
from clalign.maps.point_maps import PointMaps
from clalign.refinement.zoomout import (
    BoundSpectra,
    best_grown_map,
    grown_map,
    joint_step,
    two_way_step,
    two_way_steps,
    vertex_maps,
)
from clalign.rules import RefinementRules, Rules, ZoomOutSchedule

RULES = RefinementRules()


@pytest.fixture(scope="module")
def distances(middle: PreparedPair) -> NDArray[np.float64]:
    return all_pairs(middle.target.mesh)


def disturbed(truth: PointMaps, share: float, rng: np.random.Generator) -> PointMaps:
    """Send a share of the vertices of each side anywhere."""

    def some(index: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.where(rng.random(index.size) < share, rng.integers(0, index.size, index.size), index)

    return PointMaps(some(truth.target_of_source), some(truth.source_of_target))


def test_up_sampling_sharpens_a_coarse_map(
    middle: PreparedPair, distances: NDArray[np.float64], reference: Reference, rng: np.random.Generator
) -> None:
    source, target, truth = middle
    coarse = true_functional_map(source.basis, target.basis, truth.source_of_target, 10)
    coarse += 0.2 * rng.normal(size=coarse.shape)
    fine = grown_map(source, target, coarse, 60, ZoomOutSchedule(step=10), RULES, reference)
    assert fine.shape == (60, 60)

    def error(functional: NDArray[np.float64]) -> float:
        found = vertex_maps(source, target, functional, reference).target_of_source
        return float(distances[found, truth.target_of_source].mean())

    # Neighbouring vertices are about 0.04 apart.
    assert error(coarse) > 0.02
    assert error(fine) < 0.01


def test_up_sampling_stops_at_what_a_small_shape_has(middle: PreparedPair, reference: Reference) -> None:
    source, target, truth = middle
    coarse = true_functional_map(source.basis, target.basis, truth.source_of_target, 10)
    assert grown_map(source, target, coarse, 500, RULES.schedules[0], RULES, reference).shape == (60, 60)
    assert grown_map(source, target, coarse, 35, RULES.schedules[0], RULES, reference).shape == (35, 35)


def test_the_schedule_that_scores_best_is_taken(middle: PreparedPair, reference: Reference) -> None:
    """One that keeps three functions and listens to curvature alone is wrong, wherever it stands in the list."""
    source, target, truth = middle
    coarse = true_functional_map(source.basis, target.basis, truth.source_of_target, 12)
    good, bad = ZoomOutSchedule(None, 20), ZoomOutSchedule(3, 40, 1e4)
    expected = grown_map(source, target, coarse, 60, good, RULES, reference)
    for order in ((good, bad), (bad, good)):
        rules = Rules(refinement=replace(RULES, schedules=order))
        np.testing.assert_array_equal(best_grown_map(source, target, coarse, 60, rules, reference), expected)


def test_two_way_steps_repair_a_disturbed_map(
    middle: PreparedPair, distances: NDArray[np.float64], reference: Reference, rng: np.random.Generator
) -> None:
    source, target, truth = middle
    maps = disturbed(truth, 0.3, rng)
    spectra = BoundSpectra.of(source.scale_invariant, target.scale_invariant, reference)
    orders = source.order, target.order
    repaired = two_way_steps(spectra, maps, 2, orders, reference)
    assert distances[maps.target_of_source, truth.target_of_source].mean() > 0.1
    assert distances[repaired.target_of_source, truth.target_of_source].mean() < 0.01
    assert (repaired.source_of_target == truth.source_of_target).mean() > 0.8
    assert two_way_steps(spectra, maps, 0, orders, reference) is maps


def test_a_joint_step_hears_both_bases(
    middle: PreparedPair, distances: NDArray[np.float64], reference: Reference, rng: np.random.Generator
) -> None:
    """Its embeddings are those of a step in either basis side by side, and its matches the nearest rows of them."""
    source, target, truth = middle
    maps = disturbed(truth, 0.3, rng)
    spectra = BoundSpectra.of(source.scale_invariant, target.scale_invariant, reference)
    low = BoundSpectra.of(source.basis.head(40), target.basis.head(40), reference)
    found, (x, y) = joint_step(source, target, spectra, 40, maps, reference)
    orders = source.order, target.order
    _, of_high = two_way_step(spectra, maps, orders, reference)
    _, of_low = two_way_step(low, maps, orders, reference)
    for side, joined in enumerate((x, y)):
        np.testing.assert_allclose(joined, np.concatenate([of_high[side], of_low[side]], axis=1), atol=1e-9)
    squares = (x**2).sum(axis=1)[:, None] - 2 * x @ y.T + (y**2).sum(axis=1)
    np.testing.assert_array_equal(found.target_of_source, squares.argmin(axis=1))
    np.testing.assert_array_equal(found.source_of_target, squares.argmin(axis=0))
    assert distances[found.target_of_source, truth.target_of_source].mean() < 0.01
