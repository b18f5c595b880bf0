"""The soft correspondence on the device: quadratic form, streamed form, gradients."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clalign.engine.device import DeviceArray
from clalign.engine.kernels_arrays import ceil_div, require_shapes
from clalign.engine.kernels_products import KernelProducts
from clalign.engine.reference_soft import pair_count, pair_factor

FEATURES = 256
"""Features made at once on a CPU; they stay in the first cache."""

PAIRS = 96
"""Pairs of a block of the gradient."""


class KernelSoftMaps(KernelProducts):
    """`backend.SoftMaps` on a device; see there for the formulas."""

    def packed_moments(
        self, psi: DeviceArray, w: DeviceArray, u: DeviceArray, *, out: DeviceArray | None = None
    ) -> DeviceArray:
        """M_r = ψᵀ diag(w u_r) ψ, packed with off-diagonals doubled."""
        (n, k), r = psi.shape, u.shape[1]
        require_shapes("packed_moments", w=(w.shape, (n,)), u=(u.shape[:1], (n,)))
        result = self._result("packed_moments", (pair_count(k), r), out)
        tile = tile_rows(r, self._long_vectors)
        right = self._pack_tiles("right", u, r, n, tile, w)
        key = ("runs", k, self.device.lanes)
        if key not in self._constants:
            self._constants[key] = self.array(pair_runs(k, self.device.lanes // 2))
        runs = self._constants[key]
        panels = runs.shape[0]
        groups = self._groups(panels)
        sums = self._sums(panels, ceil_div(r, tile) * tile)
        kernel = self.device.kernel("moments", "moments", RT=tile, FB=self._features())
        arguments = (n, k, r, panels, groups, psi, runs, right, sums, result)
        self.device.launch(kernel, ceil_div(panels, groups), *arguments)
        return result

    def packed_moments_gradient(
        self, psi: DeviceArray, w: DeviceArray, dpacked: DeviceArray, *, out: DeviceArray | None = None
    ) -> DeviceArray:
        """du_ir = w_i vech'(ψ_i ψ_iᵀ) · dpacked[:, r]."""
        (n, k), r = psi.shape, dpacked.shape[1]
        require_shapes("packed_moments_gradient", w=(w.shape, (n,)), dpacked=(dpacked.shape[:1], (pair_count(k),)))
        result = self._result("packed_moments_gradient", (n, r), out)
        self._quadratic(psi, dpacked, w, result, self._constant(("pairs", k), pair_factor(k, self.dtype)))
        return result

    def soft_map(
        self,
        c: DeviceArray,
        packed: DeviceArray,
        normal: DeviceArray | None = None,
        *,
        out: tuple[DeviceArray, DeviceArray] | None = None,
    ) -> tuple[DeviceArray, DeviceArray]:
        """z_jr = c_j M_r c_jᵀ / s_j and s_j."""
        (n, k), r = c.shape, packed.shape[1]
        require_shapes("soft_map", packed=(packed.shape[:1], (pair_count(k),)))
        z = self._result("soft_map", (n, r), out and out[0])
        s = self._result("soft_map", (n,), out and out[1])
        inverse = self.device.scratch("inverse", self._padded(n))
        self._row_dots(c, self._times_normal(c, normal), s, inverse)
        self._quadratic(c, packed, inverse, z)
        return z, s

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
        """dc_j = (2 / s_j) [(Σ_r dz_jr M_r) c_j − (Σ_r dz_jr z_jr) N c_j]."""
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
        panels = ceil_div(n, self.device.lanes)
        groups = self._groups(panels)
        sums = self._sums(panels, k)
        kernel = self.device.kernel("soft_map_gradient", "soft_map_gradient", RT=self._tile, PB=PAIRS)
        arguments = (n, k, r, groups, ct, cn, dzt, packed, removed, inverse, sums, result)
        self.device.launch(kernel, ceil_div(panels, groups), *arguments)
        return result

    def soft_map_streamed(
        self,
        c: DeviceArray,
        psi: DeviceArray,
        w: DeviceArray,
        u: DeviceArray,
        *,
        out: tuple[DeviceArray, DeviceArray] | None = None,
    ) -> tuple[DeviceArray, DeviceArray]:
        """z_jr = Σ_i w_i q_ij² u_ir / s_j, s_j = Σ_i w_i q_ij²."""
        (n, k), (n_y, r) = c.shape, u.shape
        require_shapes("soft_map_streamed", psi=(psi.shape, (n_y, k)), w=(w.shape, (n_y,)))
        z = self._result("soft_map_streamed", (n, r), out and out[0])
        s = self._result("soft_map_streamed", (n,), out and out[1])
        tile = tile_rows(r, self._long_vectors)
        right = self._pack_tiles("right", u, r, n_y, tile)
        ct = self._pack_panels("c", c, n, k, 1, k)
        panels = ceil_div(n, self.device.lanes)
        groups = self._groups(panels)
        sums = self._sums(panels, ceil_div(r, tile) * tile)
        weights = self.device.scratch("weights", self._padded(n))
        kernel = self.device.kernel("soft_map_streamed", "soft_map_streamed", RT=tile, FB=self._features())
        arguments = (n, n_y, k, r, groups, ct, psi, w, right, sums, weights, z, s)
        self.device.launch(kernel, ceil_div(panels, groups), *arguments)
        return z, s

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
        """dc_j = (2 / s_j) Σ_i w_i q_ij (Σ_r dz_jr (u_ir − z_jr)) ψ_i."""
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
        panels = ceil_div(n, self.device.lanes)
        groups = self._groups(panels)
        sums = self._sums(panels, k)
        kernel = self.device.kernel(
            "soft_map_streamed", "soft_map_streamed_gradient", RT=self._tile, FB=self._features()
        )
        arguments = (n, n_y, k, r, groups, ct, psi, w, u, dzt, removed, inverse, sums, result)
        self.device.launch(kernel, ceil_div(panels, groups), *arguments)
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
        tile = tile_rows(r, self._long_vectors)
        right = self._pack_tiles("right", packed, r, pair_count(k), tile, pair_weight)
        ct = self._pack_panels("c", c, n, k, 1, k)
        panels = ceil_div(n, self.device.lanes)
        groups = self._groups(panels)
        sums = self._sums(panels, ceil_div(r, tile) * tile)
        kernel = self.device.kernel("soft_map", "soft_map", RT=tile, FB=self._features())
        arguments = (n, k, r, groups, ct, right, factor, sums, z)
        self.device.launch(kernel, ceil_div(panels, groups), *arguments)

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
        """Scratch (panels, width, lanes) in which sums wait between blocks."""
        return self.device.scratch("sums", panels * width * self.device.lanes)

    def _padded(self, n: int) -> int:
        return ceil_div(n, self.device.lanes) * self.device.lanes

    def _features(self) -> int:
        """Features made at once: private memory is scarce on a GPU."""
        return FEATURES if self.device.group == 1 else 8

    def _groups(self, panels: int) -> int:
        """Panels of one work-item: up to 4 share a block of the right side, as long as every unit has a few items."""
        if self.device.group > 1:
            return 1
        return min(4, max(1, panels // (4 * self.device.facts.units)))


def tile_rows(r: int, long_vectors: bool = False) -> int:
    """Rows of the register tile that waste least on r columns; the most where others are no better.

    AVX2 has registers for 6, AVX-512 for more.
    """
    rows = (10, 9, 8, 7) if long_vectors else (6, 5)
    return min(rows, key=lambda tile: ceil_div(r, tile) * tile)


def pair_runs(k: int, lanes: int) -> NDArray[np.int32]:
    """Runs of `lanes` pairs (a, b .. b + lanes - 1) that cover all pairs a <= b < k, two a panel: (panels, 2, 2).

    The last panel may repeat a run; it then stores the same values twice.
    """
    runs = [(a, b) for a in range(k) for b in range(a, k, lanes)]
    if len(runs) % 2:
        runs.append(runs[-1])
    return np.array(runs, dtype=np.int32).reshape(-1, 2, 2)
