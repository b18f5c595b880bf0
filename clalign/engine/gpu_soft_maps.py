"""The soft correspondence on GPUs: products whose left side is made in local memory, and two chained ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clalign.engine.gpu_arrays import ROW_ITEMS
from clalign.engine.gpu_products import GpuProducts
from clalign.engine.launching import Array, ceil_div, equal_parts, pair_runs
from clalign.engine.reference import pair_count, pair_factor

BLOCK_EDGE = 8
"""Functions along either side of a block of pairs of the gradient."""


class GpuSoftMaps(GpuProducts):
    """The soft correspondence and its gradients; what is computed, the twins in `Reference` say."""

    def packed_moments(self, psi: Array, w: Array, u: Array, result: Array) -> None:
        """Queue the packed moments."""
        (n, k), r = psi.shape, u.shape[1]
        tile, count = self.constants.soft_map, pair_count(k)
        tiles = (ceil_div(count, tile.rows), ceil_div(r, tile.columns))
        splits, split_rows = equal_parts(n, self._splits(tiles[0] * tiles[1], n, self.constants.split_depth))
        sums = result if splits == 1 else self.device.scratch("splits", splits * count * r)
        pairs = self.device.table(("triangle", k), lambda: np.stack(np.triu_indices(k), axis=1))
        kernel = self._tiled("gpu_soft_map", "moments", tile)
        self._launch_groups(kernel, (*tiles, splits), n, k, r, split_rows, psi, w, u, pairs, sums)
        if splits > 1:
            kernel = self.device.kernel("gpu_splits", "sum_splits")
            self.device.launch(kernel, count * r, count, r, splits, 1.0, 0, 0, sums, result)

    def packed_moments_gradient(self, psi: Array, w: Array, dpacked: Array, result: Array) -> None:
        """Queue their gradient by u."""
        k = psi.shape[1]
        factor = self.device.table(("pairs", k), lambda: pair_factor(k, self.device.dtype))
        doubled = self.device.scratch("doubled", dpacked.size).leading(dpacked.shape)
        self.scale_rows(dpacked, factor, doubled)
        splits, sums = self._quadratic(psi, doubled)
        self._finish_soft_map(sums, splits, w, None, psi, psi, result, None)

    def soft_map(self, c: Array, packed: Array, normal: Array | None, z: Array, s: Array) -> None:
        """Queue Z and s from packed moments."""
        splits, sums = self._quadratic(c, packed)
        self._finish_soft_map(sums, splits, None, None, c, self._times_normal(c, normal), z, s)

    def soft_map_gradient(
        self, c: Array, packed: Array, normal: Array | None, z: Array, s: Array, dz: Array, result: Array
    ) -> None:
        """Queue the gradient by c."""
        (n, k), r = c.shape, packed.shape[1]
        tile = self.constants.gradient
        blocks = self.device.table(("blocks", k), lambda: pair_blocks(k, BLOCK_EDGE))
        count, tiles = blocks.shape[0], ceil_div(n, tile.rows)
        splits, split_blocks = equal_parts(count, self._splits(tiles, count, 1))
        sums = self.device.scratch("splits", splits * n * k)
        kernel = self._tiled("gpu_soft_map_gradient", "soft_map_gradient", tile)
        sizes = (n, k, r, count, split_blocks)
        self._launch_groups(kernel, (tiles, splits), *sizes, c, dz, packed, blocks, sums)
        self._finish_gradient(sums, splits, 1.0, self._times_normal(c, normal), z, dz, s, result)

    def soft_map_streamed(self, c: Array, psi: Array, w: Array, u: Array, z: Array, s: Array) -> None:
        """Queue Z and s from tiles of q."""
        (n, k), (n_y, r) = c.shape, u.shape
        tile = self.constants.streamed
        groups = (ceil_div(n, tile.rows), ceil_div(r, tile.columns))
        splits, split_tiles = self._split_tiles(groups[0] * groups[1], n_y)
        sums = self.device.scratch("splits", splits * n * r)
        weights = self.device.scratch("weights", splits * n)
        kernel = self._tiled("gpu_soft_map_streamed", "soft_map_streamed", tile, self.constants.streamed_unroll)
        self._launch_groups(kernel, (*groups, splits), n, n_y, k, r, split_tiles, c, psi, w, u, sums, weights)
        self._finish_soft_map(sums, splits, None, weights, c, c, z, s)

    def soft_map_streamed_gradient(
        self, c: Array, psi: Array, w: Array, u: Array, z: Array, s: Array, dz: Array, result: Array
    ) -> None:
        """Queue the gradient by c from tiles of q."""
        (n, k), (n_y, r) = c.shape, u.shape
        tile = self.constants.streamed
        removed = self.device.scratch("removed", n)
        self._row_dots(dz, z, removed)
        tiles = ceil_div(n, tile.rows)
        splits, split_tiles = self._split_tiles(tiles, n_y)
        sums = self.device.scratch("splits", splits * n * k)
        name = "soft_map_streamed_gradient"
        kernel = self._tiled("gpu_soft_map_streamed", name, tile, self.constants.streamed_unroll)
        sizes = (n, n_y, k, r, split_tiles)
        self._launch_groups(kernel, (tiles, 1, splits), *sizes, c, psi, w, u, dz, removed, sums)
        self._finish_gradient(sums, splits, 2.0, None, z, dz, s, result)

    def _quadratic(self, c: Array, packed: Array) -> tuple[int, Array]:
        """Queue vech(c cᵀ) · packed in parts: how many, and they (parts, n, r)."""
        (n, k), r = c.shape, packed.shape[1]
        tile = self.constants.soft_map
        ct = self.device.scratch("transposed", n * k).leading((k, n))
        self.transpose(c, ct)
        runs = self.device.table(("runs", k, tile.depth), lambda: pair_runs(k, tile.depth))
        count = runs.shape[0]
        groups = (ceil_div(n, tile.rows), ceil_div(r, tile.columns))
        least = self.constants.split_depth // tile.depth
        splits, split_runs = equal_parts(count, self._splits(groups[0] * groups[1], count, least))
        sums = self.device.scratch("splits", splits * n * r)
        kernel = self._tiled("gpu_soft_map", "soft_map", tile)
        self._launch_groups(kernel, (*groups, splits), n, k, r, count, split_runs, ct, packed, runs, sums)
        return splits, sums

    def _finish_soft_map(
        self,
        sums: Array,
        splits: int,
        factor: Array | None,
        weights: Array | None,
        c: Array,
        cn: Array,
        z: Array,
        s: Array | None,
    ) -> None:
        """Queue z = diag(1 / s) or diag(factor) Σ sums; s is Σ weights, or else c_j·cn_j."""
        (n, r), k = z.shape, c.shape[1]
        kernel = self.device.kernel("gpu_splits", "finish_soft_map")
        self.device.launch(kernel, n * ROW_ITEMS, n, r, k, splits, sums, factor, weights, c, cn, s, z)

    def _finish_gradient(
        self, sums: Array, splits: int, scale: float, cn: Array | None, z: Array, dz: Array, s: Array, result: Array
    ) -> None:
        """Queue result = diag(1 / s) (scale Σ sums − 2 diag(dz_j·z_j) cn), without the last term where cn is None."""
        (n, k), r = result.shape, z.shape[1]
        kernel = self.device.kernel("gpu_splits", "finish_gradient")
        self.device.launch(kernel, n * ROW_ITEMS, n, k, r, splits, scale, sums, cn, z, dz, s, result)

    def _split_tiles(self, tiles: int, n_y: int) -> tuple[int, int]:
        """Into how many parts the vertices are cut, and the tiles of each."""
        count = ceil_div(n_y, self.constants.streamed.columns)
        return equal_parts(count, self._splits(tiles, count, 1))

    def _times_normal(self, c: Array, normal: Array | None) -> Array:
        """Queue c N; c itself where N is the identity."""
        if normal is None:
            return c
        kept = self.device.scratch("normal", c.size).leading(c.shape)
        self.product(c, normal, kept)
        return kept


def pair_blocks(k: int, edge: int) -> NDArray[np.int32]:
    """First a and b of the blocks of `edge` × `edge` pairs that cover all pairs a <= b < k: (blocks, 2)."""
    return np.array([(a, b) for a in range(0, k, edge) for b in range(a, k, edge)], dtype=np.int32)
