"""Scores of many maps at once."""

from __future__ import annotations

import numpy as np
import pytest

from clalign.engine.kernels import Kernels
from clalign.engine.reference import Reference
from clalign.errors import InputError

FLOOR = 0.05


def distances(rng: np.random.Generator, count: int) -> np.ndarray:
    points = rng.random((count, 3))
    return np.linalg.norm(points[:, None] - points, axis=2)


@pytest.mark.parametrize(("p", "m", "maps"), [(1, 1, 1), (50, 97, 33), (257, 65, 97)])
@pytest.mark.parametrize("floor", [None, FLOOR, 1.0], ids=["squared", "relative", "high floor"])
def test_distortion_matches_twin(check, rng, p, m, maps, floor):
    index = rng.integers(0, p, size=(m, maps))
    check("distortion_batch", distances(rng, p), distances(rng, m), rng.random(m), index, floor)


@pytest.mark.parametrize(("p", "m", "maps"), [(1, 1, 1), (50, 97, 33), (257, 65, 97)])
def test_distance_matches_twin(check, rng, p, m, maps):
    check("map_distance", distances(rng, p), rng.random(m), rng.integers(0, p, size=(m, maps)))


def test_twins_are_the_literal_sums(reference: Reference, rng):
    dx, dy, w = distances(rng, 12), distances(rng, 9), rng.random(9)
    index = rng.integers(0, 12, size=(9, 4))
    squared = reference.distortion_batch(dx, dy, w, index)
    relative = reference.distortion_batch(dx, dy, w, index, FLOOR)
    between = reference.map_distance(dx, w, index)
    for b, chosen in enumerate(index.T):
        pairs = [(i, j, dx[chosen[i], chosen[j]], dy[i, j]) for i in range(9) for j in range(9)]
        assert squared[b] == pytest.approx(sum(w[i] * w[j] * (x - y) ** 2 for i, j, x, y in pairs))
        assert relative[b] == pytest.approx(sum(w[i] * w[j] * abs(x - y) / (x + y + FLOOR) for i, j, x, y in pairs))
        for a, other in enumerate(index.T):
            assert between[a, b] == pytest.approx(sum(w[i] * dx[other[i], chosen[i]] for i in range(9)))


def test_the_true_map_has_no_distortion(kernels: Kernels, rng):
    dx = distances(rng, 200)
    index = np.stack([np.arange(200), rng.permutation(200)], axis=1)
    w = kernels.array(np.full(200, 1 / 200))
    scores = kernels.numpy(kernels.distortion_batch(kernels.array(dx), kernels.array(dx), w, kernels.array(index)))
    assert scores[0] == 0
    assert scores[1] > 0.01


def test_a_floor_that_is_none_is_refused(kernels: Kernels):
    square, index = kernels.zeros((2, 2)), kernels.zeros((2, 1), np.int32)
    with pytest.raises(InputError, match="floor of relative distances must be positive"):
        kernels.distortion_batch(square, square, kernels.zeros(2), index, 0.0)
