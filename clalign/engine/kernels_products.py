"""Dense, banded and triangular linear algebra of the OpenCL backend."""

from __future__ import annotations

from clalign.engine.band import Band
from clalign.engine.kernels_arrays import KernelArrays, operation, require_shapes
from clalign.engine.launching import Array


class KernelProducts(KernelArrays):
    """Dense and banded linear algebra."""

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
        self._launcher.product(a, b, result, transpose_a, transpose_b, scale, adding)
        return result

    @operation
    def band_expand(self, values: Array, band: Band, *, out: Array | None = None) -> Array:
        require_shapes("band_expand", values=(values.shape, (band.count,)))
        result = self._result("band_expand", (band.size, band.size), out)
        self._launcher.band_expand(values, band, result)
        return result

    @operation
    def band_gather(self, matrix: Array, band: Band, *, out: Array | None = None) -> Array:
        require_shapes("band_gather", matrix=(matrix.shape, (band.size, band.size)))
        result = self._result("band_gather", (band.count,), out)
        self._launcher.band_gather(matrix, band, result)
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
        (m, depth), n = a.shape, b.shape[1]
        require_shapes("banded_product", b=(b.shape[:1], (depth,)))
        for name, band, shape in (("a", left, a.shape), ("b", right, b.shape), ("out", kept, (m, n))):
            if band is not None:
                require_shapes("banded_product", **{name: (shape, (band.size, band.size))})
        result = self._result("banded_product", (m, n), out)
        adding = accumulate and out is not None
        self._launcher.banded_product(a, b, result, (left, right, kept), scale, adding)
        return result

    @operation
    def transpose(self, a: Array, *, out: Array | None = None) -> Array:
        rows, columns = a.shape
        result = self._result("transpose", (columns, rows), out)
        self._launcher.transpose(a, result)
        return result

    @operation
    def weighted_gram(self, a: Array, b: Array, w: Array | None = None, *, out: Array | None = None) -> Array:
        rows, m = a.shape
        n = b.shape[1]
        require_shapes("weighted_gram", b=(b.shape[:1], (rows,)))
        if w is not None:
            require_shapes("weighted_gram", w=(w.shape, (rows,)))
        result = self._result("weighted_gram", (m, n), out)
        if m == n == 1 and w is None:
            self._launcher.dot(a, b, result)
        else:
            self._launcher.weighted_gram(a, b, w, result)
        return result

    @operation
    def solve_right(self, gram: Array, rhs: Array, ridge: float, *, out: Array | None = None) -> Array:
        k = rhs.shape[1]
        require_shapes("solve_right", gram=(gram.shape, (k, k)))
        result = self._result("solve_right", rhs.shape, out)
        self._launcher.solve_right(gram, rhs, ridge, result)
        return result
