"""What a backend can compute: the protocol that the numpy reference and the OpenCL kernels both follow.

Arrays are the backend's own, row-major, of the backend's real type or int32. Both kinds have ``shape``, ``dtype`` and
``reshape``. With ``out`` given a function writes there and returns it. Shapes are written in the docstrings, with the
project's symbols: n vertices, k basis functions, d descriptors, r columns of a low-rank distance factor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clalign.errors import InputError

Array: TypeAlias = Any
"""An array of a backend: `numpy.ndarray` for the reference, `clalign.engine.device.DeviceArray` for OpenCL."""

DistortionKind: TypeAlias = Literal["squared", "relative"]

RELATIVE_DISTANCE_FLOOR = 0.05
"""Added to the denominator of the relative distortion, in units of sqrt(area)."""


@dataclass(frozen=True)
class Band:
    """The entries of a square matrix that may differ from zero: one run of columns in every row.

    lower, upper : (d,) int32, row i holds columns ``lower[i] .. upper[i] - 1``; both never decrease with i.
    offsets : (d + 1,) int32, position of each row's first entry among the packed values.
    """

    lower: NDArray[np.int32]
    upper: NDArray[np.int32]
    offsets: NDArray[np.int32]

    @staticmethod
    def from_limits(lower: ArrayLike, upper: ArrayLike) -> Band:
        """Build a band from the limits of its rows.

        Raises
        ------
        InputError
            The limits leave the matrix, cross, or decrease from one row to the next.
        """
        low, high = np.asarray(lower, dtype=np.int32), np.asarray(upper, dtype=np.int32)
        size = low.size
        if low.shape != high.shape or low.ndim != 1 or size == 0:
            raise InputError(f"a band needs two limits a row, got shapes {low.shape} and {high.shape}")
        bad = np.flatnonzero((low < 0) | (high > size) | (low >= high))
        if bad.size:
            row = int(bad[0])
            raise InputError(f"row {row} of the band holds columns {low[row]}..{high[row] - 1} of {size}")
        if np.any(np.diff(low) < 0) or np.any(np.diff(high) < 0):
            raise InputError("the limits of a band must not decrease from one row to the next")
        offsets = np.concatenate([[0], np.cumsum(high - low)]).astype(np.int32)
        return Band(low, high, offsets)

    @cached_property
    def transposed(self) -> Band:
        """The band of the transpose.

        Raises
        ------
        InputError
            A column has nothing inside the band.
        """
        columns = np.arange(self.size)
        first, last = np.searchsorted(self.upper, columns, "right"), np.searchsorted(self.lower, columns, "right")
        return Band.from_limits(first, last)

    @property
    def size(self) -> int:
        """Rows (and columns) of the matrix."""
        return int(self.lower.size)

    @property
    def count(self) -> int:
        """Entries inside the band."""
        return int(self.offsets[-1])


class Arrays(Protocol):
    """Making, moving and elementwise use of a backend's arrays."""

    @property
    def name(self) -> str:
        """Short description of where the arithmetic runs."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """The real type."""

    def describe(self) -> dict[str, str | int | bool]:
        """Return facts for reports; those of a device say its "kind", "memory" and "largest_buffer" (bytes)."""

    def array(self, values: ArrayLike) -> Array:
        """Upload: floats to the backend's real type, integers to int32; row-major."""

    def zeros(self, shape: int | Sequence[int], dtype: Any = None) -> Array:
        """Allocate zeros of the real type (default) or int32."""

    def numpy(self, array: Array) -> NDArray[Any]:
        """Download; waits for whatever computes the array."""

    def add(self, a: Array, b: Array, *, scale_a: float = 1.0, scale_b: float = 1.0, out: Array = None) -> Array:
        """Return scale_a · a + scale_b · b for arrays of one shape; `out` may be `a` or `b`."""

    def scale_rows(self, a: Array, w: Array, *, out: Array = None) -> Array:
        """diag(w) a for a (n, k) and w (n,); `out` may be `a`."""

    def reciprocal(self, a: Array, *, out: Array = None) -> Array:
        """1 / a elementwise, and 0 where a is 0; `out` may be `a`."""

    def gather(self, a: Array, index: Array, *, out: Array = None) -> Array:
        """Rows of a (n, k) named by index (any shape, int32): shape index.shape + (k,)."""

    def half_squares(self, a: Array, *, out: Array = None) -> Array:
        """½ |a_i|² of the rows of a (n, k): (n,), the penalty with which `nearest` finds nearest neighbours."""

    def total(self, a: Array, w: Array = None) -> float:
        """Σ a, or Σ w a for w of a's size; summed in two stages in a fixed order."""


class Products(Protocol):
    """Dense and banded linear algebra."""

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

    def band_expand(self, values: Array, band: Band, *, out: Array = None) -> Array:
        """Packed values (band.count,) as a (d, d) matrix with zeros outside the band."""

    def band_gather(self, matrix: Array, band: Band, *, out: Array = None) -> Array:
        """Entries of a (d, d) matrix inside the band, packed: the adjoint of `band_expand`."""

    def transpose(self, a: Array, *, out: Array = None) -> Array:
        """aᵀ, stored row by row, for a (n, k)."""

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

    def weighted_gram(self, a: Array, b: Array, w: Array = None, *, out: Array = None) -> Array:
        """aᵀ diag(w) b for a (n, p), b (n, q), w (n,) or None: (p, q)."""

    def solve_right(self, gram: Array, rhs: Array, ridge: float, *, out: Array = None) -> Array:
        """Return rhs (gram + ridge · trace(gram) / k · I)⁻¹ by Cholesky; gram (k, k) positive definite, rhs (m, k).

        A gram that is not positive definite gives NaN (no host synchronisation happens here to find out).
        """


class SoftMaps(Protocol):
    """The soft correspondence as a quadratic kernel, and its gradients.

    ``packed`` holds the pairs (a, b), a <= b, in the order of ``numpy.triu_indices``, off-diagonal pairs doubled, so
    that c M_r cᵀ = vech(c cᵀ) · packed[:, r].
    """

    def packed_moments(self, psi: Array, w: Array, u: Array, *, out: Array = None) -> Array:
        """M_r = ψᵀ diag(w u_r) ψ, packed: psi (n, k), w (n,), u (n, r) to (k (k + 1) / 2, r)."""

    def packed_moments_gradient(self, psi: Array, w: Array, dpacked: Array, *, out: Array = None) -> Array:
        """Gradient with respect to u of Σ dpacked · packed: du_ir = w_i vech'(ψ_i ψ_iᵀ) · dpacked[:, r], (n, r).

        vech' doubles the off-diagonal pairs, as `packed_moments` does.
        """

    def soft_map(
        self, c: Array, packed: Array, normal: Array = None, *, out: tuple[Array, Array] | None = None
    ) -> tuple[Array, Array]:
        """Z = PᵀU (Eq. 15, 27): z_jr = c_j M_r c_jᵀ / s_j, s_j = |c_j|² or c_j `normal` c_jᵀ; (n, r) and (n,).

        c (n, k) holds rows C φ_j; `normal` (k, k) is ψᵀ diag(w) ψ where that is not the identity. A row c_j = 0 gives
        s_j = 0 and z_j = 0.
        """

    def soft_map_gradient(
        self, c: Array, packed: Array, normal: Array, z: Array, s: Array, dz: Array, *, out: Array = None
    ) -> Array:
        """dc_j = (2 / s_j) [(Σ_r dz_jr M_r) c_j − (Σ_r dz_jr z_jr) N c_j] for dz (n, r): (n, k)."""

    def soft_map_streamed(
        self, c: Array, psi: Array, w: Array, u: Array, *, out: tuple[Array, Array] | None = None
    ) -> tuple[Array, Array]:
        """The same Z and s from q_ij = ψ_i·c_j tile by tile: z_jr = Σ_i w_i q_ij² u_ir / s_j, s_j = Σ_i w_i q_ij²."""

    def soft_map_streamed_gradient(
        self, c: Array, psi: Array, w: Array, u: Array, z: Array, s: Array, dz: Array, *, out: Array = None
    ) -> Array:
        """dc_j = (2 / s_j) Σ_i w_i q_ij (Σ_r dz_jr (u_ir − z_jr)) ψ_i: (n, k)."""


class Losses(Protocol):
    """The two terms of the objective with their gradients. Scalars come as arrays of shape (); ``float`` reads them."""

    def distortion(
        self,
        z: Array,
        core_y: Array,
        left_x: Array,
        core_x: Array,
        w: Array,
        *,
        out: tuple[Array, Array] | None = None,
    ) -> tuple[Array, Array]:
        """Eq. 22 from low-rank distances: l = Σ_jl w_j w_l (U T_X Uᵀ − Z T_Y Zᵀ)²_jl and dl/dZ (n, r).

        U = left_x (n, r_x) must satisfy Uᵀ diag(w) U = I; T_X = core_x and T_Y = core_y are symmetric. With B = UᵀΩZ,
        Z⊥ = Z − U B and G = Z⊥ᵀΩZ⊥, l = |T_X − B T_Y Bᵀ|² + 2 tr(B T_Y G T_Y Bᵀ) + tr(T_Y G T_Y G): no large terms
        cancel.
        """

    def alignment(
        self,
        r: Array,
        turned: Array,
        g_x: Array,
        g_y: Array,
        g_xy: Array,
        band: Band,
        one_sided: bool = False,
        *,
        out: tuple[Array, Array, Array, Array] | None = None,
    ) -> tuple[Array, Array, Array, Array]:
        """Eq. 21 with π fixed, from Gram matrices (d, d): numerator, denominator and their gradients (d, d).

        `r` is zero outside the band, `turned` its transpose; of the gradients only what lies inside the band has a
        meaning. numerator |Φ̃R − Ψ̃_π Rᵀ|² = tr(RᵀG_xR) + tr(R G_y Rᵀ) − 2 tr(RᵀG_xyRᵀ), denominator |Ψ̃_π Rᵀ|²; one-sided
        (Eq. 18): |Φ̃R − Ψ̃_π|² and |Ψ̃_π|², whose gradient is zero.
        """


class Searches(Protocol):
    """Nearest points, and scores of many candidate maps at once."""

    def nearest(
        self,
        queries: Array,
        points: Array,
        penalty: Array = None,
        *,
        absolute: bool = False,
        guess: Array = None,
        out: tuple[Array, Array] | None = None,
    ) -> tuple[Array, Array]:
        """For each query the point of largest score, and the score: (m,) int32 and (m,). Ties go to the lowest index.

        The score of point j for query q is q·p_j − penalty_j, so penalty = ½|p_j|² finds the nearest neighbour;
        with `absolute` it is penalty_j (q·p_j)² (Eq. 28, `penalty` read as weights, None as ones).

        `guess` (m,) int32 names a point for each query, or with -1 none. It never changes the result: points that
        cannot reach the guessed one's score are given up early, so that a good guess saves most of the work. So does an
        order of queries and of points in which neighbours are similar.
        """

    def distortion_batch(
        self,
        dx: Array,
        dy: Array,
        w: Array,
        index: Array,
        kind: DistortionKind = "squared",
        *,
        out: Array = None,
    ) -> Array:
        """For each column T of index (m, B): Σ_il w_i w_l e(dx[T_i, T_l], dy[i, l]), (B,).

        e(a, b) = (a − b)² for "squared", |a − b| / (a + b + 0.05) for "relative". dx is (p, p), dy (m, m), w (m,).
        """

    def map_distance(self, dx: Array, w: Array, index: Array, *, out: Array = None) -> Array:
        """Distance of every two of the B maps: Σ_i w_i dx[index[i, a], index[i, b]], (B, B)."""


class Backend(Arrays, Products, SoftMaps, Losses, Searches, Protocol):
    """Everything together. Calls belong to one thread; results are bitwise the same from run to run on one device."""
