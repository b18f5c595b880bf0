"""The soft correspondence on the device: quadratic form, streamed form, gradients."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clalign.engine.device import DeviceArray
from clalign.engine.kernels_arrays import ceil_div, operation, require_shapes
from clalign.engine.kernels_products import KernelProducts
from clalign.engine.reference import pair_count, pair_factor

PAIRS = 96
"""Pairs of a block of the gradient."""


class KernelSoftMaps(KernelProducts):
    """The soft correspondence and its gradients."""

    @operation
    def packed_moments(
        self, psi: DeviceArray, w: DeviceArray, u: DeviceArray, *, out: DeviceArray | None = None
    ) -> DeviceArray:
        (n, k), r = psi.shape, u.shape[1]
        require_shapes("packed_moments", w=(w.shape, (n,)), u=(u.shape[:1], (n,)))
        result = self._result("packed_moments", (pair_count(k), r), out)
        tile = fitted_tile_rows(r, self.device.constants.fitted_tile_rows)
        right = self._pack_tiles("right", u, r, n, tile, w)
        runs = self._table(("runs", k), lambda: pair_runs(k, self.device.panel_width // 2))
        panels = runs.shape[0]
        per_item = self._panels_per_item(panels)
        sums = self._sums(panels, ceil_div(r, tile) * tile)
        kernel = self.device.kernel("moments", "moments", RT=tile, FB=self.device.constants.soft_map_features)
        arguments = (n, k, r, panels, per_item, psi, runs, right, sums, result)
        self.device.launch(kernel, ceil_div(panels, per_item), *arguments)
        return result

    @operation
    def packed_moments_gradient(
        self, psi: DeviceArray, w: DeviceArray, dpacked: DeviceArray, *, out: DeviceArray | None = None
    ) -> DeviceArray:
        (n, k), r = psi.shape, dpacked.shape[1]
        require_shapes("packed_moments_gradient", w=(w.shape, (n,)), dpacked=(dpacked.shape[:1], (pair_count(k),)))
        result = self._result("packed_moments_gradient", (n, r), out)
        self._quadratic(psi, dpacked, w, result, self._table(("pairs", k), lambda: pair_factor(k, self.dtype)))
        return result

    @operation
    def soft_map(
        self,
        c: DeviceArray,
        packed: DeviceArray,
        normal: DeviceArray | None = None,
        *,
        out: tuple[DeviceArray, DeviceArray] | None = None,
    ) -> tuple[DeviceArray, DeviceArray]:
        (n, k), r = c.shape, packed.shape[1]
        require_shapes("soft_map", packed=(packed.shape[:1], (pair_count(k),)))
        z = self._result("soft_map", (n, r), out and out[0])
        s = self._result("soft_map", (n,), out and out[1])
        inverse = self.device.scratch("inverse", self._padded(n))
        self._row_dots(c, self._times_normal(c, normal), s, inverse)
        self._quadratic(c, packed, inverse, z)
        return z, s

    @operation
    def soft_map_gradient(
        self,
        c: DeviceArray,
        packed: DeviceArray,
        normal: DeviceArray | None,
        z: DeviceArray,
        s: DeviceArray,
        dz: DeviceArray,
        *,
        out: DeviceArray | None = None,
    ) -> DeviceArray:
        (n, k), r = c.shape, packed.shape[1]
        require_shapes("soft_map_gradient", packed=(packed.shape[:1], (pair_count(k),)), z=(z.shape, (n, r)))
        require_shapes("soft_map_gradient", dz=(dz.shape, (n, r)), s=(s.shape, (n,)))
        result = self._result("soft_map_gradient", (n, k), out)
        inverse = self.device.scratch("inverse", self._padded(n))
        dots = self.device.scratch("dots", self._padded(n))
        removed = self.device.scratch("removed", self._padded(n))
        product_with_n = self._times_normal(c, normal)
        self._row_dots(c, product_with_n, dots, inverse)
        self._row_dots(dz, z, removed)
        ct = self._pack_panels("c", c, n, k, 1, k)
        cn = ct if normal is None else self._pack_panels("cn", product_with_n, n, k, 1, k)
        dzt = self._pack_panels("dz", dz, n, r, 1, r)
        panels = ceil_div(n, self.device.panel_width)
        per_item = self._panels_per_item(panels)
        sums = self._sums(panels, k)
        kernel = self.device.kernel("soft_map_gradient", "soft_map_gradient", RT=self._tile, PB=PAIRS)
        arguments = (n, k, r, per_item, ct, cn, dzt, packed, removed, inverse, sums, result)
        self.device.launch(kernel, ceil_div(panels, per_item), *arguments)
        return result

    @operation
    def soft_map_streamed(
        self,
        c: DeviceArray,
        psi: DeviceArray,
        w: DeviceArray,
        u: DeviceArray,
        *,
        out: tuple[DeviceArray, DeviceArray] | None = None,
    ) -> tuple[DeviceArray, DeviceArray]:
        (n, k), (n_y, r) = c.shape, u.shape
        require_shapes("soft_map_streamed", psi=(psi.shape, (n_y, k)), w=(w.shape, (n_y,)))
        z = self._result("soft_map_streamed", (n, r), out and out[0])
        s = self._result("soft_map_streamed", (n,), out and out[1])
        tile = fitted_tile_rows(r, self.device.constants.fitted_tile_rows)
        right = self._pack_tiles("right", u, r, n_y, tile)
        ct = self._pack_panels("c", c, n, k, 1, k)
        panels = ceil_div(n, self.device.panel_width)
        per_item = self._panels_per_item(panels)
        sums = self._sums(panels, ceil_div(r, tile) * tile)
        weights = self.device.scratch("weights", self._padded(n))
        defines = {"RT": tile, "FB": self.device.constants.soft_map_features}
        kernel = self.device.kernel("soft_map_streamed", "soft_map_streamed", **defines)
        arguments = (n, n_y, k, r, per_item, ct, psi, w, right, sums, weights, z, s)
        self.device.launch(kernel, ceil_div(panels, per_item), *arguments)
        return z, s

    @operation
    def soft_map_streamed_gradient(
        self,
        c: DeviceArray,
        psi: DeviceArray,
        w: DeviceArray,
        u: DeviceArray,
        z: DeviceArray,
        s: DeviceArray,
        dz: DeviceArray,
        *,
        out: DeviceArray | None = None,
    ) -> DeviceArray:
        (n, k), (n_y, r) = c.shape, u.shape
        require_shapes("soft_map_streamed_gradient", psi=(psi.shape, (n_y, k)), w=(w.shape, (n_y,)))
        require_shapes("soft_map_streamed_gradient", z=(z.shape, (n, r)), dz=(dz.shape, (n, r)), s=(s.shape, (n,)))
        result = self._result("soft_map_streamed_gradient", (n, k), out)
        removed = self.device.scratch("removed", self._padded(n))
        self._row_dots(dz, z, removed)
        inverse = self.device.scratch("inverse", self._padded(n))
        self._reciprocal(s, inverse)
        ct = self._pack_panels("c", c, n, k, 1, k)
        dzt = self._pack_panels("dz", dz, n, r, 1, r)
        panels = ceil_div(n, self.device.panel_width)
        per_item = self._panels_per_item(panels)
        sums = self._sums(panels, k)
        defines = {"RT": self._tile, "FB": self.device.constants.soft_map_features}
        kernel = self.device.kernel("soft_map_streamed", "soft_map_streamed_gradient", **defines)
        arguments = (n, n_y, k, r, per_item, ct, psi, w, u, dzt, removed, inverse, sums, result)
        self.device.launch(kernel, ceil_div(panels, per_item), *arguments)
        return result

    def _quadratic(
        self,
        c: DeviceArray,
        packed: DeviceArray,
        factor: DeviceArray,
        z: DeviceArray,
        pair_weight: DeviceArray | None = None,
    ) -> None:
        """Queue z = diag(factor) vech(c cᵀ) · diag(pair_weight) packed."""
        (n, k), r = c.shape, packed.shape[1]
        tile = fitted_tile_rows(r, self.device.constants.fitted_tile_rows)
        right = self._pack_tiles("right", packed, r, pair_count(k), tile, pair_weight)
        ct = self._pack_panels("c", c, n, k, 1, k)
        panels = ceil_div(n, self.device.panel_width)
        per_item = self._panels_per_item(panels)
        sums = self._sums(panels, ceil_div(r, tile) * tile)
        kernel = self.device.kernel("soft_map", "soft_map", RT=tile, FB=self.device.constants.soft_map_features)
        arguments = (n, k, r, per_item, ct, right, factor, sums, z)
        self.device.launch(kernel, ceil_div(panels, per_item), *arguments)

    def _times_normal(self, c: DeviceArray, normal: DeviceArray | None) -> DeviceArray:
        """Queue c N; c itself where N is the identity."""
        if normal is None:
            return c
        n, k = c.shape
        require_shapes("soft_map", normal=(normal.shape, (k, k)))
        kept = self.device.scratch("normal", n * k)
        self._product(c, normal, kept, n, k, k, False, False)
        return kept.leading((n, k))

    def _sums(self, panels: int, width: int) -> DeviceArray:
        """Scratch (panels, width, W) in which sums wait between blocks."""
        return self.device.scratch("sums", panels * width * self.device.panel_width)

    def _padded(self, n: int) -> int:
        return ceil_div(n, self.device.panel_width) * self.device.panel_width

    def _panels_per_item(self, panels: int) -> int:
        """Panels of one work-item: the more, the fewer times the right side is read, if every unit has a few items."""
        return min(self.device.constants.soft_map_panels, max(1, panels // (4 * self.device.facts.units)))


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
