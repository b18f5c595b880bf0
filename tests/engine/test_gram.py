"""Weighted Gram matrices, cut along the rows or not."""

from __future__ import annotations

import numpy as np
import pytest


@pytest.mark.parametrize(("n", "p", "q"), [(1, 1, 1), (97, 13, 257), (1025, 50, 50), (6890, 9, 20), (2000, 120, 97)])
@pytest.mark.parametrize("weighted", [True, False])
def test_matches_twin(check, rng, n, p, q, weighted):
    weights = rng.random(n) if weighted else None
    check("weighted_gram", rng.normal(size=(n, p)), rng.normal(size=(n, q)), weights)


def test_orthonormal_columns_give_the_identity(kernels, rng):
    w = rng.random(3000)
    basis = np.linalg.qr(rng.normal(size=(3000, 40)))[0] / np.sqrt(w)[:, None]
    a = kernels.array(basis)
    np.testing.assert_allclose(kernels.numpy(kernels.weighted_gram(a, a, kernels.array(w))), np.eye(40), atol=2e-5)
