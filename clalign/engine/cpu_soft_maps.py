"""The soft correspondence on CPUs: quadratic form, streamed form, gradients."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clalign.engine.cpu_products import CpuProducts
from clalign.engine.launching import Array, ceil_div, pair_runs
from clalign.engine.reference import pair_count, pair_factor

PAIRS = 96
"""Pairs of a block of the gradient."""


class CpuSoftMaps(CpuProducts):
    """The soft correspondence and its gradients; what is computed, the twins in `Reference` say."""

    def packed_moments(self, psi: Array, w: Array, u: Array, result: Array) -> None:
        """Queue the packed moments."""
        (n, k), r = psi.shape, u.shape[1]
        tile = fitted_tile_rows(r, self.constants.fitted_tile_rows)
        right = self._pack_tiles("right", u, r, n, tile, w)
        runs = self.device.table(("runs", k), lambda: _runs_of_panels(k, self.width // 2))
        panels = runs.shape[0]
        items, per_item, sums = self._shared_out(panels, ceil_div(r, tile) * tile)
        kernel = self.device.kernel("moments", "moments", RT=tile, FB=self.constants.soft_map_features)
        arguments = (n, k, r, panels, per_item, psi, runs, right, sums, result)
        self.device.launch(kernel, items, *arguments)

    def packed_moments_gradient(self, psi: Array, w: Array, dpacked: Array, result: Array) -> None:
        """Queue their gradient by u."""
        k = psi.shape[1]
        self._quadratic(
            psi, dpacked, w, result, self.device.table(("pairs", k), lambda: pair_factor(k, self.device.dtype))
        )

    def soft_map(self, c: Array, packed: Array, normal: Array | None, z: Array, s: Array) -> None:
        """Queue Z and s from packed moments."""
        n = c.shape[0]
        inverse = self._column("inverse", n)
        self._row_dots(c, self._times_normal(c, normal), s, inverse)
        self._quadratic(c, packed, inverse, z)

    def soft_map_gradient(
        self, c: Array, packed: Array, normal: Array | None, z: Array, s: Array, dz: Array, result: Array
    ) -> None:
        """Queue the gradient by c; that of s is computed again."""
        (n, k), r = c.shape, packed.shape[1]
        inverse = self._column("inverse", n)
        dots = self._column("dots", n)
        removed = self._column("removed", n)
        product_with_n = self._times_normal(c, normal)
        self._row_dots(c, product_with_n, dots, inverse)
        self._row_dots(dz, z, removed)
        ct = self._pack_panels("c", c, n, k, 1, k)
        cn = ct if normal is None else self._pack_panels("cn", product_with_n, n, k, 1, k)
        dzt = self._pack_panels("dz", dz, n, r, 1, r)
        items, per_item, sums = self._shared_out(ceil_div(n, self.width), k)
        kernel = self.device.kernel("soft_map_gradient", "soft_map_gradient", RT=self._tile, PB=PAIRS)
        arguments = (n, k, r, per_item, ct, cn, dzt, packed, removed, inverse, sums, result)
        self.device.launch(kernel, items, *arguments)

    def soft_map_streamed(self, c: Array, psi: Array, w: Array, u: Array, z: Array, s: Array) -> None:
        """Queue Z and s from tiles of q."""
        (n, k), (n_y, r) = c.shape, u.shape
        tile = fitted_tile_rows(r, self.constants.fitted_tile_rows)
        right = self._pack_tiles("right", u, r, n_y, tile)
        ct = self._pack_panels("c", c, n, k, 1, k)
        items, per_item, sums = self._shared_out(ceil_div(n, self.width), ceil_div(r, tile) * tile)
        weights = self._column("weights", n)
        defines = {"RT": tile, "FB": self.constants.soft_map_features}
        kernel = self.device.kernel("soft_map_streamed", "soft_map_streamed", **defines)
        arguments = (n, n_y, k, r, per_item, ct, psi, w, right, sums, weights, z, s)
        self.device.launch(kernel, items, *arguments)

    def soft_map_streamed_gradient(
        self, c: Array, psi: Array, w: Array, u: Array, z: Array, s: Array, dz: Array, result: Array
    ) -> None:
        """Queue the gradient by c from tiles of q."""
        (n, k), (n_y, r) = c.shape, u.shape
        removed = self._column("removed", n)
        self._row_dots(dz, z, removed)
        inverse = self._column("inverse", n)
        self.reciprocal(s, inverse)
        ct = self._pack_panels("c", c, n, k, 1, k)
        dzt = self._pack_panels("dz", dz, n, r, 1, r)
        items, per_item, sums = self._shared_out(ceil_div(n, self.width), k)
        defines = {"RT": self._tile, "FB": self.constants.soft_map_features}
        kernel = self.device.kernel("soft_map_streamed", "soft_map_streamed_gradient", **defines)
        arguments = (n, n_y, k, r, per_item, ct, psi, w, u, dzt, removed, inverse, sums, result)
        self.device.launch(kernel, items, *arguments)

    def _quadratic(self, c: Array, packed: Array, factor: Array, z: Array, pair_weight: Array | None = None) -> None:
        """Queue z = diag(factor) vech(c cᵀ) · diag(pair_weight) packed."""
        (n, k), r = c.shape, packed.shape[1]
        tile = fitted_tile_rows(r, self.constants.fitted_tile_rows)
        right = self._pack_tiles("right", packed, r, pair_count(k), tile, pair_weight)
        ct = self._pack_panels("c", c, n, k, 1, k)
        items, per_item, sums = self._shared_out(ceil_div(n, self.width), ceil_div(r, tile) * tile)
        kernel = self.device.kernel("soft_map", "soft_map", RT=tile, FB=self.constants.soft_map_features)
        arguments = (n, k, r, per_item, ct, right, factor, sums, z)
        self.device.launch(kernel, items, *arguments)

    def _times_normal(self, c: Array, normal: Array | None) -> Array:
        """Queue c N; c itself where N is the identity."""
        if normal is None:
            return c
        n, k = c.shape
        kept = self.device.scratch("normal", n * k)
        kept = kept.leading((n, k))
        self.product(c, normal, kept)
        return kept

    def _column(self, name: str, n: int) -> Array:
        """Scratch of n elements, padded to whole panels."""
        return self.device.scratch(name, ceil_div(n, self.width) * self.width)

    def _shared_out(self, panels: int, width: int) -> tuple[int, int, Array]:
        """Work-items, panels of each, and scratch (panels, width, W) in which sums wait between blocks.

        The more panels of one item, the fewer times the right side is read, if every unit has a few items.
        """
        per_item = min(self.constants.soft_map_panels, max(1, panels // (4 * self.device.facts.units)))
        sums = self.device.scratch("sums", panels * width * self.width)
        return ceil_div(panels, per_item), per_item, sums


def fitted_tile_rows(r: int, choices: Sequence[int]) -> int:
    """Rows of the register tile that waste least on r columns; the first of the choices where others are no better."""
    return min(choices, key=lambda rows: ceil_div(r, rows) * rows)


def _runs_of_panels(k: int, length: int) -> NDArray[np.int32]:
    """Runs of pairs, two a panel: (panels, 2, 2). The last may repeat a run; it then stores the same values twice."""
    runs = pair_runs(k, length)
    return np.concatenate([runs, runs[len(runs) - len(runs) % 2 :]]).reshape(-1, 2, 2)
