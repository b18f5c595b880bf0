"""Arrays on CPUs: elementwise kernels and sums. A work-item owns many elements or whole rows."""

from __future__ import annotations

from typing import Any

from clalign.engine.band import Band
from clalign.engine.device import Device
from clalign.engine.device_class import CpuClass
from clalign.engine.launching import Array, Launcher, ceil_div

ELEMENTS = 4096
"""Elements of one work-item of an elementwise kernel."""

TRANSPOSE_BLOCK = 16
"""Rows and columns of a block of a transpose: what it reads and writes are whole cache lines."""

PART = 512
"""Elements of one part of a sum."""


class CpuArrays(Launcher):
    """Elementwise kernels and sums."""

    def __init__(self, device: Device, constants: CpuClass) -> None:
        super().__init__(device)
        self.constants = constants
        self.width = 2 * constants.vector // device.dtype.itemsize

    def add(self, a: Array, b: Array, scale_a: float, scale_b: float, result: Array) -> None:
        """Queue result = scale_a a + scale_b b."""
        kernel = self._elementwise("add")
        self.device.launch(kernel, ceil_div(a.size, ELEMENTS), a.size, scale_a, scale_b, a, b, result)

    def quotient(
        self, numerator: Array, denominator: Array, slope: Array, denominator_slope: Array, gradient: Array
    ) -> float:
        """Queue the gradient of a quotient, whose value is waited for: a CPU loses nothing by it."""
        scale = 1.0 / float(denominator)
        value = float(numerator) * scale
        self.add(slope, denominator_slope, scale, -value * scale, gradient)
        return value

    def scale_rows(self, a: Array, w: Array, result: Array) -> None:
        """Queue result = diag(w) a."""
        rows, width = a.shape
        self.device.launch(self._elementwise("scale_rows"), rows, rows, width, a, w, result)

    def reciprocal(self, a: Array, inverse: Array) -> None:
        """Queue 1 / a, and 0 where a is 0, into as many leading elements of `inverse`."""
        self.device.launch(self._elementwise("reciprocal"), ceil_div(a.size, ELEMENTS), a.size, a, inverse)

    def gather(self, a: Array, index: Array, result: Array) -> None:
        """Queue result[i] = a[index[i]]."""
        kernel = self._elementwise("gather_rows")
        self.device.launch(kernel, index.size, index.size, a.shape[1], a, index, result)

    def half_squares(self, a: Array, result: Array) -> None:
        """Queue ½ |a_i|² of every row."""
        self._row_dots(a, a, result)
        self.add(result, result, 0.5, 0.0, result)

    def transpose(self, a: Array, result: Array) -> None:
        """Queue result = aᵀ."""
        rows, columns = a.shape
        self.device.launch(self._elementwise("transpose"), ceil_div(columns, TRANSPOSE_BLOCK), rows, columns, a, result)

    def band_expand(self, values: Array, band: Band, result: Array) -> None:
        """Queue the square matrix of packed values."""
        self._along_band("band_expand", band, values, result)

    def band_gather(self, matrix: Array, band: Band, result: Array) -> None:
        """Queue the packed values of a square matrix."""
        self._along_band("band_gather", band, matrix, result)

    def dot(self, a: Array, b: Array | None, result: Array, scale: float = 1.0, accumulate: bool = False) -> None:
        """Queue result[0] (+)= scale · Σ a b, or Σ a."""
        parts = ceil_div(a.size, PART)
        partial = self.device.scratch("partial", parts)
        launch, kernel = self.device.launch, self.device.kernel
        launch(kernel("reduce", "partial_dots", RB=PART), parts, a.size, a, b, partial)
        launch(kernel("reduce", "finish_sum", RB=PART), 1, parts, scale, int(accumulate), partial, result)

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
        rows, ends = (self.device.kernel("alignment", name) for name in ("band_rows", "alignment_values"))
        self.device.launch(rows, d, d, factor, *self._band_tables(band), r, other, slope, partial)
        self.device.launch(ends, 1, d, partial, trace_of, *values)

    def _along_band(self, function: str, band: Band, values: Array, result: Array) -> None:
        kernel = self._elementwise(function)
        self.device.launch(kernel, band.size, band.size, *self._band_tables(band), values, result)

    def _elementwise(self, function: str) -> Any:
        """Return a kernel of ``elementwise.cl``, which is built once for all of them."""
        return self.device.kernel("elementwise", function, EB=ELEMENTS, TB=TRANSPOSE_BLOCK)

    def _row_dots(self, a: Array, b: Array, dots: Array, inverse: Array | None = None) -> None:
        """Queue dots[i] = a[i]·b[i] and its reciprocal (0 where it is 0)."""
        rows, width = a.shape
        self.device.launch(self._elementwise("row_dots"), rows, rows, width, a, b, dots, inverse)
