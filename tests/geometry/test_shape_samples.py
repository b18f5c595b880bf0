"""Samples spread over a shape, and the order of its vertices."""

from __future__ import annotations

import numpy as np
from prepared import PreparedPair

from clalign.geometry.sampling import VertexOrder


def test_neighbours_come_near_each_other(rng: np.random.Generator) -> None:
    points = rng.random(size=(3000, 3))
    order = VertexOrder.spatial(points)
    np.testing.assert_array_equal(order.inverse[order.vertices], np.arange(3000))
    steps = np.linalg.norm(np.diff(points[order.vertices], axis=0), axis=1)
    assert steps.mean() < 0.4 * np.linalg.norm(np.diff(points, axis=0), axis=1).mean()


def test_samples_are_the_geodesic_ones_where_these_suffice(middle: PreparedPair) -> None:
    samples = middle.source.samples(100)
    patches = middle.source.patches(samples.vertices, 20)
    np.testing.assert_array_equal(samples.vertices, middle.source.geodesics.samples[:100])
    np.testing.assert_allclose(samples.weights.sum(), 1.0)
    # The first samples lie in their own patches, and every other one in that of the nearest of them.
    np.testing.assert_array_equal(patches[:20], np.arange(20))
    rows = middle.source.geodesics.rows[:20, samples.vertices]
    np.testing.assert_array_equal(rows[patches, np.arange(100)], rows.min(axis=0))


def test_missing_samples_are_spread_in_space(middle: PreparedPair) -> None:
    known = middle.source.geodesics.samples.size
    samples = middle.source.samples(known + 150)
    np.testing.assert_array_equal(samples.vertices[:known], middle.source.geodesics.samples)
    assert np.unique(samples.vertices).size == known + 150
    np.testing.assert_allclose(samples.weights.sum(), 1.0)
    # Spread evenly: no sample owns much more than its share.
    assert samples.weights.max() < 6.0 / samples.weights.size
    everything = middle.source.samples(10**6)
    np.testing.assert_array_equal(np.sort(everything.vertices), np.arange(middle.source.mesh.n_vertices))


def test_a_shape_makes_its_samples_and_its_order_once(middle: PreparedPair) -> None:
    shape = middle.source
    assert shape.order is shape.order
    assert shape.samples(100) is shape.samples(100)
    assert shape.samples(100) is not shape.samples(101)
