"""Arrays and elementwise kernels of the OpenCL backend."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clalign.engine.device import Device, DeviceArray
from clalign.engine.reference import Reference
from clalign.errors import InputError

if TYPE_CHECKING:
    Specification = Reference
else:
    # Kernels are a `Reference` to the type checker, which so compares all signatures. At run time they inherit nothing:
    # an operation without a kernel must fail, and not run in numpy.
    Specification = object

Array: TypeAlias = DeviceArray
ArrayPair: TypeAlias = tuple[Array, Array]

Method = TypeVar("Method", bound=Callable[..., Any])

ELEMENTS = 4096
"""Elements of one work-item of an elementwise kernel."""

TRANSPOSE_BLOCK = 16
"""Rows and columns of a block of a transpose: what it reads and writes are whole cache lines."""

PART = 512
"""Elements of one part of a sum."""


def operation(method: Method) -> Method:
    """Mark an operation: its twin in `Reference`, which must exist, documents it."""
    method.__doc__ = getattr(Reference, method.__name__).__doc__
    return method


def ceil_div(a: int, b: int) -> int:
    """Quotient rounded up."""
    return -(-a // b)


def require_shapes(function: str, **pairs: tuple[tuple[int, ...], tuple[int, ...]]) -> None:
    """Refuse, by InputError, arrays whose shapes do not fit, before a kernel reads beyond them.

    pairs : argument name to the shape that it has and the one that it needs.
    """
    for name, (given, wanted) in pairs.items():
        if given != wanted:
            raise InputError(f"{function}: {name} has shape {given}, needed is {wanted}")


def require_index(function: str, index: Any) -> None:
    """Refuse, by InputError, an index that a kernel would read as something else than int32 numbers."""
    if not isinstance(index, DeviceArray):
        raise InputError(f"{function}: index is of type {type(index).__name__}, needed is an array of the device")
    if index.dtype != np.int32:
        raise InputError(f"{function}: index holds {index.dtype.name}, needed is int32")


class KernelArrays(Specification):
    """Making, moving and elementwise use of arrays; what all kernels share."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.dtype: np.dtype[Any] = device.dtype
        self._tables: dict[tuple[Any, ...], Array] = {}

    @property
    @operation
    def name(self) -> str:
        facts = self.device.facts
        return f"{facts.name} ({facts.platform_name}), {self.dtype.name}"

    @operation
    def describe(self) -> dict[str, str | int | bool]:
        return self.device.describe()

    @operation
    def array(self, values: ArrayLike) -> Array:
        given = np.asarray(values)
        kind = np.dtype(np.int32) if given.dtype.kind in "iub" else self.dtype
        return self.device.upload(np.ascontiguousarray(given, dtype=kind).reshape(given.shape))

    @operation
    def zeros(self, shape: int | Sequence[int], dtype: Any = None) -> Array:
        lengths = (shape,) if isinstance(shape, int) else tuple(shape)
        return self.device.zeros(lengths, self.dtype if dtype is None else dtype)

    @operation
    def numpy(self, array: Array) -> NDArray[Any]:
        return array.get()

    @operation
    def add(self, a: Array, b: Array, *, scale_a: float = 1.0, scale_b: float = 1.0, out: Array | None = None) -> Array:
        require_shapes("add", b=(b.shape, a.shape))
        result = self._result("add", a.shape, out)
        kernel = self._elementwise("add")
        self.device.launch(kernel, ceil_div(a.size, ELEMENTS), a.size, scale_a, scale_b, a, b, result)
        return result

    @operation
    def scale_rows(self, a: Array, w: Array, *, out: Array | None = None) -> Array:
        require_shapes("scale_rows", w=(w.shape, a.shape[:1]))
        result = self._result("scale_rows", a.shape, out)
        rows, width = a.shape
        kernel = self._elementwise("scale_rows")
        self.device.launch(kernel, rows, rows, width, a, w, result)
        return result

    @operation
    def reciprocal(self, a: Array, *, out: Array | None = None) -> Array:
        result = self._result("reciprocal", a.shape, out)
        self._reciprocal(a, result)
        return result

    @operation
    def gather(self, a: Array, index: Array, *, out: Array | None = None) -> Array:
        require_index("gather", index)
        width = a.shape[1]
        result = self._result("gather", (*index.shape, width), out)
        kernel = self._elementwise("gather_rows")
        self.device.launch(kernel, index.size, index.size, width, a, index, result)
        return result

    @operation
    def half_squares(self, a: Array, *, out: Array | None = None) -> Array:
        result = self._result("half_squares", a.shape[:1], out)
        self._row_dots(a, a, result)
        return self.add(result, result, scale_a=0.5, scale_b=0.0, out=result)

    @operation
    def total(self, a: Array, w: Array | None = None) -> float:
        result = self.device.scratch("total", 1)
        self._dot(a, w, result)
        return float(result.leading(()))

    def _dot(self, a: Array, b: Array | None, result: Array, scale: float = 1.0, accumulate: bool = False) -> None:
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
        return self.device.kernel("elementwise", function, EB=ELEMENTS, TB=TRANSPOSE_BLOCK)

    def _reciprocal(self, a: Array, inverse: Array) -> None:
        """Queue 1 / a, and 0 where a is 0, into as many leading elements of `inverse`."""
        kernel = self._elementwise("reciprocal")
        self.device.launch(kernel, ceil_div(a.size, ELEMENTS), a.size, a, inverse)

    def _row_dots(self, a: Array, b: Array, dots: Array, inverse: Array | None = None) -> None:
        """Queue dots[i] = a[i]·b[i] and its reciprocal (0 where it is 0)."""
        rows, width = a.shape
        kernel = self._elementwise("row_dots")
        self.device.launch(kernel, rows, rows, width, a, b, dots, inverse)

    def _result(self, function: str, shape: tuple[int, ...], out: Array | None, dtype: Any = None) -> Array:
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

    def _table(self, key: tuple[Any, ...], make: Callable[[], NDArray[Any]]) -> Array:
        """Return a table that depends on the key only, made and uploaded once."""
        if key not in self._tables:
            self._tables[key] = self.array(make())
        return self._tables[key]
