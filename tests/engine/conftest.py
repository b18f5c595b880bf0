"""Fixtures of the engine tests: backends, and the rule that a kernel errs at most twice as much as its twin."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from clalign.engine.band import Band
from clalign.engine.device import Device, DeviceArray
from clalign.engine.device_class import ClassName
from clalign.engine.kernels import Kernels
from clalign.engine.reference import Reference

FLOOR = {"float32": 1e-6, "float64": 2e-15}
"""Relative error that is always allowed."""

Check = Callable[..., Any]


@functools.cache
def backend_of(kind: ClassName, precision: str) -> Kernels:
    """The kernels of a class, on whatever device the tests run on."""
    device = Device(kind=kind)
    if precision == "double":
        if not device.facts.double:
            pytest.skip(f"{device.facts.label} has no double precision")
        device = Device(precision="double", kind=kind)
    return Kernels(device)


@pytest.fixture
def kernels(opencl: None, request: pytest.FixtureRequest) -> Kernels:
    """The kernels of CPUs, or of the class that a test asks for: ``parametrize("kernels", [...], indirect=True)``."""
    return backend_of(getattr(request, "param", "cpu"), "single")


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20)


def as_tuple(value: Any) -> tuple[Any, ...]:
    return value if isinstance(value, tuple) else (value,)


def downloaded(value: Any) -> list[np.ndarray]:
    return [part.get() if isinstance(part, DeviceArray) else np.asarray(part) for part in as_tuple(value)]


def poison_scratch(kernels: Kernels) -> None:
    """Fill all scratch memory with NaN, so that a kernel that reads what it did not write is found out."""
    for scratch in kernels.device._scratch.values():
        if scratch.dtype.kind == "f":
            kernels.device.copy(kernels.device.upload(np.full(scratch.shape, np.nan, scratch.dtype)), scratch)


def check_against_twin(
    backend: Kernels, name: str, *arguments: Any, inside: Band | None = None, **options: Any
) -> list[np.ndarray]:
    """Compare a kernel with its float64 twin, and with itself run again on poisoned scratch memory.

    The error may be twice that of the twin run in the kernel's precision; both are relative to the largest true value.
    With `inside`, only what lies in that band of matrices of its size is looked at: the rest has no meaning.
    """

    def seen(result: Any) -> list[np.ndarray]:
        parts = downloaded(result)
        if inside is None:
            return parts
        shape = (inside.size, inside.size)
        return [Reference().band_gather(part, inside) if part.shape == shape else part for part in parts]

    rounded = Reference(backend.dtype)
    given = [rounded.array(a) if isinstance(a, np.ndarray) else a for a in arguments]
    exact = [Reference().array(a) if isinstance(a, np.ndarray) else a for a in given]
    truth = seen(getattr(Reference(), name)(*exact, **options))
    twin = seen(getattr(rounded, name)(*given, **options))
    uploaded = [backend.array(a) if isinstance(a, np.ndarray) else a for a in given]
    results = seen(getattr(backend, name)(*uploaded, **options))
    assert len(results) == len(truth)
    for part, (true, near, result) in enumerate(zip(truth, twin, results, strict=True)):
        assert result.shape == true.shape
        largest = np.abs(true).max() or 1.0
        allowed = max(2 * np.abs(near - true).max() / largest, FLOOR[backend.dtype.name])
        error = np.abs(result - true).max() / largest
        assert error <= allowed, f"{name}[{part}] {true.shape}: error {error:.2e}, allowed {allowed:.2e}"
    for _ in range(2):
        poison_scratch(backend)
        again = seen(getattr(backend, name)(*uploaded, **options))
        for result, repeated in zip(results, again, strict=True):
            np.testing.assert_array_equal(result, repeated)
    return results


@pytest.fixture(params=["single", "double"])
def check(opencl: None, request: pytest.FixtureRequest) -> Check:
    """`check_against_twin` on the device, with the kernels of CPUs in either precision."""
    return functools.partial(check_against_twin, backend_of("cpu", request.param))


@pytest.fixture(params=["single", "double"])
def check_gpu(opencl: None, request: pytest.FixtureRequest) -> Check:
    """The same with the kernels of GPUs, which a CPU runs slowly: for small arrays."""
    return functools.partial(check_against_twin, backend_of("gpu", request.param))
