"""A quick check that a device computes what it should: a few kernels against the numpy reference."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.engine.backend import Backend
from clalign.engine.reference import Reference

#: Largest error that is accepted, in units of the largest entry, by the size of the real type in bytes.
TOLERANCES = {4: 1e-4, 8: 1e-10}

#: Odd sizes, so that the last work-group of every kernel is a partial one.
_POINTS, _QUERIES, _WIDTH, _COLUMNS = 257, 97, 33, 7


@dataclass(frozen=True)
class KernelCheck:
    """One function of a backend beside the same function of the reference.

    error : largest difference, divided by the largest entry of the reference's result.
    seconds : of the first call, with the build of the kernel.
    """

    function: str
    error: float
    tolerance: float
    seconds: float

    @property
    def agrees(self) -> bool:
        """Whether the difference is rounding (not a number is not)."""
        return self.error <= self.tolerance


def self_test(backend: Backend) -> tuple[KernelCheck, ...]:
    """Run a function of every family on `backend` and on the float64 reference, with the same random values."""
    rng = np.random.default_rng(0)
    tolerance = TOLERANCES[backend.dtype.itemsize]
    values: dict[str, NDArray[Any]] = {
        "points": rng.normal(size=(_POINTS, _WIDTH)),
        "queries": rng.normal(size=(_QUERIES, _WIDTH)),
        "weights": rng.uniform(0.5, 1.5, size=_POINTS) / _POINTS,
        "columns": rng.normal(size=(_POINTS, _COLUMNS)),
    }
    # Both sides get the same rounded values: the check is of the arithmetic, not of the upload.
    values = {name: array.astype(backend.dtype) for name, array in values.items()}
    return tuple(_check(name, function, values, backend, tolerance) for name, function in _FUNCTIONS.items())


def _check(
    name: str, function: Callable[..., Any], values: dict[str, NDArray[Any]], backend: Backend, tolerance: float
) -> KernelCheck:
    start = time.perf_counter()
    result = np.asarray(function(backend, **{key: backend.array(array) for key, array in values.items()}))
    seconds = time.perf_counter() - start
    reference = Reference()
    expected = np.asarray(function(reference, **{key: reference.array(array) for key, array in values.items()}))
    scale = max(float(np.abs(expected).max()), np.finfo(np.float64).tiny)
    return KernelCheck(name, float(np.abs(result - expected).max()) / scale, tolerance, seconds)


def _product(backend: Backend, points: Any, queries: Any, **_: Any) -> NDArray[Any]:
    return backend.numpy(backend.product(queries, points, transpose_b=True))


def _weighted_gram(backend: Backend, points: Any, columns: Any, weights: Any, **_: Any) -> NDArray[Any]:
    return backend.numpy(backend.weighted_gram(points, columns, weights))


def _solve_right(backend: Backend, points: Any, queries: Any, **_: Any) -> NDArray[Any]:
    gram = backend.weighted_gram(points, points)
    return backend.numpy(backend.solve_right(gram, queries, 1e-3))


def _soft_map(backend: Backend, points: Any, queries: Any, columns: Any, weights: Any) -> NDArray[Any]:
    packed = backend.packed_moments(points, weights, columns)
    mapped, _ = backend.soft_map(queries, packed)
    return backend.numpy(mapped)


def _nearest(backend: Backend, points: Any, queries: Any, **_: Any) -> NDArray[Any]:
    _, score = backend.nearest(queries, points, None)
    return backend.numpy(score)


def _total(backend: Backend, points: Any, **_: Any) -> NDArray[Any]:
    return np.asarray(backend.total(backend.product(points, points, transpose_a=True)), dtype=np.float64)


_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "product": _product,
    "weighted_gram": _weighted_gram,
    "solve_right": _solve_right,
    "soft_map": _soft_map,
    "nearest": _nearest,
    "total": _total,
}
