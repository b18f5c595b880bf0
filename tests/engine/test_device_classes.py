"""Every class of devices, on whatever device the tests run on.

Work-groups that share local memory, and vectors of 32 and 64 bytes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clalign.engine.device import Device
from clalign.engine.device_class import CPU, CPU_LONG_VECTORS, DeviceClass
from clalign.engine.kernels import Kernels
from clalign.engine.launching import ceil_div, equal_parts
from clalign.engine.reference import Reference


@pytest.fixture(scope="module", params=[CPU, CPU_LONG_VECTORS], ids=["cpu", "cpu, long vectors"])
def wide(opencl: None, request: pytest.FixtureRequest) -> Kernels:
    return Kernels(Device(kind=request.param))


def agree(wide: Kernels, name: str, *arguments: np.ndarray | float | None) -> None:
    uploaded = [wide.array(a) if isinstance(a, np.ndarray) else a for a in arguments]
    results, truths = getattr(wide, name)(*uploaded), getattr(Reference(), name)(*arguments)
    results = results if isinstance(results, tuple) else (results,)
    truths = truths if isinstance(truths, tuple) else (truths,)
    for result, truth in zip(results, truths, strict=True):
        error = np.abs(wide.numpy(result) - truth).max()
        assert error <= 5e-6 * np.abs(truth).max(), name


def test_every_kernel_agrees_with_its_twin(wide: Kernels, rng):
    n, n_y, k, r = 97, 83, 12, 7
    c, psi, w = rng.normal(size=(n, k)), rng.normal(size=(n_y, k)), rng.random(n_y)
    u, dz = rng.normal(size=(n_y, r)), rng.normal(size=(n, r))
    packed = Reference().packed_moments(psi, w, u)
    z, s = Reference().soft_map(c, packed)
    agree(wide, "product", c, psi.T)
    agree(wide, "weighted_gram", psi, u, w)
    agree(wide, "solve_right", c.T @ c, c, 1e-3)
    agree(wide, "packed_moments", psi, w, u)
    agree(wide, "packed_moments_gradient", psi, w, packed)
    agree(wide, "soft_map", c, packed)
    agree(wide, "soft_map_gradient", c, packed, None, z, s, dz)
    agree(wide, "soft_map_streamed", c, psi, w, u)
    z, s = Reference().soft_map_streamed(c, psi, w, u)
    agree(wide, "soft_map_streamed_gradient", c, psi, w, u, z, s, dz)
    agree(wide, "nearest", c, psi, w)
    agree(wide, "soft_map_argmax", c, psi, w)
    agree(wide, "gather", c, rng.integers(0, n, size=200))
    agree(wide, "scale_rows", psi, w)


def test_candidates_and_sums_agree_with_their_twins(wide: Kernels, rng):
    dx, dy, w = rng.random((50, 50)), rng.random((97, 97)), rng.random(97)
    index = rng.integers(0, 50, size=(97, 33))
    agree(wide, "distortion_batch", dx, dy, w, index)
    agree(wide, "map_distance", dx, w, index)
    assert wide.total(wide.array(dx)) == pytest.approx(dx.sum(), rel=1e-6)


@pytest.mark.parametrize("length", [1, 2, 5, 512, 513, 614_401])
@pytest.mark.parametrize("most", [1, 2, 3, 4, 8, 1024])
def test_no_part_is_empty(length: int, most: int):
    parts, size = equal_parts(length, most)
    assert 1 <= parts <= most
    assert (parts - 1) * size < length <= parts * size
    # What a launch of that many parts makes of the length is the same size.
    assert ceil_div(length, parts) == size


@pytest.mark.usefixtures("opencl")
def test_a_gram_matrix_is_the_sum_of_parts_that_were_all_written(rng):
    """10,401 rows in 36 parts of 289 would leave the last one empty if they were shared out evenly."""
    device = Device(kind="gpu")
    device.facts = replace(device.facts, units=64)
    kernels = Kernels(device)
    values = rng.random((10_401, 1)).astype(np.float32)
    a, w = kernels.array(values), kernels.array(np.ones(len(values)))
    partial = kernels.device.scratch("splits", 1024)
    kernels.device.copy(kernels.array(np.full(partial.size, np.nan)), partial)
    result = kernels.numpy(kernels.weighted_gram(a, a, w))
    assert result[0, 0] == pytest.approx(np.sum(values.astype(np.float64) ** 2), rel=1e-5)


@pytest.mark.parametrize("constants", [CPU, CPU_LONG_VECTORS], ids=["4 doubles", "8 doubles"])
def test_sums_of_vectors_of_every_length(kernels: Kernels, rng, constants: DeviceClass):
    """Vectors of doubles; the others here are of 8 and 16 floats."""
    if not kernels.device.facts.double:
        pytest.skip(f"{kernels.device.facts.label} has no double precision")
    kernels = Kernels(Device(precision="double", kind=constants))
    a = rng.normal(size=(37, 29))
    np.testing.assert_allclose(
        kernels.numpy(kernels.half_squares(kernels.array(a))), 0.5 * np.sum(a * a, axis=1), rtol=1e-14
    )
    assert kernels.total(kernels.array(a), kernels.array(a)) == pytest.approx(np.sum(a * a), rel=1e-14)
