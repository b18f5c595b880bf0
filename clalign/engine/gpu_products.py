"""Dense, banded and triangular linear algebra on GPUs: tiles of work-groups, panels in local memory."""

from __future__ import annotations

from clalign.engine.band import Band
from clalign.engine.device_class import Tile
from clalign.engine.gpu_arrays import GpuArrays
from clalign.engine.launching import NO_BANDS, Array, ceil_div, equal_parts, panel_ranges, row_ranges

SOLVED_ROWS = 16
"""Rows that a work-group solves with a Cholesky factor."""

Bands = tuple[Band | None, Band | None, Band | None]


class GpuProducts(GpuArrays):
    """Dense and banded linear algebra."""

    def product(
        self,
        a: Array,
        b: Array,
        result: Array,
        transpose_a: bool = False,
        transpose_b: bool = False,
        scale: float = 1.0,
        accumulate: bool = False,
    ) -> None:
        """Queue result (+)= scale · op(a) op(b); a left side that is not transposed may have more columns."""
        a_strides = (1, a.shape[1]) if transpose_a else (a.shape[1], 1)
        depth, b_strides = (b.shape[1], (1, b.shape[1])) if transpose_b else (b.shape[0], (b.shape[1], 1))
        self._product(a, a_strides, None, b, b_strides, depth, result, scale, accumulate)

    def banded_product(self, a: Array, b: Array, result: Array, bands: Bands, scale: float, accumulate: bool) -> None:
        """Queue result (+)= scale · a b; tiles of zeros and tiles that nobody reads are skipped."""
        strides = (a.shape[1], 1), (b.shape[1], 1)
        self._product(a, strides[0], None, b, strides[1], b.shape[0], result, scale, accumulate, bands)

    def weighted_gram(self, a: Array, b: Array, w: Array | None, result: Array) -> None:
        """Queue aᵀ diag(w) b, cut along the rows where the result has too few tiles to keep the device busy."""
        (depth, m), n = a.shape, b.shape[1]
        symmetric = a.memory is b.memory and a.shape == b.shape
        tile = self._product_tile(m, n)
        tiles = ceil_div(m, tile.rows) * ceil_div(n, tile.columns)
        splits, split_depth = equal_parts(depth, self._splits(tiles, depth, self.constants.split_depth))
        if splits == 1 and not symmetric:
            self._product(a, (1, m), w, b, (n, 1), depth, result, 1.0, False)
            return
        sums = self.device.scratch("splits", splits * m * n)
        kernel = self._tiled("gpu_product", "product", tile)
        sizes = (m, n, depth, split_depth, 1.0, 0, int(symmetric))
        groups = (ceil_div(m, tile.rows), ceil_div(n, tile.columns), splits)
        self._launch_groups(kernel, groups, *sizes, a, 1, m, w, b, n, 1, *NO_BANDS, sums)
        kernel = self.device.kernel("gpu_splits", "sum_splits")
        self.device.launch(kernel, m * n, m, n, splits, 1.0, 0, int(symmetric), sums, result)

    def solve_right(self, gram: Array, rhs: Array, ridge: float, result: Array) -> None:
        """Queue result = rhs (gram + ridge · trace(gram) / k · I)⁻¹."""
        m, k = rhs.shape
        factor = self.device.scratch("cholesky", k * k)
        self._launch_groups(self.device.kernel("gpu_cholesky", "factorise"), (1,), k, ridge, gram, factor)
        kernel = self.device.kernel("gpu_cholesky", "solve_rows")
        self._launch_groups(kernel, (ceil_div(m, SOLVED_ROWS),), m, k, factor, rhs, result)

    def distortion_core(
        self, core_x: Array, core_y: Array, inside: Array, gram: Array, value: Array, last: Array, across: Array
    ) -> bool:
        """Queue the small matrices of the distortion in one launch, and tell whether they are small enough for it."""
        tile, (r_x, r_y) = self.constants.core, inside.shape
        if max(r_x, r_y) > tile.rows:
            return False
        work = self.device.scratch("distortion", 7 * tile.rows * tile.columns)
        kernel = self._tiled("gpu_distortion", "distortion_core", tile)
        self._launch_groups(kernel, (1,), r_x, r_y, core_x, core_y, inside, gram, work, value, last, across)
        return True

    def _product(
        self,
        a: Array,
        a_strides: tuple[int, int],
        w: Array | None,
        b: Array,
        b_strides: tuple[int, int],
        depth: int,
        result: Array,
        scale: float,
        accumulate: bool,
        bands: Bands = NO_BANDS,
    ) -> None:
        """Queue a product of two sides given by their strides: (row, step) of the left, (step, column) of the right."""
        m, n = result.shape
        tile = self._product_tile(m, n)
        kept = (
            self._ranges(bands[0], tile.rows, row_ranges),
            self._ranges(bands[1], tile.columns, panel_ranges),
            self._ranges(bands[2], tile.columns, panel_ranges),
        )
        kernel = self._tiled("gpu_product", "product", tile)
        sizes = (m, n, depth, depth, scale, int(accumulate), 0)
        groups = (ceil_div(m, tile.rows), ceil_div(n, tile.columns))
        self._launch_groups(kernel, groups, *sizes, a, *a_strides, w, b, *b_strides, *kept, result)

    def _product_tile(self, m: int, n: int) -> Tile:
        """Return the large tile where there are enough of it."""
        large, wanted = self.constants.large, self.constants.groups_per_unit * self.device.facts.units
        return large if ceil_div(m, large.rows) * ceil_div(n, large.columns) >= wanted else self.constants.small
