"""Weighted Gram matrices, cut along the rows or not."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest


@pytest.mark.parametrize(
    ("n", "p", "q"), [(1, 1, 1), (97, 13, 257), (1025, 50, 50), (6890, 9, 20), (2000, 120, 97), (1300, 352, 120)]
)
@pytest.mark.parametrize("weighted", [True, False])
def test_matches_twin(check, rng, n, p, q, weighted):
    weights = rng.random(n) if weighted else None
    check("weighted_gram", rng.normal(size=(n, p)), rng.normal(size=(n, q)), weights)


def test_orthonormal_columns_give_the_identity(kernels, rng):
    w = rng.random(3000)
    basis = np.linalg.qr(rng.normal(size=(3000, 40)))[0] / np.sqrt(w)[:, None]
    a = kernels.array(basis)
    np.testing.assert_allclose(kernels.numpy(kernels.weighted_gram(a, a, kernels.array(w))), np.eye(40), atol=2e-5)


@pytest.mark.parametrize(("n", "k"), [(1, 3), (97, 13), (1025, 50), (2001, 121)])
@pytest.mark.parametrize("weighted", [True, False])
def test_with_itself_is_the_same_and_symmetric(kernels, rng, n, k, weighted):
    """The lower triangle is mirrored, not computed, where both sides are one array."""
    a, weights = kernels.array(rng.normal(size=(n, k))), kernels.array(rng.random(n)) if weighted else None
    mirrored = kernels.numpy(kernels.weighted_gram(a, a, weights))
    whole = kernels.numpy(kernels.weighted_gram(a, kernels.array(kernels.numpy(a)), weights))
    np.testing.assert_array_equal(mirrored, mirrored.T)
    np.testing.assert_allclose(mirrored, whole, rtol=0, atol=5e-6 * np.abs(whole).max())


def test_a_leading_part_of_the_same_memory_is_another_matrix(kernels, rng):
    a = kernels.array(rng.normal(size=(300, 20)))
    part = a.reshape(600, 10).leading((300, 10))
    expected = kernels.numpy(a).T @ kernels.numpy(part)
    np.testing.assert_allclose(kernels.numpy(kernels.weighted_gram(a, part)), expected, atol=2e-3)


def test_repeats_bit_by_bit(kernels, rng):
    a, b, w = (kernels.array(rng.normal(size=shape)) for shape in ((5000, 61), (5000, 35), (5000,)))
    first = kernels.numpy(kernels.weighted_gram(a, b, w))
    for _ in range(5):
        np.testing.assert_array_equal(kernels.numpy(kernels.weighted_gram(a, b, w)), first)


PROGRAM = """
import hashlib
import numpy as np
from clalign.engine import open_backend
from clalign.options import EngineOptions
backend = open_backend(EngineOptions(device="cpu"))
rng = np.random.default_rng(0)
digest = hashlib.sha256()
for n, p, q in ((700, 33, 50), (3000, 40, 17)):
    a, b = (backend.array(rng.standard_normal((n, k)).astype(np.float32)) for k in (p, q))
    w = backend.array(rng.random(n).astype(np.float32))
    for other in (a, b):
        digest.update(backend.numpy(backend.weighted_gram(a, other, w)).tobytes())
    digest.update(backend.numpy(backend.packed_moments(a, w, b)).tobytes())
print(digest.hexdigest(), backend.device.facts.units)
"""


@pytest.mark.usefixtures("opencl")
def test_sums_do_not_depend_on_the_number_of_units():
    """Workers of a collection share the processors of a machine in different ways, and must find the same maps."""
    found = {}
    for units in ("1", "2"):
        environment = {**os.environ, "POCL_CPU_MAX_CU_COUNT": units, "POCL_MAX_PTHREAD_COUNT": units}
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True, check=True, timeout=300
        )
        digest, counted = done.stdout.split()
        found[counted] = digest
    if len(found) < 2:
        pytest.skip("the driver here does not take the number of units from the environment")
    assert len(set(found.values())) == 1
