"""The soft correspondence on the device: quadratic form, streamed form, gradients."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clalign.engine.kernels_arrays import Array, ArrayPair, ceil_div, operation, require_shapes
from clalign.engine.kernels_products import KernelProducts
from clalign.engine.reference import pair_count, pair_factor

PAIRS = 96
"""Pairs of a block of the gradient."""


class KernelSoftMaps(KernelProducts):
    """The soft correspondence and its gradients."""

    @operation
    def packed_moments(self, psi: Array, w: Array, u: Array, *, out: Array | None = None) -> Array:
        (n, k), r = psi.shape, u.shape[1]
        require_shapes("packed_moments", w=(w.shape, (n,)), u=(u.shape[:1], (n,)))
        result = self._result("packed_moments", (pair_count(k), r), out)
        tile = fitted_tile_rows(r, self.device.constants.fitted_tile_rows)
        right = self._pack_tiles("right", u, r, n, tile, w)
        runs = self._table(("runs", k), lambda: pair_runs(k, self.device.panel_width // 2))
        panels = runs.shape[0]
        items, per_item, sums = self._shared_out(panels, ceil_div(r, tile) * tile)
        kernel = self.device.kernel("moments", "moments", RT=tile, FB=self.device.constants.soft_map_features)
        arguments = (n, k, r, panels, per_item, psi, runs, right, sums, result)
        self.device.launch(kernel, items, *arguments)
        return result

    @operation
    def packed_moments_gradient(self, psi: Array, w: Array, dpacked: Array, *, out: Array | None = None) -> Array:
        (n, k), r = psi.shape, dpacked.shape[1]
        require_shapes("packed_moments_gradient", w=(w.shape, (n,)), dpacked=(dpacked.shape[:1], (pair_count(k),)))
        result = self._result("packed_moments_gradient", (n, r), out)
        self._quadratic(psi, dpacked, w, result, self._table(("pairs", k), lambda: pair_factor(k, self.dtype)))
        return result

    @operation
    def soft_map(
        self, c: Array, packed: Array, normal: Array | None = None, *, out: ArrayPair | None = None
    ) -> ArrayPair:
        (n, k), r = c.shape, packed.shape[1]
        require_shapes("soft_map", packed=(packed.shape[:1], (pair_count(k),)))
        z = self._result("soft_map", (n, r), out and out[0])
        s = self._result("soft_map", (n,), out and out[1])
        inverse = self._column("inverse", n)
        self._row_dots(c, self._times_normal(c, normal), s, inverse)
        self._quadratic(c, packed, inverse, z)
        return z, s

    @operation
    def soft_map_gradient(
        self, c: Array, packed: Array, normal: Array | None, z: Array, s: Array, dz: Array, *, out: Array | None = None
    ) -> Array:
        (n, k), r = c.shape, packed.shape[1]
        require_shapes("soft_map_gradient", packed=(packed.shape[:1], (pair_count(k),)), z=(z.shape, (n, r)))
        require_shapes("soft_map_gradient", dz=(dz.shape, (n, r)), s=(s.shape, (n,)))
        result = self._result("soft_map_gradient", (n, k), out)
        inverse = self._column("inverse", n)
        dots = self._column("dots", n)
        removed = self._column("removed", n)
        product_with_n = self._times_normal(c, normal)
        self._row_dots(c, product_with_n, dots, inverse)
        self._row_dots(dz, z, removed)
        ct = self._pack_panels("c", c, n, k, 1, k)
        cn = ct if normal is None else self._pack_panels("cn", product_with_n, n, k, 1, k)
        dzt = self._pack_panels("dz", dz, n, r, 1, r)
        items, per_item, sums = self._shared_out(ceil_div(n, self.device.panel_width), k)
        kernel = self.device.kernel("soft_map_gradient", "soft_map_gradient", RT=self._tile, PB=PAIRS)
        arguments = (n, k, r, per_item, ct, cn, dzt, packed, removed, inverse, sums, result)
        self.device.launch(kernel, items, *arguments)
        return result

    @operation
    def soft_map_streamed(self, c: Array, psi: Array, w: Array, u: Array, *, out: ArrayPair | None = None) -> ArrayPair:
        (n, k), (n_y, r) = c.shape, u.shape
        require_shapes("soft_map_streamed", psi=(psi.shape, (n_y, k)), w=(w.shape, (n_y,)))
        z = self._result("soft_map_streamed", (n, r), out and out[0])
        s = self._result("soft_map_streamed", (n,), out and out[1])
        tile = fitted_tile_rows(r, self.device.constants.fitted_tile_rows)
        right = self._pack_tiles("right", u, r, n_y, tile)
        ct = self._pack_panels("c", c, n, k, 1, k)
        items, per_item, sums = self._shared_out(ceil_div(n, self.device.panel_width), ceil_div(r, tile) * tile)
        weights = self._column("weights", n)
        defines = {"RT": tile, "FB": self.device.constants.soft_map_features}
        kernel = self.device.kernel("soft_map_streamed", "soft_map_streamed", **defines)
        arguments = (n, n_y, k, r, per_item, ct, psi, w, right, sums, weights, z, s)
        self.device.launch(kernel, items, *arguments)
        return z, s

    @operation
    def soft_map_streamed_gradient(
        self, c: Array, psi: Array, w: Array, u: Array, z: Array, s: Array, dz: Array, *, out: Array | None = None
    ) -> Array:
        (n, k), (n_y, r) = c.shape, u.shape
        require_shapes("soft_map_streamed_gradient", psi=(psi.shape, (n_y, k)), w=(w.shape, (n_y,)))
        require_shapes("soft_map_streamed_gradient", z=(z.shape, (n, r)), dz=(dz.shape, (n, r)), s=(s.shape, (n,)))
        result = self._result("soft_map_streamed_gradient", (n, k), out)
        removed = self._column("removed", n)
        self._row_dots(dz, z, removed)
        inverse = self._column("inverse", n)
        self._reciprocal(s, inverse)
        ct = self._pack_panels("c", c, n, k, 1, k)
        dzt = self._pack_panels("dz", dz, n, r, 1, r)
        items, per_item, sums = self._shared_out(ceil_div(n, self.device.panel_width), k)
        defines = {"RT": self._tile, "FB": self.device.constants.soft_map_features}
        kernel = self.device.kernel("soft_map_streamed", "soft_map_streamed_gradient", **defines)
        arguments = (n, n_y, k, r, per_item, ct, psi, w, u, dzt, removed, inverse, sums, result)
        self.device.launch(kernel, items, *arguments)
        return result

    def _quadratic(self, c: Array, packed: Array, factor: Array, z: Array, pair_weight: Array | None = None) -> None:
        """Queue z = diag(factor) vech(c cᵀ) · diag(pair_weight) packed."""
        (n, k), r = c.shape, packed.shape[1]
        tile = fitted_tile_rows(r, self.device.constants.fitted_tile_rows)
        right = self._pack_tiles("right", packed, r, pair_count(k), tile, pair_weight)
        ct = self._pack_panels("c", c, n, k, 1, k)
        items, per_item, sums = self._shared_out(ceil_div(n, self.device.panel_width), ceil_div(r, tile) * tile)
        kernel = self.device.kernel("soft_map", "soft_map", RT=tile, FB=self.device.constants.soft_map_features)
        arguments = (n, k, r, per_item, ct, right, factor, sums, z)
        self.device.launch(kernel, items, *arguments)

    def _times_normal(self, c: Array, normal: Array | None) -> Array:
        """Queue c N; c itself where N is the identity."""
        if normal is None:
            return c
        n, k = c.shape
        require_shapes("soft_map", normal=(normal.shape, (k, k)))
        kept = self.device.scratch("normal", n * k)
        self._product(c, normal, kept, n, k, k, False, False)
        return kept.leading((n, k))

    def _column(self, name: str, n: int) -> Array:
        """Scratch of n elements, padded to whole panels."""
        return self.device.scratch(name, ceil_div(n, self.device.panel_width) * self.device.panel_width)

    def _shared_out(self, panels: int, width: int) -> tuple[int, int, Array]:
        """Work-items, panels of each, and scratch (panels, width, W) in which sums wait between blocks.

        The more panels of one item, the fewer times the right side is read, if every unit has a few items.
        """
        per_item = min(self.device.constants.soft_map_panels, max(1, panels // (4 * self.device.facts.units)))
        sums = self.device.scratch("sums", panels * width * self.device.panel_width)
        return ceil_div(panels, per_item), per_item, sums


def fitted_tile_rows(r: int, choices: Sequence[int]) -> int:
    """Rows of the register tile that waste least on r columns; the first of the choices where others are no better."""
    return min(choices, key=lambda rows: ceil_div(r, rows) * rows)


def pair_runs(k: int, length: int) -> NDArray[np.int32]:
    """Runs of `length` pairs (a, b .. b + length - 1) that cover all pairs a <= b < k, two a panel: (panels, 2, 2).

    The last panel may repeat a run; it then stores the same values twice.
    """
    runs = [(a, b) for a in range(k) for b in range(a, k, length)]
    if len(runs) % 2:
        runs.append(runs[-1])
    return np.array(runs, dtype=np.int32).reshape(-1, 2, 2)
