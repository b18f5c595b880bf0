"""Up-sampling and closed-form steps, started from maps that are right but coarse, or disturbed."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from prepared import PreparedPair

from clalign.alignment.band import band_mask, funnel_band
from clalign.engine import Reference
from clalign.geometry.geodesics import all_pairs
from clalign.maps.functional_maps import PointMaps, functional_map, point_maps
from clalign.options import AlignmentOptions
from clalign.refinement import zoomout as refine
from clalign.refinement.zoomout import (
    Growth,
    best_grown,
    closed_form_rotation,
    coherent_steps,
    up_sampled,
    vertex_maps,
    wavelet_steps,
)


@pytest.fixture(scope="module")
def distances(middle: PreparedPair) -> NDArray[np.float64]:
    return all_pairs(middle.target.mesh)


@pytest.fixture
def backend() -> Reference:
    return Reference()


def disturbed(truth: PointMaps, share: float, rng: np.random.Generator) -> PointMaps:
    """Send a share of the vertices of each side anywhere."""

    def some(index: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.where(rng.random(index.size) < share, rng.integers(0, index.size, index.size), index)

    return PointMaps(some(truth.target_of_source), some(truth.source_of_target))


def test_up_sampling_sharpens_a_coarse_map(
    middle: PreparedPair, distances: NDArray[np.float64], backend: Reference, rng: np.random.Generator
) -> None:
    source, target, truth = middle
    coarse = functional_map(source.basis, target.basis, truth.source_of_target, 10)
    coarse += 0.2 * rng.normal(size=coarse.shape)
    fine = up_sampled(backend, source, target, coarse, 60, Growth(step=10))
    assert fine.shape == (60, 60)

    def error(functional: NDArray[np.float64]) -> float:
        found = vertex_maps(backend, source, target, functional).target_of_source
        return float(distances[found, truth.target_of_source].mean())

    # Neighbouring vertices are about 0.04 apart.
    assert error(coarse) > 0.02
    assert error(fine) < 0.01


def test_up_sampling_stops_at_what_a_small_shape_has(middle: PreparedPair, backend: Reference) -> None:
    source, target, truth = middle
    coarse = functional_map(source.basis, target.basis, truth.source_of_target, 10)
    assert up_sampled(backend, source, target, coarse, 500).shape == (60, 60)
    assert up_sampled(backend, source, target, coarse, 35).shape == (35, 35)


def test_the_growth_that_scores_best_is_taken(
    middle: PreparedPair, backend: Reference, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that keeps three functions and listens to curvature alone is wrong, wherever it stands in the list."""
    source, target, truth = middle
    coarse = functional_map(source.basis, target.basis, truth.source_of_target, 12)
    good, bad = Growth(None, 20), Growth(3, 40, 1e4)
    expected = up_sampled(backend, source, target, coarse, 60, good)
    for order in ((good, bad), (bad, good)):
        monkeypatch.setattr(refine, "GROWTHS", order)
        np.testing.assert_array_equal(best_grown(backend, source, target, coarse, 60), expected)


def test_coherent_steps_repair_a_disturbed_map(
    middle: PreparedPair, distances: NDArray[np.float64], backend: Reference, rng: np.random.Generator
) -> None:
    source, target, truth = middle
    maps = disturbed(truth, 0.3, rng)
    repaired = coherent_steps(backend, source.descriptors, target.descriptors, maps, 2)
    assert distances[maps.target_of_source, truth.target_of_source].mean() > 0.1
    assert distances[repaired.target_of_source, truth.target_of_source].mean() < 0.01
    assert (repaired.source_of_target == truth.source_of_target).mean() > 0.8
    unchanged = coherent_steps(backend, source.descriptors, target.descriptors, maps, 0)
    assert unchanged is maps


def test_wavelet_steps_repair_a_disturbed_map(
    middle: PreparedPair, distances: NDArray[np.float64], backend: Reference, rng: np.random.Generator
) -> None:
    source, target, truth = middle
    repaired = wavelet_steps(backend, source, target, disturbed(truth, 0.3, rng), 2)
    assert distances[repaired.target_of_source, truth.target_of_source].mean() < 0.02


@pytest.mark.parametrize("one_sided", [False, True])
def test_the_closed_form_rotation_aligns(middle: PreparedPair, backend: Reference, one_sided: bool) -> None:
    """Nearest neighbours among the functions it aligns are the true matches, or next to them."""
    source, target, truth = middle
    count = 40
    band = funnel_band(count, AlignmentOptions())
    start = closed_form_rotation(backend, source.descriptors, target.descriptors, truth, band, one_sided)
    assert not start.rotation[~band_mask(band)].any()
    turned = source.descriptors.functions[:, :count] * start.signs @ start.rotation
    other = target.descriptors.functions[:, :count]
    found = point_maps(backend, turned, other if one_sided else other @ start.rotation.T)
    assert (found.target_of_source == truth.target_of_source).mean() > 0.8
    before = point_maps(backend, source.descriptors.functions[:, :count], other)
    assert (before.target_of_source == truth.target_of_source).mean() < 0.2
