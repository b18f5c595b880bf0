"""Packed moments of the target, and the gradient with respect to what they average."""

from __future__ import annotations

import numpy as np
import pytest

from clalign.engine.cpu_soft_maps import fitted_tile_rows
from clalign.engine.device_class import CPU, CPU_LONG_VECTORS
from clalign.engine.gpu_soft_maps import pair_blocks
from clalign.engine.launching import pair_runs
from clalign.engine.reference import Reference, pair_count, pair_factor

SIZES = [(1, 1, 1), (97, 13, 7), (257, 40, 50), (1025, 33, 25)]


@pytest.mark.parametrize(("n", "k", "r"), SIZES)
def test_matches_twin(check, rng, n, k, r):
    check("packed_moments", rng.normal(size=(n, k)), rng.random(n), rng.normal(size=(n, r)))


@pytest.mark.parametrize(("n", "k", "r"), SIZES)
def test_gradient_matches_twin(check, rng, n, k, r):
    check("packed_moments_gradient", rng.normal(size=(n, k)), rng.random(n), rng.normal(size=(pair_count(k), r)))


def test_twin_is_the_dense_definition(reference: Reference, rng):
    psi, w, u = rng.normal(size=(60, 7)), rng.random(60), rng.normal(size=(60, 4))
    packed = reference.packed_moments(psi, w, u)
    upper = np.triu_indices(7)
    for column in range(4):
        dense = psi.T @ np.diag(w * u[:, column]) @ psi
        np.testing.assert_allclose(packed[:, column], (dense * (2 - np.eye(7)))[upper], rtol=1e-12)


def test_gradient_twin_is_the_adjoint(reference: Reference, rng):
    """The moments are linear in u, so the gradient is their transpose exactly."""
    psi, w, u = rng.normal(size=(80, 9)), rng.random(80), rng.normal(size=(80, 5))
    slope = rng.normal(size=(pair_count(9), 5))
    forward = np.sum(reference.packed_moments(psi, w, u) * slope)
    backward = np.sum(reference.packed_moments_gradient(psi, w, slope) * u)
    assert forward == pytest.approx(backward, rel=1e-12)


@pytest.mark.parametrize("k", [1, 2, 8, 13, 40])
def test_runs_cover_every_pair(k):
    covered = {(a, b) for a, start in pair_runs(k, 8) for b in range(start, min(start + 8, k))}
    assert covered == {(a, b) for a in range(k) for b in range(a, k)}
    assert pair_factor(k, np.float64).sum() == k * k


@pytest.mark.parametrize("k", [1, 8, 13, 40])
def test_blocks_cover_every_pair_once(k):
    covered = [
        (a, b)
        for first_a, first_b in pair_blocks(k, 8)
        for a in range(first_a, first_a + 8)
        for b in range(first_b, first_b + 8)
        if a <= b < k
    ]
    assert sorted(covered) == [(a, b) for a in range(k) for b in range(a, k)]


def test_tiles_waste_little():
    assert [fitted_tile_rows(r, CPU.fitted_tile_rows) for r in (50, 100, 48, 5, 6)] == [5, 5, 6, 5, 6]
    longer = CPU_LONG_VECTORS.fitted_tile_rows
    assert [fitted_tile_rows(r, longer) for r in (50, 100, 48, 70, 7)] == [10, 10, 8, 10, 7]
