"""The specification of every operation, and its numpy twin: what the kernels must compute, and are tested against.

Arrays are the backend's own, row-major, of its real type or int32; all have ``shape``, ``dtype`` and ``reshape``. With
``out`` given an operation writes there and returns it. Shapes use the project's symbols: n vertices, k basis functions,
d scale-invariant eigenfunctions, r columns of a low-rank distance factor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.engine.band import Band
from clalign.engine.reference_arrays import Array, ArrayPair, ReferenceArrays, reciprocal, stored

BLOCK_ELEMENTS = 1 << 23
"""Elements of the largest intermediate, which bounds the memory of every operation here."""


def pair_count(k: int) -> int:
    """Pairs (a, b) with a <= b < k."""
    return k * (k + 1) // 2


def pair_factor(k: int, dtype: Any) -> NDArray[Any]:
    """1 for the pairs (a, a), 2 for the others, in the order of ``numpy.triu_indices``: (k (k + 1) / 2,)."""
    first, second = np.triu_indices(k)
    return np.where(first == second, 1, 2).astype(dtype)


def pair_features(c: NDArray[Any]) -> NDArray[Any]:
    """vech(c_j c_jᵀ) for every row of c (n, k): (n, k (k + 1) / 2)."""
    first, second = np.triu_indices(c.shape[1])
    return c[:, first] * c[:, second]


def quadratic_forms(c: NDArray[Any], packed: NDArray[Any]) -> NDArray[Any]:
    """vech(c_j c_jᵀ) · packed[:, r] for every row of c (n, k) and every r: (n, r)."""
    z = np.zeros((c.shape[0], packed.shape[1]), dtype=c.dtype)
    for rows in blocks(c.shape[0], packed.shape[0]):
        z[rows] = pair_features(c[rows]) @ packed
    return z


def blocks(rows: int, width: int) -> Iterator[slice]:
    """Cut `rows` rows of `width` elements into blocks of bounded size."""
    step = max(1, BLOCK_ELEMENTS // max(width, 1))
    for start in range(0, rows, step):
        yield slice(start, min(rows, start + step))


def best_points(queries: Array, points: Array, score: Callable[[Array], Array], out: ArrayPair | None) -> ArrayPair:
    """For each query the point of largest `score`, a function of the products q·p_j; ties go to the lowest index."""
    index = np.zeros(queries.shape[0], dtype=np.int32)
    best = np.zeros(queries.shape[0], dtype=queries.dtype)
    for rows in blocks(queries.shape[0], points.shape[0]):
        scores = score(queries[rows] @ points.T)
        index[rows] = np.argmax(scores, axis=1)
        best[rows] = np.take_along_axis(scores, index[rows, None].astype(np.int64), axis=1)[:, 0]
    return stored(index, out and out[0]), stored(best, out and out[1])


class Reference(ReferenceArrays):
    """All operations in numpy. Their docstrings are the specification of the kernels, which have the same signatures.

    The packed moments of `packed_moments` and the soft maps hold the pairs (a, b), a <= b, in the order of
    ``numpy.triu_indices``, off-diagonal pairs doubled, so that c M_r cᵀ = vech(c cᵀ) · packed[:, r].

    Parameters
    ----------
    dtype : numpy.float64, or numpy.float32 for every step in single precision: a kernel may err twice as much.
    """

    def packed_moments(self, psi: Array, w: Array, u: Array, *, out: Array = None) -> Array:
        """M_r = ψᵀ diag(w u_r) ψ, packed: psi (n, k), w (n,), u (n, r) to (k (k + 1) / 2, r)."""
        count = pair_count(psi.shape[1])
        packed = np.zeros((count, u.shape[1]), dtype=psi.dtype)
        for rows in blocks(psi.shape[0], count):
            packed += pair_features(psi[rows]).T @ (w[rows, None] * u[rows])
        return stored(packed * pair_factor(psi.shape[1], psi.dtype)[:, None], out)

    def packed_moments_gradient(self, psi: Array, w: Array, dpacked: Array, *, out: Array = None) -> Array:
        """Gradient with respect to u of Σ dpacked · packed: du_ir = w_i vech'(ψ_i ψ_iᵀ) · dpacked[:, r], (n, r).

        vech' doubles the off-diagonal pairs, as `packed_moments` does.
        """
        doubled = dpacked * pair_factor(psi.shape[1], psi.dtype)[:, None]
        return stored(w[:, None] * quadratic_forms(psi, doubled), out)

    def soft_map(self, c: Array, packed: Array, normal: Array = None, *, out: ArrayPair | None = None) -> ArrayPair:
        """Z = PᵀU (Eq. 15, 27): z_jr = c_j M_r c_jᵀ / s_j, s_j = |c_j|² or c_j `normal` c_jᵀ; (n, r) and (n,).

        c (n, k) holds rows C φ_j; `normal` (k, k) is ψᵀ diag(w) ψ where that is not the identity. A row c_j = 0 gives
        s_j = 0 and z_j = 0.
        """
        s = np.sum(c * (c if normal is None else c @ normal), axis=1)
        z = quadratic_forms(c, packed) * reciprocal(s)[:, None]
        return stored(z, out and out[0]), stored(s, out and out[1])

    def soft_map_gradient(
        self, c: Array, packed: Array, normal: Array, z: Array, s: Array, dz: Array, *, out: Array = None
    ) -> Array:
        """dc_j = (2 / s_j) [(Σ_r dz_jr M_r) c_j − (Σ_r dz_jr z_jr) N c_j] for dz (n, r) and N = `normal`: (n, k)."""
        first, second = np.triu_indices(c.shape[1])
        gradient = np.zeros_like(c)
        for rows in blocks(c.shape[0], first.size):
            full = np.zeros((gradient[rows].shape[0], c.shape[1], c.shape[1]), dtype=c.dtype)
            full[:, first, second] = dz[rows] @ packed.T
            gradient[rows] = ((full + full.transpose(0, 2, 1)) @ c[rows, :, None])[:, :, 0]
        removed = np.sum(dz * z, axis=1)[:, None] * (c if normal is None else c @ normal)
        return stored((gradient - 2 * removed) * reciprocal(s)[:, None], out)

    def soft_map_streamed(self, c: Array, psi: Array, w: Array, u: Array, *, out: ArrayPair | None = None) -> ArrayPair:
        """The same Z and s from q_ij = ψ_i·c_j tile by tile: z_jr = Σ_i w_i q_ij² u_ir / s_j, s_j = Σ_i w_i q_ij²."""
        z = np.zeros((c.shape[0], u.shape[1]), dtype=c.dtype)
        s = np.zeros(c.shape[0], dtype=c.dtype)
        for rows in blocks(c.shape[0], psi.shape[0]):
            weights = (c[rows] @ psi.T) ** 2 * w
            s[rows] = weights.sum(axis=1)
            z[rows] = (weights @ u) * reciprocal(s[rows])[:, None]
        return stored(z, out and out[0]), stored(s, out and out[1])

    def soft_map_streamed_gradient(
        self, c: Array, psi: Array, w: Array, u: Array, z: Array, s: Array, dz: Array, *, out: Array = None
    ) -> Array:
        """dc_j = (2 / s_j) Σ_i w_i q_ij (Σ_r dz_jr (u_ir − z_jr)) ψ_i: (n, k)."""
        gradient = np.zeros_like(c)
        removed = np.sum(dz * z, axis=1)
        for rows in blocks(c.shape[0], psi.shape[0]):
            slope = (dz[rows] @ u.T - removed[rows, None]) * (c[rows] @ psi.T) * w
            gradient[rows] = 2 * (slope @ psi) * reciprocal(s[rows])[:, None]
        return stored(gradient, out)

    def soft_map_argmax(self, c: Array, psi: Array, w: Array, *, out: ArrayPair | None = None) -> ArrayPair:
        """The hard map of the soft one (Eq. 16, 28): argmax_i w_i (ψ_i·c_j)², and that maximum; (n,) int32 and (n,).

        c (n, k), psi (n_y, k), w (n_y,) not negative. Ties go to the lowest index.
        """
        return best_points(c, psi, lambda products: products * products * w, out)

    def nearest(
        self, queries: Array, points: Array, penalty: Array = None, *, guess: Array = None, out: ArrayPair | None = None
    ) -> ArrayPair:
        """For each query the point of largest score, and the score: (m,) int32 and (m,). Ties go to the lowest index.

        The score of point j for query q is q·p_j − penalty_j, so penalty = ½|p_j|² finds the nearest neighbour.

        `guess` (m,) int32 names a point for each query, or with -1 none. It never changes the result: points that
        cannot reach the guessed one's score are given up early, so that a good guess saves most of the work. So does an
        order of queries and of points in which neighbours are similar.
        """
        return best_points(queries, points, lambda products: products if penalty is None else products - penalty, out)

    def distortion(
        self, z: Array, core_y: Array, left_x: Array, core_x: Array, w: Array, *, out: ArrayPair | None = None
    ) -> ArrayPair:
        """Eq. 22 from low-rank distances: l = Σ_jl w_j w_l (U T_X Uᵀ − Z T_Y Zᵀ)²_jl and dl/dZ (n, r).

        U = left_x (n, r_x) must satisfy Uᵀ diag(w) U = I; T_X = core_x and T_Y = core_y are symmetric. With B = UᵀΩZ,
        Z⊥ = Z − U B and G = Z⊥ᵀΩZ⊥, l = |T_X − B T_Y Bᵀ|² + 2 tr(B T_Y G T_Y Bᵀ) + tr(T_Y G T_Y G): no large terms
        cancel. dl/dZ = −4Ω[U (T_X B − B T_Y G_Z) − Z⊥ T_Y G_Z] T_Y with G_Z = BᵀB + G. l is an array of shape ();
        ``float`` reads it.
        """
        inside = left_x.T @ (w[:, None] * z)
        outside = z - left_x @ inside
        gram = outside.T @ (w[:, None] * outside)
        residual = core_x - inside @ core_y @ inside.T
        core_gram = core_y @ gram
        mixed = inside @ core_gram @ core_y
        value = np.sum(residual**2) + 2 * np.sum(mixed * inside) + np.sum(core_gram * core_gram.T)
        core_full = core_y @ (inside.T @ inside + gram)
        along = (core_x @ inside - inside @ core_full) @ core_y
        slope = left_x @ along - outside @ (core_full @ core_y)
        return stored(value, out and out[0]), stored(-4 * w[:, None] * slope, out and out[1])

    def alignment(
        self,
        r: Array,
        r_transposed: Array,
        g_x: Array,
        g_y: Array,
        g_xy: Array,
        band: Band,
        one_sided: bool = False,
        *,
        out: tuple[Array, Array, Array, Array] | None = None,
    ) -> tuple[Array, Array, Array, Array]:
        """Eq. 21 with π fixed, from Gram matrices (d, d): numerator, denominator and their gradients (d, d).

        `r` is zero outside the band; of the gradients only what lies inside the band has a meaning. numerator
        |Φ̃R − Ψ̃_π Rᵀ|² = tr(RᵀG_xR) + tr(R G_y Rᵀ) − 2 tr(RᵀG_xyRᵀ), denominator |Ψ̃_π Rᵀ|²; one-sided (Eq. 18):
        |Φ̃R − Ψ̃_π|² and |Ψ̃_π|², whose gradient is zero. Both are arrays of shape (); ``float`` reads them.
        """
        left = g_x @ r
        if one_sided:
            denominator = np.trace(g_y)
            numerator = np.sum(r * left) + denominator - 2 * np.sum(r * g_xy)
            gradients = (2 * (left - g_xy), np.zeros_like(r))
        else:
            right = r @ g_y
            cross = g_xy @ r_transposed
            denominator = np.sum(r * right)
            numerator = np.sum(r * left) + denominator - 2 * np.sum(r * cross)
            gradients = (2 * (left + right - cross - r_transposed @ g_xy), 2 * right)
        inside = np.zeros_like(r)
        inside[band.positions] = 1
        return (
            stored(numerator, out and out[0]),
            stored(denominator, out and out[1]),
            stored(inside * gradients[0], out and out[2]),
            stored(inside * gradients[1], out and out[3]),
        )

    def distortion_batch(
        self, dx: Array, dy: Array, w: Array, index: Array, floor: float | None = None, *, out: Array = None
    ) -> Array:
        """For each column T of index (m, B): Σ_il w_i w_l e(dx[T_i, T_l], dy[i, l]), (B,).

        e(a, b) = (a − b)², or with a `floor` > 0 the relative |a − b| / (a + b + floor). dx is (p, p), dy (m, m), w
        (m,).
        """
        values = np.zeros(index.shape[1], dtype=dx.dtype)
        for column in range(index.shape[1]):
            chosen = index[:, column]
            mapped = dx[np.ix_(chosen, chosen)]
            if floor is None:
                error = (mapped - dy) ** 2
            else:
                error = np.abs(mapped - dy) / (mapped + dy + self.dtype.type(floor))
            values[column] = w @ error @ w
        return stored(values, out)

    def map_distance(self, dx: Array, w: Array, index: Array, *, out: Array = None) -> Array:
        """Distance of every two of the B maps: Σ_i w_i dx[index[i, a], index[i, b]], (B, B)."""
        total = np.zeros((index.shape[1], index.shape[1]), dtype=dx.dtype)
        for weight, row in zip(w, index, strict=True):
            total += weight * dx[np.ix_(row, row)]
        return stored(total, out)
