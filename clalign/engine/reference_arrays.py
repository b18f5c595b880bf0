"""Arrays, dense and banded linear algebra of the numpy backend."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from clalign.engine.backend import Band

Array = NDArray[Any]


def stored(value: ArrayLike, out: Array | None) -> Array:
    """Return `value`, or `out` with `value` written into it."""
    if out is None:
        return np.asarray(value)
    out[...] = value
    return out


def reciprocal(values: Array) -> Array:
    """1 / values, and 0 where they are 0."""
    safe = np.where(values == 0, 1, values)
    return np.where(values == 0, 0, 1 / safe).astype(values.dtype)


class ReferenceArrays:
    """Twins of `backend.Arrays` and `backend.Products`; see there for the formulas."""

    dtype: np.dtype[Any]

    def array(self, values: ArrayLike) -> Array:
        """Copy: floats to the real type, integers to int32; row-major."""
        given = np.asarray(values)
        kind = np.int32 if given.dtype.kind in "iub" else self.dtype
        return np.array(given, dtype=kind, order="C")

    def zeros(self, shape: int | Sequence[int], dtype: Any = None) -> Array:
        """Allocate zeros of the real type (default) or int32."""
        return np.zeros(shape, dtype=self.dtype if dtype is None else dtype)

    def numpy(self, array: Array) -> Array:
        """Return a copy."""
        return np.array(array)

    def add(self, a: Array, b: Array, *, scale_a: float = 1.0, scale_b: float = 1.0, out: Array | None = None) -> Array:
        """Return scale_a · a + scale_b · b."""
        return stored(self.dtype.type(scale_a) * a + self.dtype.type(scale_b) * b, out)

    def scale_rows(self, a: Array, w: Array, *, out: Array | None = None) -> Array:
        """diag(w) a."""
        return stored(a * w[:, None], out)

    def reciprocal(self, a: Array, *, out: Array | None = None) -> Array:
        """1 / a, and 0 where a is 0."""
        return stored(reciprocal(a), out)

    def gather(self, a: Array, index: Array, *, out: Array | None = None) -> Array:
        """Rows of a named by index."""
        return stored(a[index], out)

    def half_squares(self, a: Array, *, out: Array | None = None) -> Array:
        """½ |a_i|² of the rows."""
        return stored(self.dtype.type(0.5) * np.einsum("nk,nk->n", a, a), out)

    def total(self, a: Array, w: Array | None = None) -> float:
        """Σ a, or Σ w a."""
        flat = a.reshape(-1)
        return float(flat.sum() if w is None else flat @ w.reshape(-1))

    def product(
        self,
        a: Array,
        b: Array,
        *,
        transpose_a: bool = False,
        transpose_b: bool = False,
        scale: float = 1.0,
        accumulate: bool = False,
        leading: bool = False,
        out: Array | None = None,
    ) -> Array:
        """Return scale · op(a) op(b), added to `out` when `accumulate` is set."""
        if leading:
            a = a[:, : b.shape[1] if transpose_b else b.shape[0]]
        value = self.dtype.type(scale) * ((a.T if transpose_a else a) @ (b.T if transpose_b else b))
        return stored(out + value if accumulate and out is not None else value, out)

    def band_expand(self, values: Array, band: Band, *, out: Array | None = None) -> Array:
        """Packed values as a matrix."""
        matrix = np.zeros((band.size, band.size), dtype=values.dtype)
        matrix[band_positions(band)] = values
        return stored(matrix, out)

    def band_gather(self, matrix: Array, band: Band, *, out: Array | None = None) -> Array:
        """Entries of a matrix inside the band."""
        return stored(matrix[band_positions(band)], out)

    def transpose(self, a: Array, *, out: Array | None = None) -> Array:
        """aᵀ."""
        return stored(np.ascontiguousarray(a.T), out)

    def banded_product(
        self,
        a: Array,
        b: Array,
        *,
        left: Band | None = None,
        right: Band | None = None,
        kept: Band | None = None,
        scale: float = 1.0,
        accumulate: bool = False,
        out: Array | None = None,
    ) -> Array:
        """Return scale · a b, added to `out` when `accumulate` is set; entries outside `kept` are zero."""

        def inside(matrix: Array, band: Band | None) -> Array:
            return matrix if band is None else self.band_expand(self.band_gather(matrix, band), band)

        value = self.dtype.type(scale) * (inside(a, left) @ inside(b, right))
        return stored(inside(out + value if accumulate and out is not None else value, kept), out)

    def weighted_gram(self, a: Array, b: Array, w: Array | None = None, *, out: Array | None = None) -> Array:
        """aᵀ diag(w) b."""
        return stored((a if w is None else w[:, None] * a).T @ b, out)

    def solve_right(self, gram: Array, rhs: Array, ridge: float, *, out: Array | None = None) -> Array:
        """Return rhs (gram + ridge · trace(gram) / k · I)⁻¹; NaN where gram is not positive definite."""
        size = gram.shape[0]
        shift = self.dtype.type(ridge) * np.trace(gram) / self.dtype.type(size)
        try:
            factor = scipy.linalg.cho_factor(gram + shift * np.eye(size, dtype=gram.dtype), lower=True)
        except np.linalg.LinAlgError:
            return stored(np.full_like(rhs, np.nan), out)
        return stored(np.ascontiguousarray(scipy.linalg.cho_solve(factor, rhs.T).T), out)


def band_positions(band: Band) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of the packed entries of a band, each (band.count,)."""
    widths = band.upper - band.lower
    rows = np.repeat(np.arange(band.size), widths)
    columns = np.arange(band.count) - np.repeat(band.offsets[:-1] - band.lower, widths)
    return rows, columns
