"""Fused products that keep only the best point."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clalign.engine import cpu_searches
from clalign.engine.device import Device
from clalign.engine.kernels import Kernels
from clalign.engine.reference import Reference


@pytest.mark.parametrize(
    ("m", "p", "depth"), [(1, 1, 1), (97, 257, 9), (1025, 97, 50), (257, 1025, 352), (5000, 97, 20)]
)
def test_nearest_neighbour_scores_match_twin(check, rng, m, p, depth):
    queries, points = rng.normal(size=(m, depth)), rng.normal(size=(p, depth))
    index, _ = check("nearest", queries, points, 0.5 * np.sum(points**2, axis=1))
    assert index.dtype == np.int32


@pytest.mark.parametrize(("n", "n_y", "k"), [(1, 1, 1), (97, 257, 40), (1025, 5, 9), (33, 1025, 121)])
def test_argmax_of_the_soft_map_matches_twin(check, rng, n, n_y, k):
    index, _ = check("soft_map_argmax", rng.normal(size=(n, k)), rng.normal(size=(n_y, k)), rng.random(n_y))
    assert index.dtype == np.int32


def test_twin_of_the_argmax_is_that_of_the_stored_soft_map(reference: Reference, rng):
    """Eq. 16 and 28: the column sums that make P of the weighted squares do not move the arg-max of a column."""
    c, psi, w = rng.normal(size=(30, 6)), rng.normal(size=(40, 6)), rng.random(40)
    weights = w[:, None] * (psi @ c.T) ** 2
    index, score = reference.soft_map_argmax(c, psi, w)
    np.testing.assert_array_equal(index, np.argmax(weights / weights.sum(axis=0), axis=0))
    np.testing.assert_allclose(score, weights.max(axis=0), rtol=1e-12)


def best(kernels: Kernels, operation: str, queries: np.ndarray, points: np.ndarray) -> list[np.ndarray]:
    """Index and score without penalty, or with equal weights."""
    arrays = [kernels.array(queries), kernels.array(points)]
    if operation == "soft_map_argmax":
        arrays.append(kernels.array(np.ones(len(points))))
    return [kernels.numpy(part) for part in getattr(kernels, operation)(*arrays)]


def test_finds_every_point_itself(kernels: Kernels, rng):
    points = rng.normal(size=(1000, 30))
    penalty = 0.5 * np.sum(points**2, axis=1)
    order = rng.permutation(1000)
    index, score = kernels.nearest(kernels.array(points[order]), kernels.array(points), kernels.array(penalty))
    np.testing.assert_array_equal(kernels.numpy(index), order)
    np.testing.assert_allclose(kernels.numpy(score), penalty[order], rtol=1e-4)


@pytest.mark.parametrize("kernels", ["cpu", "gpu"], indirect=True)
@pytest.mark.parametrize("operation", ["nearest", "soft_map_argmax"])
def test_ties_go_to_the_lowest_index(kernels: Kernels, rng, operation):
    points = np.repeat(rng.normal(size=(1, 8)), 100, axis=0)
    points[:37] *= 0.5
    queries = np.repeat(points[-1:], 20, axis=0)
    index, _ = best(kernels, operation, queries, points)
    np.testing.assert_array_equal(index, 37)


@pytest.mark.parametrize("kernels", ["cpu", "gpu"], indirect=True)
@pytest.mark.parametrize("count", [5, 33])
@pytest.mark.parametrize("operation", ["nearest", "soft_map_argmax"])
def test_all_scores_zero_gives_the_first_point(kernels: Kernels, operation, count):
    index, score = best(kernels, operation, np.zeros((3, 4)), np.ones((count, 4)))
    np.testing.assert_array_equal(index, 0)
    np.testing.assert_array_equal(score, 0)


@pytest.mark.parametrize("kernels", ["cpu", "gpu"], indirect=True)
def test_negative_scores_still_name_a_point(kernels: Kernels, rng):
    """Padding beyond the last point must never win, however bad the true scores are."""
    points = rng.normal(size=(5, 3))
    index, score = kernels.nearest(
        kernels.array(rng.normal(size=(50, 3))), kernels.array(points), kernels.array(np.full(5, 1e6))
    )
    assert kernels.numpy(index).max() < 5
    assert kernels.numpy(score).max() < -1e5


def close_pairs(rng, m, p, depth):
    """Queries near points of their own: almost every tile can be given up early."""
    points = rng.normal(size=(p, depth))
    return points[rng.integers(0, p, size=m)] + 0.3 * rng.normal(size=(m, depth)), points


def decided_late(rng, m, p, depth):
    """Rows that differ in their last components only, by little: no tile can be given up early."""
    points = np.repeat(rng.normal(size=(1, depth)), p, axis=0)
    points[:, -3:] += 0.05 * rng.normal(size=(p, 3))
    return points[rng.integers(0, p, size=m)] + 1e-3 * rng.normal(size=(m, depth)), points


def tail_heavy(rng, m, p, depth):
    """Almost all of a row's length lies behind the first checks."""
    points = rng.normal(size=(p, depth)) * np.where(np.arange(depth) < 100, 0.01, 1.0)
    return points[rng.integers(0, p, size=m)] + 0.3 * rng.normal(size=(m, depth)), points


def far_from_the_origin(rng, m, p, depth):
    """Large norms and penalties, of which only small differences count."""
    queries, points = close_pairs(rng, m, p, depth)
    return queries + 30.0, points + 30.0


@pytest.mark.usefixtures("opencl")
@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("make", [close_pairs, decided_late, tail_heavy, far_from_the_origin])
@pytest.mark.parametrize("with_penalty", [True, False])
@pytest.mark.parametrize("depth", [49, 97, 352])
def test_giving_up_tiles_changes_no_bit(monkeypatch, rng, precision, make, with_penalty, depth):
    on_device = Kernels(Device(precision=precision, kind="cpu"))
    launcher = on_device._launcher
    # More rows than one work-item takes, be it with 8 or with 32 groups of them.
    queries, points = make(rng, 203, 1337, depth)
    arrays = [on_device.array(queries), on_device.array(points)]
    if with_penalty:
        arrays.append(on_device.array(0.5 * np.sum(points**2, axis=1)))
    found = []
    for groups in sorted(set(launcher.constants.nearest_groups)):
        constants = replace(launcher.constants, nearest_groups=(groups, groups))
        with monkeypatch.context() as patch:
            patch.setattr(launcher, "constants", constants)
            found.append([on_device.numpy(part) for part in on_device.nearest(*arrays)])
    # Good guesses, which are the result, bad ones, and none.
    guesses = found[0][0].copy()
    guesses[1::3] = rng.integers(0, 1337, size=guesses[1::3].size)
    guesses[2::3] = -1
    for guess in (found[0][0], guesses):
        found.append([on_device.numpy(part) for part in on_device.nearest(*arrays, guess=on_device.array(guess))])
    monkeypatch.setattr(cpu_searches, "CHECK_STEPS", depth)
    full = [on_device.numpy(part) for part in on_device.nearest(*arrays)]
    for early in found:
        for part, whole in zip(early, full, strict=True):
            np.testing.assert_array_equal(part, whole)


def test_copies_of_a_point_far_apart_end_at_the_first(kernels: Kernels, rng):
    queries, points = close_pairs(rng, 40, 700, 200)
    twice = kernels.array(np.concatenate([points, points]))
    penalty = kernels.array(np.tile(0.5 * np.sum(points**2, 1), 2))
    index, _ = kernels.nearest(kernels.array(queries), twice, penalty)
    assert kernels.numpy(index).max() < 700
    # Though the guess is as good.
    later = kernels.array(kernels.numpy(index) + 700)
    again, _ = kernels.nearest(kernels.array(queries), twice, penalty, guess=later)
    np.testing.assert_array_equal(kernels.numpy(again), kernels.numpy(index))


def test_guesses_outside_the_points_and_rows_of_zeros_change_nothing(kernels: Kernels, rng):
    points = rng.normal(size=(333, 100))
    queries = np.concatenate([np.zeros((2, 100)), points[:5]])
    arrays = [kernels.array(each) for each in (queries, points)]
    expected, _ = kernels.nearest(*arrays)
    found, _ = kernels.nearest(*arrays, guess=kernels.array(np.array([300, -1, 333, -5, 1 << 30, 4, 0])))
    np.testing.assert_array_equal(kernels.numpy(found), kernels.numpy(expected))
