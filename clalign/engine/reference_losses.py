"""The terms of the objective in the numpy backend."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.engine.backend import Band
from clalign.engine.reference_arrays import band_positions, stored

Array = NDArray[Any]


class ReferenceLosses:
    """Twins of `backend.Losses`; see there for the formulas."""

    dtype: np.dtype[Any]

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
        """Low-rank l_unsup and dl/dZ = −4Ω[U (T_X B − B T_Y G_Z) − Z⊥ T_Y G_Z] T_Y with G_Z = BᵀB + G."""
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
        turned: Array,
        g_x: Array,
        g_y: Array,
        g_xy: Array,
        band: Band,
        one_sided: bool = False,
        *,
        out: tuple[Array, Array, Array, Array] | None = None,
    ) -> tuple[Array, Array, Array, Array]:
        """Eq. 21 (or Eq. 18) with π fixed, from Gram matrices; the gradients are zero outside the band."""
        left = g_x @ r
        if one_sided:
            denominator = np.trace(g_y)
            numerator = np.sum(r * left) + denominator - 2 * np.sum(r * g_xy)
            gradients = (2 * (left - g_xy), np.zeros_like(r))
        else:
            right = r @ g_y
            cross = g_xy @ turned
            denominator = np.sum(r * right)
            numerator = np.sum(r * left) + denominator - 2 * np.sum(r * cross)
            gradients = (2 * (left + right - cross - turned @ g_xy), 2 * right)
        inside = np.zeros_like(r)
        inside[band_positions(band)] = 1
        values = (np.asarray(numerator), np.asarray(denominator), *(inside * gradient for gradient in gradients))
        if out is None:
            return values
        return (
            stored(values[0], out[0]),
            stored(values[1], out[1]),
            stored(values[2], out[2]),
            stored(values[3], out[3]),
        )
