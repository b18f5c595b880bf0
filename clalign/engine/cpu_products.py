"""Dense, banded and triangular linear algebra on CPUs: register tiles on packed panels."""

from __future__ import annotations

from typing import Any

from clalign.engine.band import Band
from clalign.engine.cpu_arrays import CpuArrays
from clalign.engine.launching import NO_BANDS, Array, ceil_div, equal_parts, panel_ranges, row_ranges

DEPTH_BLOCK = 256
"""Depth of a block: a panel of it and the rows that meet it stay in the first cache."""

DEPTH_PACKED = 512
"""Depth that one work-item packs."""

PACK_ABOVE = 8
"""Row groups above which packing a long right side pays for its extra launch."""

PACK_LENGTH = 352
"""Rows or columns above which a right side is long: a smaller one is read well enough as it is."""

PACK_CROSSING = 200
"""Row groups above which a right side is packed because loads from its rows cross cache lines."""

DEPTH_SPLIT = 512
"""Least depth of a split of a Gram matrix."""

GRAM_BLOCK = 128
"""Depth of a block of a Gram matrix."""

GRAM_SPLITS = 8
"""Most splits of a Gram matrix."""

CHOLESKY_ITEMS = 8
"""Work-items of the one group that factorises."""


class CpuProducts(CpuArrays):
    """Dense and banded linear algebra."""

    @property
    def _tile(self) -> int:
        """Rows of the register tile of plain products."""
        return self.constants.tile_rows

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
        self._product(a, b, result, transpose_a, transpose_b, scale, accumulate)

    def banded_product(
        self,
        a: Array,
        b: Array,
        result: Array,
        bands: tuple[Band | None, Band | None, Band | None],
        scale: float,
        accumulate: bool,
    ) -> None:
        """Queue result (+)= scale · a b; tiles of zeros and tiles that nobody reads are skipped."""
        left, right, kept = bands
        skipped = (
            self._ranges(left, self._tile, row_ranges),
            self._ranges(right, self.width, panel_ranges),
            self._ranges(kept, self.width, panel_ranges),
        )
        self._product(a, b, result, False, False, scale, accumulate, skipped)

    def weighted_gram(self, a: Array, b: Array, w: Array | None, result: Array) -> None:
        """Queue aᵀ diag(w) b. Work-items pack what they read; each sums a split of the depth for some rows.

        Computed is the transpose where that fills the register tiles better.
        """
        units, tile, width = self.device.facts.units, self._tile, self.width

        def area(rows: int, columns: int) -> int:
            return ceil_div(rows, tile) * tile * ceil_div(columns, width) * width

        symmetric = a.memory is b.memory and a.shape == b.shape
        transposed = area(b.shape[1], a.shape[1]) < area(a.shape[1], b.shape[1])
        if transposed:
            a, b = b, a
        (depth, m), n = a.shape, b.shape[1]
        group_count, panel_count = ceil_div(m, tile), ceil_div(n, width)
        # Not by the number of units: a sum must be the same on one core and on many.
        most = min(max(2, min(GRAM_SPLITS, depth // DEPTH_SPLIT)), ceil_div(depth, GRAM_BLOCK))
        splits, split_depth = equal_parts(depth, most)
        groups = ceil_div(group_count, min(group_count, ceil_div(units, splits)))
        parts = ceil_div(group_count, groups)
        packed = self.device.scratch("gram.packed", splits * parts * (panel_count * width + tile) * GRAM_BLOCK)
        partial = self.device.scratch("gram.partial", splits * area(m, n))
        kernel = self.device.kernel("gram", "gram", RT=tile, KB=GRAM_BLOCK)
        sizes = (m, n, depth, parts, groups, split_depth)
        self.device.launch(kernel, (parts, splits), *sizes, int(symmetric), a, b, w, packed, partial)
        kernel = self.device.kernel("gram", "gather_gram", RT=tile, KB=GRAM_BLOCK)
        self.device.launch(kernel, group_count, m, n, splits, int(symmetric), int(transposed), partial, result)

    def solve_right(self, gram: Array, rhs: Array, ridge: float, result: Array) -> None:
        """Queue result = rhs (gram + ridge · trace(gram) / k · I)⁻¹."""
        m, k = rhs.shape
        launch, kernel = self.device.launch, self.device.kernel
        factor = self.device.scratch("cholesky", k * k)
        factorise = kernel("cholesky", "factorise", CHOLESKY_ITEMS=CHOLESKY_ITEMS)
        launch(factorise, CHOLESKY_ITEMS, k, ridge, gram, factor, work_group=CHOLESKY_ITEMS)
        panels = self._pack_panels("rhs", rhs, m, k, 1, k)
        solve = kernel("cholesky", "solve_rows", CHOLESKY_ITEMS=CHOLESKY_ITEMS)
        launch(solve, ceil_div(m, self.width), m, k, factor, panels, result)

    def distortion_core(
        self,
        core_x: Array,
        core_y: Array,
        inside: Array,
        gram: Array,
        value: Array,
        last: Array,
        across: Array,
    ) -> bool:
        """Leave the small matrices of the distortion to products: a CPU loses little by many launches."""
        return False

    def _product(
        self,
        a: Array,
        b: Array,
        result: Array,
        transpose_a: bool,
        transpose_b: bool,
        scale: float,
        accumulate: bool,
        skipped: tuple[Array | None, Array | None, Array | None] = NO_BANDS,
    ) -> None:
        """Queue a product, packing a side where what it reads is not contiguous or is read often.

        `skipped` is what is left out of the left side, the right side and the result: tables as in ``product.cl``,
        int32 (groups, 2) or (panels, 2), or None.
        """
        (m, n), width = result.shape, self.width
        depth, columns = b.shape[1 if transpose_b else 0], a.shape[1]
        group_count, panel_count = ceil_div(m, self._tile), ceil_div(n, width)
        # Loads from rows that are no whole number of vectors cross cache lines.
        read_badly = (max(n, depth) > PACK_LENGTH and group_count > PACK_ABOVE) or (
            n % (width // 2) != 0 and group_count > PACK_CROSSING
        )
        if transpose_b or (not transpose_a and n > width and read_badly):
            strides = (1, depth) if transpose_b else (n, 1)
            b, b_step, b_panel = self._pack_panels("right", b, n, depth, *strides), width, depth * width
        else:
            b_step, b_panel = n, width
        a_row, a_step = (1, m) if transpose_a else (columns, 1)
        a_group = self._tile * a_row
        if transpose_a and depth > DEPTH_BLOCK:
            a = self._pack_tiles("left", a, m, depth, self._tile)
            a_group, a_row, a_step = depth * self._tile, 1, self._tile
        groups, panels = self._product_tiles(group_count, panel_count)
        kernel = self._product_kernel("product", self._tile)
        size = (ceil_div(group_count, groups), ceil_div(panel_count, panels))
        sizes = (m, n, depth, groups, panels, scale, int(accumulate))
        self.device.launch(kernel, size, *sizes, a, a_group, a_row, a_step, b, b_step, b_panel, *skipped, result)

    def _product_tiles(self, group_count: int, panel_count: int) -> tuple[int, int]:
        """Row groups and panels of one work-item.

        Rows are cut first, and columns only where that leaves a unit without a few items: what shares its rows reads
        them from memory once.
        """
        most = self.constants.product_tiles
        wanted = 4 * self.device.facts.units
        groups = min(most, max(1, group_count // wanted))
        rows = ceil_div(group_count, groups)
        panels = min(most, panel_count, max(1, panel_count * rows // wanted))
        # Items of equal width: a narrow last one would leave its unit idle.
        return groups, ceil_div(panel_count, ceil_div(panel_count, panels))

    def _product_kernel(self, function: str, tile: int) -> Any:
        return self.device.kernel("product", function, RT=tile, KB=DEPTH_BLOCK, DP=DEPTH_PACKED)

    def _pack_panels(self, slot: str, b: Array, n: int, depth: int, row_stride: int, column_stride: int) -> Array:
        """Queue packing of b (depth, n), given by its strides, into (panels, depth, W) scratch."""
        panels = ceil_div(n, self.width)
        packed = self.device.scratch(f"panels.{slot}", panels * depth * self.width)
        kernel = self._product_kernel("pack_panels", self._tile)
        size = (panels, ceil_div(depth, DEPTH_PACKED))
        self.device.launch(kernel, size, n, depth, b, row_stride, column_stride, packed)
        return packed

    def _pack_tiles(self, slot: str, b: Array, n: int, depth: int, tile: int, weight: Array | None = None) -> Array:
        """Queue packing of diag(weight) b (depth, n) into (tiles, depth, tile) scratch."""
        tiles = ceil_div(n, tile)
        packed = self.device.scratch(f"tiles.{slot}", tiles * depth * tile)
        kernel = self._product_kernel("pack_tiles", tile)
        size = (tiles, ceil_div(depth, DEPTH_PACKED))
        self.device.launch(kernel, size, n, depth, b, weight, packed)
        return packed
