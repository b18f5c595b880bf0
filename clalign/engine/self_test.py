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
    def computed(side: Backend) -> NDArray[Any]:
        return side.numpy(function(side, **{key: side.array(array) for key, array in values.items()}))

    start = time.perf_counter()
    result = computed(backend)
    seconds = time.perf_counter() - start
    expected = computed(Reference())
    scale = max(float(np.abs(expected).max()), np.finfo(np.float64).tiny)
    return KernelCheck(name, float(np.abs(result - expected).max()) / scale, tolerance, seconds)


_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "product": lambda b, points, queries, **_: b.product(queries, points, transpose_b=True),
    "weighted_gram": lambda b, points, columns, weights, **_: b.weighted_gram(points, columns, weights),
    "solve_right": lambda b, points, queries, **_: b.solve_right(b.weighted_gram(points, points), queries, 1e-3),
    "soft_map": lambda b, points, queries, columns, weights: b.soft_map(
        queries, b.packed_moments(points, weights, columns)
    )[0],
    "nearest": lambda b, points, queries, **_: b.nearest(queries, points, None)[1],
    "total": lambda b, points, **_: b.array(b.total(b.product(points, points, transpose_a=True))),
}
"""By name; each takes the backend and the arrays of `self_test`."""
