"""The soft correspondence of the numpy backend, quadratic form and streamed form."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.engine.reference_arrays import reciprocal, stored

Array = NDArray[Any]

FEATURE_ELEMENTS = 1 << 23
"""Elements of the largest intermediate, which bounds the memory of every function here."""


def pair_count(k: int) -> int:
    """Pairs (a, b) with a <= b < k."""
    return k * (k + 1) // 2


def pair_factor(k: int, dtype: Any) -> Array:
    """1 for the pairs (a, a), 2 for the others, in the order of ``numpy.triu_indices``: (k (k + 1) / 2,)."""
    first, second = np.triu_indices(k)
    return np.where(first == second, 1, 2).astype(dtype)


def features(c: Array) -> Array:
    """vech(c_j c_jᵀ) for every row of c (n, k): (n, k (k + 1) / 2)."""
    first, second = np.triu_indices(c.shape[1])
    return c[:, first] * c[:, second]


def blocks(rows: int, width: int) -> Iterator[slice]:
    """Cut `rows` rows of `width` elements into blocks of bounded size."""
    step = max(1, FEATURE_ELEMENTS // max(width, 1))
    for start in range(0, rows, step):
        yield slice(start, min(rows, start + step))


class ReferenceSoftMaps:
    """Twins of `backend.SoftMaps`; see there for the formulas."""

    dtype: np.dtype[Any]

    def packed_moments(self, psi: Array, w: Array, u: Array, *, out: Array | None = None) -> Array:
        """M_r = ψᵀ diag(w u_r) ψ, packed with off-diagonals doubled."""
        count = pair_count(psi.shape[1])
        packed = np.zeros((count, u.shape[1]), dtype=psi.dtype)
        for rows in blocks(psi.shape[0], count):
            packed += features(psi[rows]).T @ (w[rows, None] * u[rows])
        return stored(packed * pair_factor(psi.shape[1], psi.dtype)[:, None], out)

    def packed_moments_gradient(self, psi: Array, w: Array, dpacked: Array, *, out: Array | None = None) -> Array:
        """du_ir = w_i vech'(ψ_i ψ_iᵀ) · dpacked[:, r]."""
        doubled = dpacked * pair_factor(psi.shape[1], psi.dtype)[:, None]
        return stored(w[:, None] * self._quadratic(psi, doubled), out)

    def soft_map(
        self, c: Array, packed: Array, normal: Array | None = None, *, out: tuple[Array, Array] | None = None
    ) -> tuple[Array, Array]:
        """z_jr = c_j M_r c_jᵀ / s_j and s_j."""
        s = np.sum(c * (c if normal is None else c @ normal), axis=1)
        z = self._quadratic(c, packed) * reciprocal(s)[:, None]
        return self._pair(z, s, out)

    def soft_map_gradient(
        self,
        c: Array,
        packed: Array,
        normal: Array | None,
        z: Array,
        s: Array,
        dz: Array,
        *,
        out: Array | None = None,
    ) -> Array:
        """dc_j = (2 / s_j) [(Σ_r dz_jr M_r) c_j − (Σ_r dz_jr z_jr) N c_j]."""
        first, second = np.triu_indices(c.shape[1])
        gradient = np.zeros_like(c)
        for rows in blocks(c.shape[0], first.size):
            full = np.zeros((gradient[rows].shape[0], c.shape[1], c.shape[1]), dtype=c.dtype)
            full[:, first, second] = dz[rows] @ packed.T
            gradient[rows] = ((full + full.transpose(0, 2, 1)) @ c[rows, :, None])[:, :, 0]
        removed = np.sum(dz * z, axis=1)[:, None] * (c if normal is None else c @ normal)
        return stored((gradient - 2 * removed) * reciprocal(s)[:, None], out)

    def soft_map_streamed(
        self, c: Array, psi: Array, w: Array, u: Array, *, out: tuple[Array, Array] | None = None
    ) -> tuple[Array, Array]:
        """z_jr = Σ_i w_i q_ij² u_ir / s_j, s_j = Σ_i w_i q_ij²."""
        z = np.zeros((c.shape[0], u.shape[1]), dtype=c.dtype)
        s = np.zeros(c.shape[0], dtype=c.dtype)
        for rows in blocks(c.shape[0], psi.shape[0]):
            weights = (c[rows] @ psi.T) ** 2 * w
            s[rows] = weights.sum(axis=1)
            z[rows] = (weights @ u) * reciprocal(s[rows])[:, None]
        return self._pair(z, s, out)

    def soft_map_streamed_gradient(
        self,
        c: Array,
        psi: Array,
        w: Array,
        u: Array,
        z: Array,
        s: Array,
        dz: Array,
        *,
        out: Array | None = None,
    ) -> Array:
        """dc_j = (2 / s_j) Σ_i w_i q_ij (Σ_r dz_jr (u_ir − z_jr)) ψ_i."""
        gradient = np.zeros_like(c)
        removed = np.sum(dz * z, axis=1)
        for rows in blocks(c.shape[0], psi.shape[0]):
            slope = (dz[rows] @ u.T - removed[rows, None]) * (c[rows] @ psi.T) * w
            gradient[rows] = 2 * (slope @ psi) * reciprocal(s[rows])[:, None]
        return stored(gradient, out)

    @staticmethod
    def _quadratic(c: Array, packed: Array) -> Array:
        z = np.zeros((c.shape[0], packed.shape[1]), dtype=c.dtype)
        for rows in blocks(c.shape[0], packed.shape[0]):
            z[rows] = features(c[rows]) @ packed
        return z

    @staticmethod
    def _pair(z: Array, s: Array, out: tuple[Array, Array] | None) -> tuple[Array, Array]:
        if out is None:
            return z, s
        return stored(z, out[0]), stored(s, out[1])
