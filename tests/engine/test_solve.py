"""Solving with a positive definite Gram matrix."""

from __future__ import annotations

import numpy as np
import pytest

from clalign.engine.kernels import Kernels


@pytest.mark.parametrize(("m", "k"), [(1, 1), (97, 13), (120, 120), (33, 200), (257, 97)])
def test_matches_twin(check, rng, m, k):
    left = rng.normal(size=(k, 3 * k))
    check("solve_right", left @ left.T, rng.normal(size=(m, k)), 1e-4)


def test_undoes_the_product(kernels: Kernels, rng):
    left = rng.normal(size=(60, 200))
    gram, x = left @ left.T, rng.normal(size=(25, 60))
    ridge = 0.1
    shifted = gram + ridge * np.trace(gram) / 60 * np.eye(60)
    solved = kernels.solve_right(kernels.array(gram), kernels.array(x @ shifted), ridge)
    np.testing.assert_allclose(kernels.numpy(solved), x, atol=5e-5)


@pytest.mark.parametrize("kernels", ["cpu", "gpu"], indirect=True)
def test_an_indefinite_matrix_gives_nan(kernels: Kernels):
    gram = np.diag([1.0, -1.0, 2.0])
    solved = kernels.numpy(kernels.solve_right(kernels.array(gram), kernels.array(np.ones((4, 3))), 0.0))
    assert np.isnan(solved).any()
