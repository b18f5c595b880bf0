"""Arrays and elementwise kernels of the OpenCL backend."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clalign.engine.device import Device, DeviceArray
from clalign.engine.launcher import launcher
from clalign.engine.launching import Array
from clalign.engine.reference import Reference
from clalign.errors import InputError

if TYPE_CHECKING:
    Specification = Reference
else:
    # Kernels are a `Reference` to the type checker, which so compares all signatures. At run time they inherit nothing:
    # an operation without a kernel must fail, and not run in numpy.
    Specification = object

Method = TypeVar("Method", bound=Callable[..., Any])


def operation(method: Method) -> Method:
    """Mark an operation: its twin in `Reference`, which must exist, documents it."""
    method.__doc__ = getattr(Reference, method.__name__).__doc__
    return method


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
        self._launcher = launcher(device)

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
    def read(self, values: Sequence[Array | float]) -> list[NDArray[Any]]:
        copies = iter(self.device.download([value for value in values if isinstance(value, DeviceArray)]))
        return [next(copies) if isinstance(value, DeviceArray) else np.array(value) for value in values]

    @operation
    def quotient(
        self, numerator: Array, denominator: Array, slope: Array, denominator_slope: Array
    ) -> tuple[Array | float, Array]:
        require_shapes("quotient", denominator_slope=(denominator_slope.shape, slope.shape))
        require_shapes("quotient", numerator=(numerator.shape, ()), denominator=(denominator.shape, ()))
        gradient = self._result("quotient", slope.shape, None)
        return self._launcher.quotient(numerator, denominator, slope, denominator_slope, gradient), gradient

    @operation
    def add(self, a: Array, b: Array, *, scale_a: float = 1.0, scale_b: float = 1.0, out: Array | None = None) -> Array:
        require_shapes("add", b=(b.shape, a.shape))
        result = self._result("add", a.shape, out)
        self._launcher.add(a, b, scale_a, scale_b, result)
        return result

    @operation
    def scale_rows(self, a: Array, w: Array, *, out: Array | None = None) -> Array:
        require_shapes("scale_rows", w=(w.shape, a.shape[:1]))
        result = self._result("scale_rows", a.shape, out)
        self._launcher.scale_rows(a, w, result)
        return result

    @operation
    def reciprocal(self, a: Array, *, out: Array | None = None) -> Array:
        result = self._result("reciprocal", a.shape, out)
        self._launcher.reciprocal(a, result)
        return result

    @operation
    def gather(self, a: Array, index: Array, *, out: Array | None = None) -> Array:
        require_index("gather", index)
        result = self._result("gather", (*index.shape, a.shape[1]), out)
        self._launcher.gather(a, index, result)
        return result

    @operation
    def half_squares(self, a: Array, *, out: Array | None = None) -> Array:
        result = self._result("half_squares", a.shape[:1], out)
        self._launcher.half_squares(a, result)
        return result

    @operation
    def total(self, a: Array, w: Array | None = None) -> float:
        if w is not None and w.size != a.size:
            raise InputError(f"total: the weights have shape {w.shape}, the values {a.shape}")
        result = self.device.scratch("total", 1)
        self._launcher.dot(a, w, result)
        return float(result.leading(()))

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
