"""What the losses read of a shape: projections, weights, distance factors at the samples."""

from __future__ import annotations

import numpy as np
import pytest
from prepared import MIDDLE, PreparedPair, tiny_pair

from clalign.alignment.problem_data import sampled_factors, shape_data
from clalign.geometry.geodesics import all_pairs
from clalign.geometry.shape import prepare
from clalign.mesh.mesh import mesh_from_arrays


@pytest.mark.parametrize("weights", ["area", "uniform"])
@pytest.mark.parametrize("samples", [0, 100])
def test_sampled_factors_are_the_same_distances(middle: PreparedPair, samples: int, weights: str) -> None:
    """Made orthonormal at the samples, the factors still give the distances there, to about a percent."""
    shape = middle.source
    options = MIDDLE.replace({"alignment.samples": samples, "alignment.weights": weights}).alignment
    found = sampled_factors(shape, options)
    assert found.weights.sum() == pytest.approx(1.0)
    assert found.vertices.size == (samples or shape.mesh.n_vertices)
    identity = np.eye(found.left.shape[1])
    np.testing.assert_allclose(found.left.T @ (found.weights[:, None] * found.left), identity, atol=1e-8)
    rows = shape.factors.left[found.vertices]
    np.testing.assert_allclose(found.left @ found.core @ found.left.T, rows @ shape.factors.core @ rows.T, atol=1e-8)
    exact = all_pairs(shape.mesh)[np.ix_(found.vertices, found.vertices)]
    residual = found.left @ found.core @ found.left.T - exact
    assert np.linalg.norm(residual) < 0.02 * np.linalg.norm(exact)


def test_all_vertices_are_taken_where_the_geodesic_samples_are_all() -> None:
    """Whatever number of samples was asked for."""
    options = MIDDLE.replace({"geodesics.search_samples": 500, "alignment.samples": 50})
    shape = prepare(mesh_from_arrays(*tiny_pair().source), options)
    found = sampled_factors(shape, options.alignment)
    np.testing.assert_array_equal(found.vertices, np.arange(shape.mesh.n_vertices))
    np.testing.assert_array_equal(found.weights, shape.mass)


def test_samples_spread_over_the_surface(middle: PreparedPair) -> None:
    """They are farthest-point samples, so that numbering does not matter, weighted by the area they stand for."""
    shape = middle.source
    found = sampled_factors(shape, MIDDLE.replace({"alignment.samples": 50}).alignment)
    np.testing.assert_array_equal(found.vertices, shape.geodesics.samples[:50])
    gaps = all_pairs(shape.mesh)[found.vertices].min(axis=0)
    # Fifty discs of this radius would cover the unit area twice.
    assert gaps.max() < np.sqrt(2.0 / (50 * np.pi)) * 1.5
    assert found.weights.max() < 0.06


@pytest.mark.parametrize("weights", ["area", "uniform"])
def test_projection_and_weights(middle: PreparedPair, weights: str) -> None:
    shape = middle.source
    options = MIDDLE.replace({"alignment.weights": weights}).alignment
    side = shape_data(shape, 30, shape.scale_invariant.functions[:, :40], options)
    expected = shape.basis.functions[:, :30].T @ np.diag(shape.mass) @ shape.scale_invariant.functions[:, :40]
    np.testing.assert_allclose(side.projection, expected, atol=1e-12)
    assert side.loss_weights.sum() == pytest.approx(1.0)
    normal = np.eye(30) if side.normal is None else side.normal
    np.testing.assert_allclose(side.basis.T @ (side.soft_weights[:, None] * side.basis), normal, atol=1e-8)
