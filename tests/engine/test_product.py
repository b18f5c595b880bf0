"""Dense products: every transposition, odd sizes, scale and accumulation."""

from __future__ import annotations

import numpy as np
import pytest

from clalign.engine.kernels import Kernels
from clalign.errors import InputError

SHAPES = [(1, 1, 1), (97, 257, 5), (257, 97, 300), (6, 16, 513), (1025, 33, 120), (120, 352, 352)]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("transpose_a", [False, True])
@pytest.mark.parametrize("transpose_b", [False, True])
def test_matches_twin(check, rng, shape, transpose_a, transpose_b):
    m, n, depth = shape
    a = rng.normal(size=(depth, m) if transpose_a else (m, depth))
    b = rng.normal(size=(n, depth) if transpose_b else (depth, n))
    check("product", a, b, transpose_a=transpose_a, transpose_b=transpose_b, scale=-0.75)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("transpose_b", [False, True])
def test_leading_columns_match_twin(check, rng, shape, transpose_b):
    m, n, depth = shape
    b = rng.normal(size=(n, depth) if transpose_b else (depth, n))
    check("product", rng.normal(size=(m, depth + 7)), b, transpose_b=transpose_b, leading=True)


def test_accumulates_into_out(kernels: Kernels, rng):
    a, b, c = rng.normal(size=(50, 700)), rng.normal(size=(700, 41)), rng.normal(size=(50, 41))
    out = kernels.array(c)
    returned = kernels.product(kernels.array(a), kernels.array(b), scale=2.0, accumulate=True, out=out)
    assert returned is out
    np.testing.assert_allclose(kernels.numpy(out), c + 2 * a @ b, rtol=0, atol=2e-6 * np.abs(a @ b).max())


@pytest.mark.parametrize("kernels", ["cpu", "gpu"], indirect=True)
def test_writes_only_its_own_matrix(kernels: Kernels, rng):
    """Rows and columns beyond the last full tile must not spill into what follows in memory."""
    a, b = rng.normal(size=(7, 30)), rng.normal(size=(30, 17))
    memory = kernels.array(np.full(7 * 17 + 64, 5.0))
    kernels.product(kernels.array(a), kernels.array(b), out=memory.leading((7, 17)))
    np.testing.assert_array_equal(kernels.numpy(memory)[7 * 17 :], 5.0)


def test_shapes_that_do_not_fit_are_refused(kernels: Kernels):
    for leading in ({}, {"leading": True}):
        with pytest.raises(InputError, match=r"product: b has shape"):
            kernels.product(kernels.zeros((3, 4)), kernels.zeros((5, 3)), **leading)
    with pytest.raises(InputError, match=r"product: out has shape \(2, 2\), needed is \(3, 3\)"):
        kernels.product(kernels.zeros((3, 4)), kernels.zeros((4, 3)), out=kernels.zeros((2, 2)))
