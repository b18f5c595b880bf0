"""Two-way steps on samples against those on all vertices."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray
from prepared import PreparedPair

from clalign.engine import Reference
from clalign.geometry.sampling import Samples
from clalign.geometry.shape import Shape
from clalign.maps.functional_maps import coherent_directions, orthogonalised, two_way_functional_map
from clalign.maps.sampling import (
    SampleMaps,
    coherent_factors,
    coherent_sample_steps,
    nearest_samples,
    quickly_orthogonalised,
    sample_functional_map,
    sampled_basis,
)


@pytest.fixture
def backend() -> Reference:
    return Reference()


def all_vertices(shape: Shape) -> Samples:
    count = shape.mesh.n_vertices
    return Samples(np.arange(count), shape.mass, np.zeros(count, dtype=np.int64))


def true_maps(pair: PreparedPair, source: Samples, target: Samples) -> SampleMaps:
    return SampleMaps(pair.truth.target_of_source[source.vertices], pair.truth.source_of_target[target.vertices])


def test_with_all_vertices_the_functional_map_is_that_of_the_full_step(
    middle: PreparedPair, backend: Reference, rng: np.random.Generator
) -> None:
    source, target, truth = middle
    x, y = (sampled_basis(backend, shape.basis, all_vertices(shape)) for shape in (source, target))
    maps = true_maps(middle, x.samples, y.samples)
    expected = two_way_functional_map(backend, source.basis, target.basis, truth, 40)
    np.testing.assert_allclose(sample_functional_map(x, y, maps, 40), expected, atol=2e-5)


def test_functions_that_live_between_the_samples_leave_a_finite_map(middle: PreparedPair, backend: Reference) -> None:
    """More functions than samples: the sums over samples cannot tell them apart."""
    x, y = (sampled_basis(backend, shape.basis, shape.samples(20, 5)) for shape in middle[:2])
    few = [dataclasses.replace(basis.samples, vertices=basis.samples.vertices[:12]) for basis in (x, y)]
    x, y = (
        sampled_basis(backend, shape.basis, dataclasses.replace(samples, weights=samples.weights[:12]))
        for shape, samples in zip(middle[:2], few, strict=True)
    )
    functional = sample_functional_map(x, y, true_maps(middle, x.samples, y.samples), 40)
    assert np.isfinite(functional).all()
    assert np.linalg.norm(functional, 2) < 3.0


@pytest.fixture
def functional(rng: np.random.Generator) -> NDArray[np.float64]:
    """Singular values from 0.1 to 1.3."""
    left, right = (np.linalg.qr(rng.normal(size=(9, 9)))[0] for _ in range(2))
    return left * np.linspace(0.1, 1.3, 9) @ right.T


def test_coherent_factors_are_the_coherent_directions(functional: NDArray[np.float64]) -> None:
    directions, (source, target) = coherent_directions(functional), coherent_factors(functional)
    np.testing.assert_allclose(source, directions.source, atol=1e-12)
    np.testing.assert_allclose(target, directions.target, atol=1e-12)


def test_the_quick_polar_factor_is_the_polar_factor(functional: NDArray[np.float64]) -> None:
    np.testing.assert_allclose(quickly_orthogonalised(functional), orthogonalised(functional), atol=1e-9)


def test_a_shape_is_matched_with_itself(middle: PreparedPair, backend: Reference) -> None:
    basis = sampled_basis(backend, middle.source.basis, middle.source.samples(100))
    maps = nearest_samples(backend, basis, basis, (np.eye(40), np.eye(40)))
    np.testing.assert_array_equal(maps.target_of_source, basis.samples.vertices)
    np.testing.assert_array_equal(maps.source_of_target, basis.samples.vertices)


def test_steps_repair_disturbed_maps(middle: PreparedPair, backend: Reference, rng: np.random.Generator) -> None:
    source, target, _ = middle
    x, y = (sampled_basis(backend, shape.descriptors, shape.samples()) for shape in (source, target))
    truth = true_maps(middle, x.samples, y.samples)
    lost = rng.random(truth.target_of_source.size) < 0.3
    disturbed = dataclasses.replace(
        truth, target_of_source=np.where(lost, rng.permutation(truth.target_of_source), truth.target_of_source)
    )
    repaired = coherent_sample_steps(backend, x, y, disturbed, (20, 40, 60))
    assert (repaired.target_of_source == truth.target_of_source).mean() > 0.8
    assert (repaired.source_of_target == truth.source_of_target).mean() > 0.8
