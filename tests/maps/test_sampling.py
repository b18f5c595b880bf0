"""Two-way steps on samples against those on all vertices."""

from __future__ import annotations

import dataclasses

import numpy as np
from prepared import PreparedPair

from clalign.engine import Reference
from clalign.geometry.sampling import Samples
from clalign.geometry.shape import Shape
from clalign.geometry.spectra import Spectrum
from clalign.maps.functional_maps import two_way_functional_map
from clalign.maps.point_maps import PointMaps
from clalign.maps.sampling import SampledBasis, nearest_samples, sample_functional_map, two_way_sample_steps

RIDGE = 1e-5


def all_vertices(shape: Shape) -> Samples:
    count = shape.mesh.n_vertices
    return Samples(np.arange(count), shape.mass)


def bound(spectrum: Spectrum, samples: Samples, shape: Shape, reference: Reference) -> SampledBasis:
    return SampledBasis.of(spectrum, samples, shape.order, reference)


def true_maps(pair: PreparedPair, source: Samples, target: Samples) -> PointMaps:
    return PointMaps(pair.truth.target_of_source[source.vertices], pair.truth.source_of_target[target.vertices])


def test_with_all_vertices_the_functional_map_is_that_of_the_full_step(
    middle: PreparedPair, reference: Reference, rng: np.random.Generator
) -> None:
    source, target, truth = middle
    x, y = (bound(shape.basis, all_vertices(shape), shape, reference) for shape in (source, target))
    maps = true_maps(middle, x.samples, y.samples)
    expected = two_way_functional_map(source.basis, target.basis, truth, 40)
    np.testing.assert_allclose(sample_functional_map(x, y, maps, 40, RIDGE), expected, atol=2e-5)


def test_functions_that_live_between_the_samples_leave_a_finite_map(middle: PreparedPair, reference: Reference) -> None:
    """More functions than samples: the sums over samples cannot tell them apart."""
    x, y = (bound(shape.basis, shape.samples(20), shape, reference) for shape in middle[:2])
    few = [dataclasses.replace(basis.samples, vertices=basis.samples.vertices[:12]) for basis in (x, y)]
    x, y = (
        bound(shape.basis, dataclasses.replace(samples, weights=samples.weights[:12]), shape, reference)
        for shape, samples in zip(middle[:2], few, strict=True)
    )
    functional = sample_functional_map(x, y, true_maps(middle, x.samples, y.samples), 40, RIDGE)
    assert np.isfinite(functional).all()
    assert np.linalg.norm(functional, 2) < 3.0


def test_a_shape_is_matched_with_itself(middle: PreparedPair, reference: Reference) -> None:
    basis = bound(middle.source.basis, middle.source.samples(100), middle.source, reference)
    maps = nearest_samples(basis, basis, (np.eye(40), np.eye(40)), None, reference)
    np.testing.assert_array_equal(maps.target_of_source, basis.samples.vertices)
    np.testing.assert_array_equal(maps.source_of_target, basis.samples.vertices)


def test_steps_repair_disturbed_maps(middle: PreparedPair, reference: Reference, rng: np.random.Generator) -> None:
    source, target, _ = middle
    x, y = (bound(shape.scale_invariant, shape.samples(1000), shape, reference) for shape in (source, target))
    truth = true_maps(middle, x.samples, y.samples)
    lost = rng.random(truth.target_of_source.size) < 0.3
    disturbed = dataclasses.replace(
        truth, target_of_source=np.where(lost, rng.permutation(truth.target_of_source), truth.target_of_source)
    )
    repaired = two_way_sample_steps(x, y, disturbed, (20, 40, 60), RIDGE, reference)
    assert (repaired.target_of_source == truth.target_of_source).mean() > 0.8
    assert (repaired.source_of_target == truth.source_of_target).mean() > 0.8
