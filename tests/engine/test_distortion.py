"""The low-rank geodesic distortion and its gradient."""

from __future__ import annotations

import numpy as np
import pytest

from clalign.engine.reference import Reference


def factors(rng: np.random.Generator, n: int, r_x: int, r_y: int) -> tuple[np.ndarray, ...]:
    w = rng.random(n) + 0.1
    w /= w.sum()
    left = np.linalg.qr(rng.normal(size=(n, r_x)))[0] / np.sqrt(w)[:, None]
    core_x, core_y = rng.normal(size=(r_x, r_x)), rng.normal(size=(r_y, r_y))
    return rng.normal(size=(n, r_y)), core_y + core_y.T, left, core_x + core_x.T, w


@pytest.mark.parametrize(("n", "r_x", "r_y"), [(1, 1, 1), (97, 7, 5), (257, 50, 50), (1025, 25, 31)])
def test_matches_twin(check, rng, n, r_x, r_y):
    check("distortion", *factors(rng, n, r_x, r_y))


def test_twin_is_the_literal_sum(reference: Reference, rng):
    z, core_y, left, core_x, w = factors(rng, 40, 6, 5)
    difference = left @ core_x @ left.T - z @ core_y @ z.T
    value, _ = reference.distortion(z, core_y, left, core_x, w)
    assert float(value) == pytest.approx(w @ difference**2 @ w, rel=1e-12)


def test_gradient_twin_matches_finite_differences(reference: Reference, rng):
    z, *rest = factors(rng, 40, 6, 5)
    _, gradient = reference.distortion(z, *rest)
    step = 1e-6
    for _ in range(5):
        direction = rng.normal(size=z.shape)
        ahead, behind = (float(reference.distortion(z + sign * step * direction, *rest)[0]) for sign in (1, -1))
        assert (ahead - behind) / (2 * step) == pytest.approx(float(np.sum(gradient * direction)), rel=1e-6)


def test_a_perfect_map_has_no_distortion_in_single_precision(kernels, rng):
    """The form without cancellation stays near zero at the minimum, to the square of the precision."""
    _, _, left, core_x, w = factors(rng, 500, 20, 20)
    arrays = [kernels.array(a) for a in (left, core_x, left, core_x, w)]
    value, gradient = kernels.distortion(*arrays)
    assert float(value) < 1e-9 * np.sum(core_x**2)
    assert np.abs(kernels.numpy(gradient)).max() < 1e-4 * np.sum(core_x**2)
