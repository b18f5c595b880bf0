"""Arrays, dense and banded linear algebra: specification, and executable twin of the kernels, in numpy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from clalign.engine.band import Band

Array: TypeAlias = Any
"""An array of a backend: `numpy.ndarray` for the reference, `clalign.engine.device.DeviceArray` for OpenCL."""
ArrayPair: TypeAlias = tuple[Array, Array]


def stored(value: ArrayLike, out: Array) -> Array:
    """Return `value`, or `out` with `value` written into it."""
    if out is None:
        return np.asarray(value)
    out[...] = value
    return out


def reciprocal(values: NDArray[Any]) -> NDArray[Any]:
    """1 / values, and 0 where they are 0."""
    safe = np.where(values == 0, 1, values)
    return np.where(values == 0, 0, 1 / safe).astype(values.dtype)


class ReferenceArrays:
    """Making, moving and elementwise use of arrays; dense and banded linear algebra. See `Reference`."""

    def __init__(self, dtype: Any = np.float64) -> None:
        self.dtype: np.dtype[Any] = np.dtype(dtype)

    @property
    def name(self) -> str:
        """Short description of where the arithmetic runs."""
        return f"numpy {np.__version__}, {self.dtype.name}"

    def describe(self) -> dict[str, str | int | bool]:
        """Return facts for reports; those of a device say its "kind", "memory" and "largest_buffer" (bytes)."""
        return {"device": self.name}

    def array(self, values: ArrayLike) -> Array:
        """Copy into an array of the backend: floats to its real type, integers to int32; row-major."""
        given = np.asarray(values)
        kind = np.int32 if given.dtype.kind in "iub" else self.dtype
        return np.array(given, dtype=kind, order="C")

    def zeros(self, shape: int | Sequence[int], dtype: Any = None) -> Array:
        """Allocate zeros of the real type (default) or int32."""
        return np.zeros(shape, dtype=self.dtype if dtype is None else dtype)

    def numpy(self, array: Array) -> NDArray[Any]:
        """Copy to numpy; waits for whatever computes the array."""
        return np.array(array)

    def read(self, values: Sequence[Array | float]) -> list[NDArray[Any]]:
        """Copy arrays to numpy, waiting once for all of them; numbers among them become arrays of shape ()."""
        return [np.array(value) for value in values]

    def quotient(
        self, numerator: Array, denominator: Array, slope: Array, denominator_slope: Array
    ) -> tuple[Array | float, Array]:
        """Value a / b of arrays a and b of shape (), and its gradient da / b − (a / b²) db from theirs.

        The value is a number where the backend waits for it, else an array of shape ().
        """
        scale = 1.0 / float(denominator)
        value = float(numerator) * scale
        return value, self.add(slope, denominator_slope, scale_a=scale, scale_b=-value * scale)

    def add(self, a: Array, b: Array, *, scale_a: float = 1.0, scale_b: float = 1.0, out: Array = None) -> Array:
        """Return scale_a · a + scale_b · b for arrays of one shape; `out` may be `a` or `b`."""
        return stored(self.dtype.type(scale_a) * a + self.dtype.type(scale_b) * b, out)

    def scale_rows(self, a: Array, w: Array, *, out: Array = None) -> Array:
        """diag(w) a for a (n, k) and w (n,); `out` may be `a`."""
        return stored(a * w[:, None], out)

    def reciprocal(self, a: Array, *, out: Array = None) -> Array:
        """1 / a elementwise, and 0 where a is 0; `out` may be `a`."""
        return stored(reciprocal(a), out)

    def gather(self, a: Array, index: Array, *, out: Array = None) -> Array:
        """Rows of a (n, k) named by index (any shape, int32): shape index.shape + (k,)."""
        return stored(a[index], out)

    def half_squares(self, a: Array, *, out: Array = None) -> Array:
        """½ |a_i|² of the rows of a (n, k): (n,), the penalty with which `nearest` finds nearest neighbours."""
        return stored(self.dtype.type(0.5) * np.einsum("nk,nk->n", a, a), out)

    def total(self, a: Array, w: Array = None) -> float:
        """Σ a, or Σ w a for w of a's size; summed in two stages in a fixed order."""
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
        out: Array = None,
    ) -> Array:
        """Return scale · op(a) op(b), added to `out` when `accumulate` is set; op(a) is (m, q), op(b) is (q, n).

        With `leading`, `a` is not transposed and may have more columns than q: its first q are used.
        """
        if leading:
            a = a[:, : b.shape[1] if transpose_b else b.shape[0]]
        value = self.dtype.type(scale) * ((a.T if transpose_a else a) @ (b.T if transpose_b else b))
        return stored(out + value if accumulate and out is not None else value, out)

    def transpose(self, a: Array, *, out: Array = None) -> Array:
        """aᵀ, stored row by row, for a (n, k)."""
        return stored(np.ascontiguousarray(a.T), out)

    def band_expand(self, values: Array, band: Band, *, out: Array = None) -> Array:
        """Packed values (band.count,) as a (d, d) matrix with zeros outside the band."""
        matrix = np.zeros((band.size, band.size), dtype=values.dtype)
        matrix[band.positions] = values
        return stored(matrix, out)

    def band_gather(self, matrix: Array, band: Band, *, out: Array = None) -> Array:
        """Entries of a (d, d) matrix inside the band, packed: the adjoint of `band_expand`."""
        return stored(matrix[band.positions], out)

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
        out: Array = None,
    ) -> Array:
        """Return scale · a b, added to `out` when `accumulate` is set, without most of the work that a band saves.

        a (m, q) is zero outside `left`, b (q, n) outside `right`: what lies there may be read or not. Of the result
        (m, n) the entries outside `kept` have no meaning.
        """

        def inside(matrix: Array, band: Band | None) -> Array:
            return matrix if band is None else self.band_expand(self.band_gather(matrix, band), band)

        value = self.dtype.type(scale) * (inside(a, left) @ inside(b, right))
        return stored(inside(out + value if accumulate and out is not None else value, kept), out)

    def weighted_gram(self, a: Array, b: Array, w: Array | None = None, *, out: Array | None = None) -> Array:
        """aᵀ diag(w) b."""
        return stored((a if w is None else w[:, None] * a).T @ b, out)

    def solve_right(self, gram: Array, rhs: Array, ridge: float, *, out: Array = None) -> Array:
        """Return rhs (gram + ridge · trace(gram) / k · I)⁻¹ by Cholesky; gram (k, k) positive definite, rhs (m, k).

        A gram that is not positive definite gives NaN (no host synchronisation happens here to find out).
        """
        size = gram.shape[0]
        shift = self.dtype.type(ridge) * np.trace(gram) / self.dtype.type(size)
        try:
            factor = scipy.linalg.cho_factor(gram + shift * np.eye(size, dtype=gram.dtype), lower=True)
        except np.linalg.LinAlgError:
            return stored(np.full_like(rhs, np.nan), out)
        return stored(np.ascontiguousarray(scipy.linalg.cho_solve(factor, rhs.T).T), out)
