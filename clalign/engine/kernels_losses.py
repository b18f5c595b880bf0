"""The two terms of the objective on the device, put together from products and sums."""

from __future__ import annotations

from clalign.engine.band import Band
from clalign.engine.kernels_arrays import operation, require_shapes
from clalign.engine.kernels_products import KernelProducts
from clalign.engine.launching import Array, ArrayPair


class KernelLosses(KernelProducts):
    """The two terms of the objective and their gradients."""

    @operation
    def distortion(
        self, z: Array, core_y: Array, left_x: Array, core_x: Array, w: Array, *, out: ArrayPair | None = None
    ) -> ArrayPair:
        (n, r_y), r_x = z.shape, left_x.shape[1]
        require_shapes("distortion", left_x=(left_x.shape[:1], (n,)), w=(w.shape, (n,)))
        require_shapes("distortion", core_y=(core_y.shape, (r_y, r_y)), core_x=(core_x.shape, (r_x, r_x)))
        value = self._result("distortion", (), out and out[0])
        slope = self._result("distortion", (n, r_y), out and out[1])

        inside = self._work("inside", r_x, r_y)
        outside = self._work("outside", n, r_y)
        gram = self._work("gram", r_y, r_y)
        self.weighted_gram(left_x, z, w, out=inside)
        self.device.copy(z, outside)
        self.product(left_x, inside, scale=-1.0, accumulate=True, out=outside)
        self.weighted_gram(outside, outside, w, out=gram)

        last, across = self._work("last", r_x, r_y), self._work("across", r_y, r_y)
        if not self._launcher.distortion_core(core_x, core_y, inside, gram, value, last, across):
            self._core_products(core_x, core_y, inside, gram, value, last, across)
        self.product(left_x, last, scale=-4.0, out=slope)
        self.product(outside, across, scale=4.0, accumulate=True, out=slope)
        self.scale_rows(slope, w, out=slope)
        return value, slope

    def _core_products(
        self, core_x: Array, core_y: Array, inside: Array, gram: Array, value: Array, last: Array, across: Array
    ) -> None:
        """Queue what Eq. 22 makes of small matrices (r_x, r_y), product by product; gram is used up."""
        r_x, r_y = inside.shape
        mapped = self.product(inside, core_y, out=self._work("mapped", r_x, r_y))
        residual = self._work("residual", r_x, r_x)
        self.device.copy(core_x, residual)
        self.product(mapped, inside, transpose_b=True, scale=-1.0, accumulate=True, out=residual)
        core_gram = self.product(core_y, gram, out=self._work("core_gram", r_y, r_y))
        gram_core = self.product(gram, core_y, out=self._work("gram_core", r_y, r_y))
        mixed = self.product(mapped, gram_core, out=self._work("mixed", r_x, r_y))
        self._launcher.dot(residual, residual, value)
        self._launcher.dot(mixed, inside, value, scale=2.0, accumulate=True)
        # gram_core is the transpose of core_gram, since both factors are symmetric.
        self._launcher.dot(core_gram, gram_core, value, accumulate=True)

        self.product(inside, inside, transpose_a=True, accumulate=True, out=gram)
        core_full = self.product(core_y, gram, out=core_gram)
        along = self.product(core_x, inside, out=mapped)
        self.product(inside, core_full, scale=-1.0, accumulate=True, out=along)
        self.product(along, core_y, out=last)
        self.product(core_full, core_y, out=across)

    @operation
    def alignment(
        self,
        r: Array,
        r_transposed: Array,
        g_x: Array,
        g_y: Array,
        g_xy: Array,
        band: Band,
        one_sided: bool = False,
        *,
        out: tuple[Array, Array, Array, Array] | None = None,
    ) -> tuple[Array, Array, Array, Array]:
        square, d = r.shape, band.size
        require_shapes("alignment", r=(square, (d, d)), r_transposed=(r_transposed.shape, square))
        require_shapes("alignment", g_x=(g_x.shape, square), g_y=(g_y.shape, square), g_xy=(g_xy.shape, square))
        numerator = self._result("alignment", (), out and out[0])
        denominator = self._result("alignment", (), out and out[1])
        slope = self._result("alignment", square, out and out[2])
        denominator_slope = self._result("alignment", square, out and out[3])
        self.banded_product(g_x, r, right=band, kept=band, scale=2.0, out=slope)
        if one_sided:
            self.add(slope, slope, scale_a=0.0, scale_b=0.0, out=denominator_slope)
            other, factor, trace_of = g_xy, -2.0, g_y
        else:
            self.banded_product(r, g_y, left=band, kept=band, scale=2.0, out=denominator_slope)
            self.banded_product(
                g_xy, r_transposed, right=band.transposed, kept=band, scale=-2.0, accumulate=True, out=slope
            )
            self.banded_product(
                r_transposed, g_xy, left=band.transposed, kept=band, scale=-2.0, accumulate=True, out=slope
            )
            other, factor, trace_of = denominator_slope, 1.0, None
        self._launcher.band_sums(band, factor, r, other, slope, trace_of, (numerator, denominator))
        return numerator, denominator, slope, denominator_slope

    def _work(self, name: str, rows: int, columns: int) -> Array:
        """Scratch matrix of its own name."""
        kept = self.device.scratch(f"loss.{name}", rows * columns)
        return kept.leading((rows, columns))
