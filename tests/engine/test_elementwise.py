"""Uploading, elementwise functions and sums."""

from __future__ import annotations

import numpy as np
import pytest

from clalign.engine.kernels import Kernels
from clalign.errors import InputError


@pytest.mark.parametrize("shape", [(1, 1), (97, 5), (257, 33), (1025, 12)])
def test_match_twins(check, rng, shape):
    a, b = rng.normal(size=shape), rng.normal(size=shape)
    check("add", a, b, scale_a=-0.5, scale_b=3.0)
    check("scale_rows", a, rng.normal(size=shape[0]))
    check("gather", a, rng.integers(0, shape[0], size=(3, 7)))
    check("total", a)
    check("total", a, b)


@pytest.mark.parametrize("count", [1, 97, 4096, 8193])
def test_reciprocal_matches_its_twin_and_is_zero_at_zero(check, kernels: Kernels, rng, count):
    values = rng.normal(size=count)
    values[count // 2] = 0
    (inverse,) = check("reciprocal", values)
    assert inverse[count // 2] == 0
    assert np.isfinite(inverse).all()
    array = kernels.array(values)
    assert kernels.reciprocal(array, out=array) is array
    np.testing.assert_array_equal(kernels.numpy(array), kernels.numpy(kernels.reciprocal(kernels.array(values))))


@pytest.mark.parametrize("shape", [(1, 1), (97, 257), (1025, 5)])
def test_half_squares_match_twin(check, rng, shape):
    check("half_squares", rng.normal(size=shape))


def test_total_of_many_equal_numbers_is_accurate(kernels: Kernels):
    values = np.full(1_000_003, 0.1, dtype=np.float32)
    assert kernels.total(kernels.array(values)) == pytest.approx(float(values[0]) * values.size, rel=1e-6)


def test_upload_and_download_keep_values_types_and_order(kernels: Kernels, rng):
    real = rng.normal(size=(3, 4)).astype(np.float32)
    assert kernels.numpy(kernels.array(real.T)).tolist() == real.T.tolist()
    whole = kernels.array(np.arange(6, dtype=np.int64).reshape(2, 3))
    assert whole.dtype == np.int32
    assert whole.reshape(3, -1).shape == (3, 2)
    np.testing.assert_array_equal(kernels.numpy(whole.reshape(6)), np.arange(6))
    assert float(kernels.array(2.5)) == 2.5


def test_only_whole_numbers_of_the_device_name_rows(kernels: Kernels):
    a = kernels.zeros((4, 3))
    with pytest.raises(InputError, match="gather: index holds float32, needed is int32"):
        kernels.gather(a, kernels.zeros(2))
    with pytest.raises(InputError, match="gather: index is of type ndarray, needed is an array of the device"):
        kernels.gather(a, np.zeros(2, np.int32))


def test_only_one_element_is_a_number(kernels: Kernels):
    with pytest.raises(TypeError, match="shape"):
        float(kernels.zeros((2,)))
    with pytest.raises(ValueError, match="cannot reshape"):
        kernels.zeros((2, 3)).reshape(4, 2)


def test_shapes_that_do_not_fit_are_refused(kernels: Kernels):
    with pytest.raises(InputError, match="add: b has shape"):
        kernels.add(kernels.zeros(3), kernels.zeros(4))
    with pytest.raises(InputError, match="out holds float32, needed is int32"):
        kernels.nearest(kernels.zeros((2, 2)), kernels.zeros((3, 2)), out=(kernels.zeros(2), kernels.zeros(2)))
