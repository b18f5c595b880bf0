"""Arrays on GPUs: elementwise kernels and sums. Neighbouring work-items own neighbouring elements."""

from __future__ import annotations

from typing import Any

from clalign.engine.band import Band
from clalign.engine.device import Device
from clalign.engine.device_class import GpuClass, Tile
from clalign.engine.launching import Array, Launcher, ceil_div

TRANSPOSE_BLOCK = 32
"""Rows and columns of a block of a transpose: what it reads and writes are whole lines of memory."""

ROW_ITEMS = 32
"""Neighbouring work-items that share a row."""

PART = 4096
"""Elements of one part of a sum."""


SUMMED_AT_ONCE = 1 << 17
"""Elements up to which one work-group makes the whole sum: a second launch would take longer."""


class GpuArrays(Launcher):
    """Elementwise kernels and sums."""

    def __init__(self, device: Device, constants: GpuClass) -> None:
        super().__init__(device)
        self.constants = constants

    def add(self, a: Array, b: Array, scale_a: float, scale_b: float, result: Array) -> None:
        """Queue result = scale_a a + scale_b b."""
        self.device.launch(self._elementwise("add"), a.size, a.size, scale_a, scale_b, a, b, result)

    def quotient(
        self, numerator: Array, denominator: Array, slope: Array, denominator_slope: Array, gradient: Array
    ) -> Array:
        """Queue a quotient and its gradient; nothing waits for the device."""
        value = self.device.allocate((), self.device.dtype)
        sides = (numerator, denominator, slope, denominator_slope)
        self.device.launch(self._elementwise("quotient"), slope.size, slope.size, *sides, value, gradient)
        return value

    def scale_rows(self, a: Array, w: Array, result: Array) -> None:
        """Queue result = diag(w) a."""
        self.device.launch(self._elementwise("scale_rows"), a.size, *a.shape, a, w, result)

    def reciprocal(self, a: Array, inverse: Array) -> None:
        """Queue 1 / a, and 0 where a is 0."""
        self.device.launch(self._elementwise("reciprocal"), a.size, a.size, a, inverse)

    def gather(self, a: Array, index: Array, result: Array) -> None:
        """Queue result[i] = a[index[i]]."""
        self.device.launch(self._elementwise("gather_rows"), result.size, index.size, a.shape[1], a, index, result)

    def half_squares(self, a: Array, result: Array) -> None:
        """Queue ½ |a_i|² of every row."""
        self._row_dots(a, a, result, 0.5)

    def transpose(self, a: Array, result: Array) -> None:
        """Queue result = aᵀ."""
        rows, columns = a.shape
        blocks = (ceil_div(columns, TRANSPOSE_BLOCK), ceil_div(rows, TRANSPOSE_BLOCK))
        self._launch_groups(self._elementwise("transpose"), blocks, rows, columns, a, result)

    def band_expand(self, values: Array, band: Band, result: Array) -> None:
        """Queue the square matrix of packed values."""
        self._along_band("band_expand", band, values, result)

    def band_gather(self, matrix: Array, band: Band, result: Array) -> None:
        """Queue the packed values of a square matrix."""
        self._along_band("band_gather", band, matrix, result)

    def dot(self, a: Array, b: Array | None, result: Array, scale: float = 1.0, accumulate: bool = False) -> None:
        """Queue result[0] (+)= scale · Σ a b, or Σ a."""
        if a.size <= SUMMED_AT_ONCE:
            self._launch_groups(self._reduce("whole_dot"), (1,), a.size, scale, int(accumulate), a, b, result)
            return
        parts = ceil_div(a.size, PART)
        partial = self.device.scratch("partial", parts)
        self._launch_groups(self._reduce("partial_dots"), (parts,), a.size, a, b, partial)
        self._launch_groups(self._reduce("finish_sum"), (1,), parts, scale, int(accumulate), partial, result)

    def band_sums(
        self,
        band: Band,
        factor: float,
        r: Array,
        other: Array,
        slope: Array,
        trace_of: Array | None,
        values: tuple[Array, Array],
    ) -> None:
        """Queue what ends the alignment term: slope += factor · other, and numerator and denominator."""
        d = band.size
        partial = self.device.scratch("band_sums", 2 * d)
        tables = self._band_tables(band)
        self._launch_groups(self._reduce("band_rows"), (d,), d, factor, *tables, r, other, slope, partial)
        self._launch_groups(self._reduce("alignment_values"), (1,), d, partial, trace_of, *values)

    def _along_band(self, function: str, band: Band, values: Array, result: Array) -> None:
        kernel = self._elementwise(function)
        self.device.launch(kernel, band.size**2, band.size, *self._band_tables(band), values, result)

    def _elementwise(self, function: str) -> Any:
        return self.device.kernel("gpu_elementwise", function, TB=TRANSPOSE_BLOCK)

    def _reduce(self, function: str) -> Any:
        return self.device.kernel("gpu_reduce", function, RB=PART)

    def _row_dots(self, a: Array, b: Array, dots: Array, scale: float = 1.0) -> None:
        """Queue dots[i] = scale · a[i]·b[i]."""
        rows, width = a.shape
        self.device.launch(self._elementwise("row_dots"), rows * ROW_ITEMS, rows, width, scale, a, b, dots)

    def _launch_groups(self, kernel: Any, groups: tuple[int, ...], *arguments: Any) -> None:
        """Queue a kernel over so many work-groups."""
        self.device.launch(kernel, (groups[0] * self.constants.work_group, *groups[1:]), *arguments)

    def _tiled(self, program: str, function: str, tile: Tile, unroll: int | None = None) -> Any:
        """Return a kernel whose work-groups own tiles."""
        steps = self.constants.unroll if unroll is None else unroll
        return self.device.kernel(program, function, **tile.definitions, UNROLL=steps)

    def _splits(self, tiles: int, length: int, least: int) -> int:
        """Into how many parts, of `least` or more, a sum is cut so that its tiles keep the device busy."""
        wanted = self.constants.groups_per_unit * self.device.facts.units
        return max(1, min(ceil_div(wanted, tiles), length // least))
