"""The soft map as a quadratic form, its gradient, and the streamed form of both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from clalign.engine.kernels import Kernels
from clalign.engine.reference import Reference

SIZES = [(1, 1, 1, 1), (97, 60, 13, 7), (257, 97, 40, 50), (1025, 257, 24, 31)]


@dataclass(frozen=True)
class Problem:
    c: np.ndarray
    psi: np.ndarray
    w: np.ndarray
    u: np.ndarray
    dz: np.ndarray
    packed: np.ndarray
    normal: np.ndarray


def problem(rng: np.random.Generator, n: int, n_y: int, k: int, r: int) -> Problem:
    psi, w, u = rng.normal(size=(n_y, k)), rng.random(n_y), rng.normal(size=(n_y, r))
    packed = Reference().packed_moments(psi, w, u)
    normal = psi.T @ (w[:, None] * psi)
    return Problem(rng.normal(size=(n, k)), psi, w, u, rng.normal(size=(n, r)), packed, normal)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("with_normal", [True, False])
def test_forward_and_gradient_match_twin(check, rng, size, with_normal):
    p = problem(rng, *size)
    normal = p.normal if with_normal else None
    check("soft_map", p.c, p.packed, normal)
    z, s = Reference().soft_map(p.c, p.packed, normal)
    # With one function z does not depend on c: its gradient is zero, and only rounding would be compared.
    if p.c.shape[1] > 1:
        check("soft_map_gradient", p.c, p.packed, normal, z, s, p.dz)


@pytest.mark.parametrize("size", SIZES)
def test_streamed_forms_match_twin(check, rng, size):
    p = problem(rng, *size)
    check("soft_map_streamed", p.c, p.psi, p.w, p.u)
    z, s = Reference().soft_map_streamed(p.c, p.psi, p.w, p.u)
    if p.c.shape[1] > 1:
        check("soft_map_streamed_gradient", p.c, p.psi, p.w, p.u, z, s, p.dz)


def test_twin_is_the_literal_soft_map(reference: Reference, rng):
    """Eq. 15 and 27 with P stored: |q|² over its weighted column sum."""
    p = problem(rng, 30, 40, 6, 5)
    weights = p.w[:, None] * (p.psi @ p.c.T) ** 2
    soft = weights / weights.sum(axis=0)
    z, s = reference.soft_map(p.c, p.packed, p.normal)
    np.testing.assert_allclose(z, soft.T @ p.u, rtol=1e-10)
    np.testing.assert_allclose(s, weights.sum(axis=0), rtol=1e-12)
    streamed, sums = reference.soft_map_streamed(p.c, p.psi, p.w, p.u)
    np.testing.assert_allclose(streamed, z, rtol=1e-10)
    np.testing.assert_allclose(sums, s, rtol=1e-12)


@pytest.mark.parametrize("with_normal", [True, False])
def test_gradient_twin_matches_finite_differences(reference: Reference, rng, with_normal):
    p = problem(rng, 12, 30, 6, 5)
    normal = p.normal if with_normal else None

    def value(c: np.ndarray) -> float:
        return float(np.sum(reference.soft_map(c, p.packed, normal)[0] * p.dz))

    z, s = reference.soft_map(p.c, p.packed, normal)
    gradient = reference.soft_map_gradient(p.c, p.packed, normal, z, s, p.dz)
    step = 1e-6
    for _ in range(5):
        direction = rng.normal(size=p.c.shape)
        slope = (value(p.c + step * direction) - value(p.c - step * direction)) / (2 * step)
        assert slope == pytest.approx(float(np.sum(gradient * direction)), rel=1e-6)
    if with_normal:
        streamed = reference.soft_map_streamed_gradient(p.c, p.psi, p.w, p.u, z, s, p.dz)
        np.testing.assert_allclose(streamed, gradient, atol=1e-9 * np.abs(gradient).max())


def test_a_zero_row_maps_to_zero_without_nan(kernels: Kernels, rng):
    p = problem(rng, 20, 30, 6, 5)
    p.c[3] = 0
    c, packed, dz = kernels.array(p.c), kernels.array(p.packed), kernels.array(p.dz)
    z, s = kernels.soft_map(c, packed)
    gradient = kernels.numpy(kernels.soft_map_gradient(c, packed, None, z, s, dz))
    assert kernels.numpy(s)[3] == 0
    np.testing.assert_array_equal(kernels.numpy(z)[3], 0)
    np.testing.assert_array_equal(gradient[3], 0)
    assert np.isfinite(gradient).all()


def test_scale_of_c_does_not_matter(kernels: Kernels, rng):
    """z is invariant to the length of every c_j, so its gradient is orthogonal to c_j."""
    p = problem(rng, 50, 60, 12, 10)
    c, packed = kernels.array(p.c), kernels.array(p.packed)
    z, s = kernels.soft_map(c, packed)
    longer, _ = kernels.soft_map(kernels.array(4 * p.c), packed)
    np.testing.assert_array_equal(kernels.numpy(longer), kernels.numpy(z))
    gradient = kernels.numpy(kernels.soft_map_gradient(c, packed, None, z, s, kernels.array(p.dz)))
    lengths = np.linalg.norm(gradient, axis=1) * np.linalg.norm(p.c, axis=1)
    assert np.all(np.abs(np.sum(gradient * p.c, axis=1)) < 2e-5 * lengths)
