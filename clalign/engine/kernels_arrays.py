"""Arrays and elementwise kernels of the OpenCL backend."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clalign.engine.device import Device, DeviceArray
from clalign.errors import InputError

ELEMENTS = 4096
"""Elements of one work-item of an elementwise kernel."""

TRANSPOSED = 16
"""Rows and columns of a block of a transpose: what it reads and writes are whole cache lines."""

PART = 512
"""Elements of one part of a sum."""


def ceil_div(a: int, b: int) -> int:
    """Quotient rounded up."""
    return -(-a // b)


def require_shapes(function: str, **pairs: tuple[tuple[int, ...], tuple[int, ...]]) -> None:
    """Refuse arrays whose shapes do not fit, before a kernel reads beyond them.

    Parameters
    ----------
    function : name for the message.
    pairs : argument name to the shape that it has and the one that it needs.

    Raises
    ------
    InputError
        Naming the first argument that does not fit.
    """
    for name, (given, wanted) in pairs.items():
        if given != wanted:
            raise InputError(f"{function}: {name} has shape {given}, needed is {wanted}")


def require_index(function: str, index: Any) -> None:
    """Refuse an index that a kernel would read as something else than the int32 numbers that it is meant to be.

    Raises
    ------
    InputError
        `index` lies not on the device, or holds another type.
    """
    if not isinstance(index, DeviceArray):
        raise InputError(f"{function}: index is of type {type(index).__name__}, needed is an array of the device")
    if index.dtype != np.int32:
        raise InputError(f"{function}: index holds {index.dtype.name}, needed is int32")


class KernelArrays:
    """`backend.Arrays` on a device; see there for the formulas."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.dtype: np.dtype[Any] = device.dtype
        self._constants: dict[tuple[Any, ...], DeviceArray] = {}

    @property
    def name(self) -> str:
        """Short description of where the arithmetic runs."""
        facts = self.device.facts
        return f"{facts.name} ({facts.platform_name}), {self.dtype.name}"

    def array(self, values: ArrayLike) -> DeviceArray:
        """Upload: floats to the real type, integers to int32."""
        given = np.asarray(values)
        kind = np.dtype(np.int32) if given.dtype.kind in "iub" else self.dtype
        return self.device.upload(np.ascontiguousarray(given, dtype=kind).reshape(given.shape))

    def zeros(self, shape: int | Sequence[int], dtype: Any = None) -> DeviceArray:
        """Allocate zeros of the real type (default) or int32."""
        lengths = (shape,) if isinstance(shape, int) else tuple(shape)
        return self.device.zeros(lengths, self.dtype if dtype is None else dtype)

    def numpy(self, array: DeviceArray) -> NDArray[Any]:
        """Download."""
        return array.get()

    def add(
        self,
        a: DeviceArray,
        b: DeviceArray,
        *,
        scale_a: float = 1.0,
        scale_b: float = 1.0,
        out: DeviceArray | None = None,
    ) -> DeviceArray:
        """Return scale_a · a + scale_b · b."""
        require_shapes("add", b=(b.shape, a.shape))
        result = self._result("add", a.shape, out)
        kernel = self._elementwise("add")
        self.device.launch(kernel, ceil_div(a.size, ELEMENTS), a.size, scale_a, scale_b, a, b, result)
        return result

    def scale_rows(self, a: DeviceArray, w: DeviceArray, *, out: DeviceArray | None = None) -> DeviceArray:
        """diag(w) a."""
        require_shapes("scale_rows", w=(w.shape, a.shape[:1]))
        result = self._result("scale_rows", a.shape, out)
        rows, width = a.shape
        kernel = self._elementwise("scale_rows")
        self.device.launch(kernel, rows, rows, width, a, w, result)
        return result

    def reciprocal(self, a: DeviceArray, *, out: DeviceArray | None = None) -> DeviceArray:
        """1 / a, and 0 where a is 0."""
        result = self._result("reciprocal", a.shape, out)
        self._reciprocal(a, result)
        return result

    def gather(self, a: DeviceArray, index: DeviceArray, *, out: DeviceArray | None = None) -> DeviceArray:
        """Rows of a named by index."""
        require_index("gather", index)
        width = a.shape[1]
        result = self._result("gather", (*index.shape, width), out)
        kernel = self._elementwise("gather_rows")
        self.device.launch(kernel, index.size, index.size, width, a, index, result)
        return result

    def half_squares(self, a: DeviceArray, *, out: DeviceArray | None = None) -> DeviceArray:
        """½ |a_i|² of the rows."""
        result = self._result("half_squares", a.shape[:1], out)
        self._row_dots(a, a, result)
        return self.add(result, result, scale_a=0.5, scale_b=0.0, out=result)

    def total(self, a: DeviceArray, w: DeviceArray | None = None) -> float:
        """Σ a, or Σ w a."""
        result = self.device.scratch("total", 1)
        self._dot(a, w, result)
        return float(result.leading(()))

    def _dot(
        self,
        a: DeviceArray,
        b: DeviceArray | None,
        result: DeviceArray,
        scale: float = 1.0,
        accumulate: bool = False,
    ) -> None:
        """Queue result[0] (+)= scale · Σ a b."""
        if b is not None and b.size != a.size:
            raise InputError(f"total: the weights have shape {b.shape}, the values {a.shape}")
        parts = ceil_div(a.size, PART)
        partial = self.device.scratch("partial", parts)
        launch, kernel = self.device.launch, self.device.kernel
        launch(kernel("reduce", "partial_dots", RB=PART), parts, a.size, a, b, partial)
        launch(kernel("reduce", "finish_sum", RB=PART), 1, parts, scale, int(accumulate), partial, result)

    def _elementwise(self, function: str) -> Any:
        """Return a kernel of ``elementwise.cl``, which is built once for all of them."""
        return self.device.kernel("elementwise", function, EB=ELEMENTS, TB=TRANSPOSED)

    def _reciprocal(self, a: DeviceArray, inverse: DeviceArray) -> None:
        """Queue 1 / a, and 0 where a is 0, into as many leading elements of `inverse`."""
        kernel = self._elementwise("reciprocal")
        self.device.launch(kernel, ceil_div(a.size, ELEMENTS), a.size, a, inverse)

    def _row_dots(self, a: DeviceArray, b: DeviceArray, dots: DeviceArray, inverse: DeviceArray | None = None) -> None:
        """Queue dots[i] = a[i]·b[i] and its reciprocal (0 where it is 0)."""
        rows, width = a.shape
        kernel = self._elementwise("row_dots")
        self.device.launch(kernel, rows, rows, width, a, b, dots, inverse)

    def _result(self, function: str, shape: tuple[int, ...], out: DeviceArray | None, dtype: Any = None) -> DeviceArray:
        """Return `out` after a check of its shape and type, or a new array."""
        kind = self.dtype if dtype is None else np.dtype(dtype)
        if out is None:
            return self.device.allocate(shape, kind)
        if out.size == 1 and shape == ():
            return out
        require_shapes(function, out=(out.shape, shape))
        if out.dtype != kind:
            raise InputError(f"{function}: out holds {out.dtype.name}, needed is {kind.name}")
        return out

    def _constant(self, key: tuple[Any, ...], values: NDArray[Any]) -> DeviceArray:
        """Keep an uploaded table, for index tables that depend on a few numbers only."""
        if key not in self._constants:
            self._constants[key] = self.array(values)
        return self._constants[key]
