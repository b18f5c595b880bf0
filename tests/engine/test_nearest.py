"""Fused products that keep only the best point."""

from __future__ import annotations

import numpy as np
import pytest

from clalign.engine.kernels import Kernels


@pytest.mark.parametrize(("m", "p", "depth"), [(1, 1, 1), (97, 257, 9), (1025, 97, 50), (257, 1025, 352)])
def test_nearest_neighbour_scores_match_twin(check, rng, m, p, depth):
    queries, points = rng.normal(size=(m, depth)), rng.normal(size=(p, depth))
    index, _ = check("nearest", queries, points, 0.5 * np.sum(points**2, axis=1))
    assert index.dtype == np.int32


@pytest.mark.parametrize("weighted", [True, False])
def test_absolute_scores_match_twin(check, rng, weighted):
    weights = rng.random(257) if weighted else None
    check("nearest", rng.normal(size=(97, 40)), rng.normal(size=(257, 40)), weights, absolute=True)


def test_finds_every_point_itself(kernels: Kernels, rng):
    points = rng.normal(size=(1000, 30))
    penalty = 0.5 * np.sum(points**2, axis=1)
    order = rng.permutation(1000)
    index, score = kernels.nearest(kernels.array(points[order]), kernels.array(points), kernels.array(penalty))
    np.testing.assert_array_equal(kernels.numpy(index), order)
    np.testing.assert_allclose(kernels.numpy(score), penalty[order], rtol=1e-4)


@pytest.mark.parametrize("absolute", [False, True])
def test_ties_go_to_the_lowest_index(kernels: Kernels, rng, absolute):
    points = np.repeat(rng.normal(size=(1, 8)), 100, axis=0)
    points[:37] *= 0.5
    queries = np.repeat(points[-1:], 20, axis=0)
    index, _ = kernels.nearest(kernels.array(queries), kernels.array(points), absolute=absolute)
    np.testing.assert_array_equal(kernels.numpy(index), 37)


@pytest.mark.parametrize("absolute", [False, True])
def test_all_scores_zero_gives_the_first_point(kernels: Kernels, absolute):
    index, score = kernels.nearest(kernels.zeros((3, 4)), kernels.array(np.ones((33, 4))), absolute=absolute)
    np.testing.assert_array_equal(kernels.numpy(index), 0)
    np.testing.assert_array_equal(kernels.numpy(score), 0)


def test_negative_scores_still_name_a_point(kernels: Kernels, rng):
    """Padding beyond the last point must never win, however bad the true scores are."""
    points = rng.normal(size=(5, 3))
    index, score = kernels.nearest(
        kernels.array(rng.normal(size=(50, 3))), kernels.array(points), kernels.array(np.full(5, 1e6))
    )
    assert kernels.numpy(index).max() < 5
    assert kernels.numpy(score).max() < -1e5
