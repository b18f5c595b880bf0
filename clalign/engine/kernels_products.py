"""Dense, banded and triangular linear algebra of the OpenCL backend."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.engine.band import Band
from clalign.engine.kernels_arrays import (
    TRANSPOSE_BLOCK,
    Array,
    ArrayPair,
    KernelArrays,
    ceil_div,
    operation,
    require_shapes,
)

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
"""Least depth of a split, whether of a product or of a Gram matrix."""

GRAM_BLOCK = 128
"""Depth of a block where Gram matrices pack what they read."""

GRAM_SPLITS = 8
"""Most splits of such a Gram matrix."""

CHOLESKY_ITEMS = 8
"""Work-items of the one group that factorises."""


NOTHING_SKIPPED = (None, None, None)


class KernelProducts(KernelArrays):
    """Dense and banded linear algebra."""

    @property
    def _tile(self) -> int:
        """Rows of the register tile of plain products."""
        return self.device.constants.tile_rows

    @operation
    def product(
        self,
        a: Array,
        b: Array,
        *,
        transpose_a: bool = False,
        transpose_b: bool = False,
        scale: float = 1.0,
        accumulate: bool = False,
        leading: bool = False,
        out: Array | None = None,
    ) -> Array:
        m, columns = a.shape[::-1] if transpose_a else a.shape
        depth, n = b.shape[::-1] if transpose_b else b.shape
        if not (leading and not transpose_a and depth <= columns):
            require_shapes("product", b=((depth,), (columns,)))
        result = self._result("product", (m, n), out)
        adding = accumulate and out is not None
        self._product(a, b, result, m, n, depth, transpose_a, transpose_b, columns, scale=scale, accumulate=adding)
        return result

    @operation
    def band_expand(self, values: Array, band: Band, *, out: Array | None = None) -> Array:
        require_shapes("band_expand", values=(values.shape, (band.count,)))
        result = self._result("band_expand", (band.size, band.size), out)
        return self._along_band("band_expand", band, values, result)

    @operation
    def band_gather(self, matrix: Array, band: Band, *, out: Array | None = None) -> Array:
        require_shapes("band_gather", matrix=(matrix.shape, (band.size, band.size)))
        return self._along_band("band_gather", band, matrix, self._result("band_gather", (band.count,), out))

    def _along_band(self, function: str, band: Band, values: Array, result: Array) -> Array:
        kernel = self._elementwise(function)
        self.device.launch(kernel, band.size, band.size, *self._band_tables(band), values, result)
        return result

    @operation
    def banded_product(
        self,
        a: Array,
        b: Array,
        *,
        left: Band | None = None,
        right: Band | None = None,
        kept: Band | None = None,
        scale: float = 1.0,
        accumulate: bool = False,
        out: Array | None = None,
    ) -> Array:
        # Tiles of zeros and tiles that nobody reads are skipped.
        (m, depth), n = a.shape, b.shape[1]
        require_shapes("banded_product", b=(b.shape[:1], (depth,)))
        for name, band, shape in (("a", left, a.shape), ("b", right, b.shape), ("out", kept, (m, n))):
            if band is not None:
                require_shapes("banded_product", **{name: (shape, (band.size, band.size))})
        result = self._result("banded_product", (m, n), out)
        skipped = (
            self._ranges(left, self._tile, row_ranges),
            self._ranges(right, self.device.panel_width, panel_ranges),
            self._ranges(kept, self.device.panel_width, panel_ranges),
        )
        adding = accumulate and out is not None
        self._product(a, b, result, m, n, depth, False, False, scale=scale, accumulate=adding, skipped=skipped)
        return result

    @operation
    def transpose(self, a: Array, *, out: Array | None = None) -> Array:
        rows, columns = a.shape
        result = self._result("transpose", (columns, rows), out)
        kernel = self._elementwise("transpose")
        self.device.launch(kernel, ceil_div(columns, TRANSPOSE_BLOCK), rows, columns, a, result)
        return result

    @operation
    def weighted_gram(self, a: Array, b: Array, w: Array | None = None, *, out: Array | None = None) -> Array:
        rows, m = a.shape
        n = b.shape[1]
        require_shapes("weighted_gram", b=(b.shape[:1], (rows,)))
        if w is not None:
            require_shapes("weighted_gram", w=(w.shape, (rows,)))
        result = self._result("weighted_gram", (m, n), out)
        constants = self.device.constants
        if m == n == 1 and w is None:
            self._dot(a, b, result)
            return result
        if constants.packs_gram:
            self._gram(a, b, w, result)
            return result
        # Cut along the rows where the result has too few tiles to keep the device busy.
        tiles = ceil_div(m, self._tile) * ceil_div(n, self.device.panel_width)
        wanted = 8 * self.device.facts.units * constants.work_group
        splits, _ = equal_parts(rows, min(ceil_div(wanted, tiles), ceil_div(rows, DEPTH_SPLIT)))
        if splits <= 1:
            self._product(a, b, result, m, n, rows, True, False, weight=w)
            return result
        partial = self.device.scratch("splits", splits * m * n)
        self._product(a, b, partial, m, n, rows, True, False, weight=w, splits=splits)
        kernel = self._product_kernel("sum_splits", self._tile)
        self.device.launch(kernel, m * n, m * n, splits, 1.0, 0, partial, result)
        return result

    @operation
    def solve_right(self, gram: Array, rhs: Array, ridge: float, *, out: Array | None = None) -> Array:
        m, k = rhs.shape
        require_shapes("solve_right", gram=(gram.shape, (k, k)))
        result = self._result("solve_right", rhs.shape, out)
        launch, kernel = self.device.launch, self.device.kernel
        factor = self.device.scratch("cholesky", k * k)
        factorise = kernel("cholesky", "factorise", CHOLESKY_ITEMS=CHOLESKY_ITEMS)
        launch(factorise, CHOLESKY_ITEMS, k, ridge, gram, factor, work_group=CHOLESKY_ITEMS)
        panels = self._pack_panels("rhs", rhs, m, k, 1, k)
        solve = kernel("cholesky", "solve_rows", CHOLESKY_ITEMS=CHOLESKY_ITEMS)
        launch(solve, ceil_div(m, self.device.panel_width), m, k, factor, panels, result)
        return result

    def _product(
        self,
        a: Array,
        b: Array,
        result: Array,
        m: int,
        n: int,
        depth: int,
        transpose_a: bool,
        transpose_b: bool,
        columns: int | None = None,
        *,
        scale: float = 1.0,
        accumulate: bool = False,
        weight: Array | None = None,
        skipped: tuple[Array | None, Array | None, Array | None] = NOTHING_SKIPPED,
        splits: int = 1,
    ) -> None:
        """Queue a product, packing a side where what it reads is not contiguous or is read often.

        A weight of the depth needs a transposed left side, which is multiplied by it while being packed. A left side
        that is not transposed may have more `columns` than the depth. `skipped` is what is left out of the left side,
        the right side and the result: tables as in ``product.cl``, int32 (groups, 2) or (panels, 2), or None.
        """
        width = self.device.panel_width
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
        a_row, a_step = (1, m) if transpose_a else (columns or depth, 1)
        a_group = self._tile * a_row
        if weight is not None or (transpose_a and depth > DEPTH_BLOCK):
            a = self._pack_tiles("left", a, m, depth, self._tile, weight)
            a_group, a_row, a_step = depth * self._tile, 1, self._tile
        groups, panels = self._product_tiles(group_count, panel_count, splits)
        kernel = self._product_kernel("product", self._tile)
        size = (ceil_div(group_count, groups), ceil_div(panel_count, panels), splits)
        split_depth = ceil_div(depth, splits)
        sizes = (m, n, depth, groups, panels, split_depth, scale, int(accumulate))
        self.device.launch(kernel, size, *sizes, a, a_group, a_row, a_step, b, b_step, b_panel, *skipped, result)

    def _gram(self, a: Array, b: Array, w: Array | None, result: Array) -> None:
        """Queue a Gram matrix whose work-items pack what they read: each sums a split of the depth for some rows.

        Computed is the transpose where that fills the register tiles better.
        """
        units, tile, width = self.device.facts.units, self._tile, self.device.panel_width

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

    def _product_tiles(self, group_count: int, panel_count: int, splits: int) -> tuple[int, int]:
        """Row groups and panels of one work-item.

        Rows are cut first, and columns only where that leaves a unit without a few items: what shares its rows reads
        them from memory once.
        """
        most = self.device.constants.product_tiles
        wanted = ceil_div(4 * self.device.facts.units, splits)
        groups = min(most, max(1, group_count // wanted))
        rows = ceil_div(group_count, groups)
        panels = min(most, panel_count, max(1, panel_count * rows // wanted))
        # Items of equal width: a narrow last one would leave its unit idle.
        return groups, ceil_div(panel_count, ceil_div(panel_count, panels))

    def _product_kernel(self, function: str, tile: int) -> Any:
        return self.device.kernel("product", function, RT=tile, KB=DEPTH_BLOCK, DP=DEPTH_PACKED)

    def _pack_panels(self, slot: str, b: Array, n: int, depth: int, row_stride: int, column_stride: int) -> Array:
        """Queue packing of b (depth, n), given by its strides, into (panels, depth, W) scratch."""
        panels = ceil_div(n, self.device.panel_width)
        packed = self.device.scratch(f"panels.{slot}", panels * depth * self.device.panel_width)
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

    def _band_tables(self, band: Band) -> ArrayPair:
        key = (band.lower.tobytes(), band.upper.tobytes())
        lower = self._table(("lower", *key), lambda: band.lower)
        return lower, self._table(("offsets", *key), lambda: band.offsets)

    def _ranges(self, band: Band | None, width: int, make: Callable[[Band, int], NDArray[np.int32]]) -> Array | None:
        """Table of what the rows or columns of a band reach, kept on the device."""
        if band is None:
            return None
        key = (make, band.lower.tobytes(), band.upper.tobytes(), width)
        return self._table(key, lambda: make(band, width))


def equal_parts(length: int, most: int) -> tuple[int, int]:
    """Cut a length into at most `most` parts, the last of them shorter: how many there are, and the size of the others.

    No part is empty: nobody would write its sum, which is added to the others.
    """
    size = ceil_div(length, max(most, 1))
    return ceil_div(length, size), size


def panel_ranges(band: Band, width: int) -> NDArray[np.int32]:
    """First and last + 1 row with anything inside the band, for every panel of `width` columns: (panels, 2)."""
    first, last = _runs(band.size, width)
    # A row reaches columns first..last if its run ends behind `first` and starts at or before `last`.
    return np.stack(
        [np.searchsorted(band.upper, first, "right"), np.searchsorted(band.lower, last, "right")], axis=1
    ).astype(np.int32)


def row_ranges(band: Band, height: int) -> NDArray[np.int32]:
    """First and last + 1 column with anything inside the band, for every group of `height` rows: (groups, 2)."""
    first, last = _runs(band.size, height)
    return np.stack([band.lower[first], band.upper[last]], axis=1)


def _runs(size: int, length: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and last of every run of `length` numbers below `size`."""
    first = np.arange(0, size, length)
    return first, np.minimum(first + length, size) - 1
