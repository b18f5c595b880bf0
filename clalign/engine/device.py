"""One OpenCL device at work: context, queue, programs, buffers within a budget, and scratch memory.

Nothing here happens at import. A `Device` belongs to one thread: kernels keep their arguments between launches.
"""

from __future__ import annotations

import logging
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.engine.device_choice import DeviceFacts, choose_device, list_devices, wanted_device
from clalign.engine.device_class import ClassName, DeviceClass, device_class
from clalign.engine.loading import cache_problem, load, require_own_process
from clalign.engine.programs import kernel_source
from clalign.errors import DeviceError, MemoryBudgetError

logger = logging.getLogger(__name__)

SLACK = 4096
"""Bytes allocated behind every buffer: kernels read whole vectors, and may so read past the last row."""

SLOW_BUILD = 0.2
"""Seconds above which building a program is logged."""


class Allocation:
    """A buffer that gives its bytes back to the device's budget when the last array on it is gone."""

    __slots__ = ("buffer", "device", "size")

    def __init__(self, device: Device, buffer: Any, size: int) -> None:
        self.device = device
        self.buffer = buffer
        self.size = size
        device.allocated += size
        device.most = max(device.most, device.allocated)

    def __del__(self) -> None:
        self.device.allocated -= self.size


class DeviceArray:
    """Row-major values on a device; `reshape` shares the memory. Made by a backend, not by hand."""

    __slots__ = ("dtype", "memory", "shape")

    def __init__(self, memory: Allocation, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        self.memory = memory
        self.shape = shape
        self.dtype = dtype

    @property
    def device(self) -> Device:
        """The device that holds the values."""
        return self.memory.device

    @property
    def buffer(self) -> Any:
        """The pyopencl buffer."""
        return self.memory.buffer

    @property
    def size(self) -> int:
        """Number of elements."""
        return prod(self.shape)

    def reshape(self, *shape: int | Sequence[int]) -> DeviceArray:
        """Return the same memory with another shape; one length may be -1."""
        wanted = tuple(shape[0]) if len(shape) == 1 and isinstance(shape[0], Sequence) else shape
        lengths = [int(length) for length in wanted]  # type: ignore[arg-type]
        if lengths.count(-1) == 1:
            known = -prod(lengths)
            lengths[lengths.index(-1)] = self.size // known if known else 0
        if prod(lengths) != self.size:
            raise ValueError(f"cannot reshape {self.shape} to {tuple(lengths)}")
        return DeviceArray(self.memory, tuple(lengths), self.dtype)

    def leading(self, shape: tuple[int, ...]) -> DeviceArray:
        """Return the first elements of the same memory with another shape."""
        if prod(shape) > self.size:
            raise ValueError(f"{self.size} elements cannot be seen as {shape}")
        return DeviceArray(self.memory, shape, self.dtype)

    def get(self) -> NDArray[Any]:
        """Download; waits for whatever computes the values."""
        return self.device.download([self])[0]

    def __float__(self) -> float:
        if self.size != 1:
            raise TypeError(f"only an array of one element is a number, this one has shape {self.shape}")
        return float(self.get().reshape(-1)[0])

    def __repr__(self) -> str:
        return f"DeviceArray(shape={self.shape}, dtype={self.dtype.name}, device={self.device.facts.name!r})"


class Device:
    """An open device; `launches` counts the kernels that were queued.

    Parameters
    ----------
    specification : which device, see `device_choice`; empty looks at ``CLALIGN_DEVICE`` and then picks one.
    precision : "single" or "double".
    memory : bytes that may be allocated at most; 0 leaves it to the device.
    kind : class of the kernels, or its constants.

    Raises
    ------
    DeviceError
        No such device, or it has no double precision where that is asked for.
    """

    def __init__(
        self,
        specification: str = "",
        precision: str = "single",
        memory: int = 0,
        kind: ClassName | DeviceClass = "auto",
    ) -> None:
        self.facts = choose_device(wanted_device(specification), list_devices())
        require_precision(self.facts, precision)
        self._cl = cl = load()
        handle = cl.get_platforms()[self.facts.platform].get_devices()[self.facts.device]
        self.dtype = np.dtype(np.float64 if precision == "double" else np.float32)
        self.constants = device_class(self.facts, self.dtype.itemsize, kind) if isinstance(kind, str) else kind
        self.budget = min(self.facts.memory, memory) if memory else self.facts.memory
        self.allocated = self.most = 0
        with self._answering("being opened"):
            self._context = cl.Context([handle])
            self._queue = cl.CommandQueue(self._context)
        self._kernels: dict[tuple[str, tuple[tuple[str, str | int], ...]], dict[str, Any]] = {}
        self._scratch: dict[str, DeviceArray] = {}
        self._tables: dict[tuple[Any, ...], DeviceArray] = {}
        self.launches = 0

    @contextmanager
    def _answering(self, doing: str) -> Iterator[None]:
        """Put a refusal of the driver into words: what was being done, and on which device."""
        require_own_process()
        try:
            yield
        except self._cl.Error as error:
            raise self._refusal(doing, error) from error

    def _refusal(self, doing: str, error: Exception) -> DeviceError:
        kind = MemoryBudgetError if isinstance(error, self._cl.MemoryError) else DeviceError
        return kind(f"{self.facts.label} failed while {doing} ({error})")

    def allocate(self, shape: Sequence[int], dtype: Any) -> DeviceArray:
        """Reserve an array whose values are not set.

        Raises
        ------
        MemoryBudgetError
            More than the device's largest buffer, or than what is left of the budget.
        """
        lengths = tuple(int(length) for length in shape)
        kind = np.dtype(dtype)
        needed = prod(lengths) * kind.itemsize + SLACK
        check_budget(needed, lengths, self.budget - self.allocated, self.facts)
        with self._answering(f"allocating {needed} bytes"):
            buffer = self._cl.Buffer(self._context, self._cl.mem_flags.READ_WRITE, needed)
        return DeviceArray(Allocation(self, buffer, needed), lengths, kind)

    def scratch(self, name: str, size: int, dtype: Any = None) -> DeviceArray:
        """Return memory for intermediate values, kept under its name and grown when needed.

        The queue is in order, so one launch may reuse what an earlier one has finished with.
        """
        kind = self.dtype if dtype is None else np.dtype(dtype)
        kept = self._scratch.get(name)
        if kept is None or kept.size < size or kept.dtype != kind:
            self._scratch.pop(name, None)
            kept = self.allocate((size,), kind)
            self._scratch[name] = kept
        return kept

    def table(self, key: tuple[Any, ...], make: Callable[[], NDArray[Any]]) -> DeviceArray:
        """Return the values that `make` gives for `key`, made and uploaded once: reals, or int32."""
        if key not in self._tables:
            values = make()
            self._tables[key] = self.upload(values.astype(np.int32 if values.dtype.kind in "iub" else self.dtype))
        return self._tables[key]

    def upload(self, values: NDArray[Any]) -> DeviceArray:
        """Copy values to the device."""
        array = self.allocate(values.shape, values.dtype)
        if values.size:
            with self._answering(f"uploading {values.nbytes} bytes"):
                self._cl.enqueue_copy(self._queue, array.buffer, np.ascontiguousarray(values))
        return array

    def zeros(self, shape: Sequence[int], dtype: Any) -> DeviceArray:
        """Allocate zeros."""
        array = self.allocate(shape, dtype)
        count = array.size * array.dtype.itemsize
        if count:
            with self._answering(f"filling {count} bytes"):
                self._cl.enqueue_fill_buffer(self._queue, array.buffer, np.zeros(1, array.dtype), 0, count)
        return array

    def copy(self, source: DeviceArray, target: DeviceArray) -> None:
        """Copy on the device."""
        count = source.size * source.dtype.itemsize
        with self._answering(f"copying {count} bytes"):
            self._cl.enqueue_copy(self._queue, target.buffer, source.buffer, byte_count=count)

    def download(self, arrays: Sequence[DeviceArray]) -> list[NDArray[Any]]:
        """Copy values to the host; waits once, for whatever computes them."""
        found = [np.zeros(array.shape, dtype=array.dtype) for array in arrays]
        with self._answering("computing"):
            for array, values in zip(arrays, found, strict=True):
                if values.size:
                    self._cl.enqueue_copy(self._queue, values, array.buffer, is_blocking=False)
            self._queue.finish()
        return found

    def finish(self) -> None:
        """Wait until everything launched is done."""
        with self._answering("computing"):
            self._queue.finish()

    def kernel(self, program: str, function: str, **defines: str | int) -> Any:
        """Return a kernel, building its program on first use.

        Raises
        ------
        DeviceError
            Unknown program or function, or the compiler refuses the source.
        """
        key = (program, tuple(defines.items()))
        functions = self._kernels.get(key)
        if functions is None:
            functions = self._kernels[key] = self._build(program, defines)
        if function not in functions:
            raise DeviceError(f"no kernel {function!r} in {program}.cl; there are {', '.join(functions)}")
        return functions[function]

    def _build(self, program: str, defines: Mapping[str, str | int]) -> dict[str, Any]:
        common = {"PRECISION": 8 * self.dtype.itemsize, **self.constants.definitions(self.dtype.itemsize)}
        source = kernel_source(program, {**common, **defines}, self.constants.options)
        require_own_process()
        start = time.perf_counter()
        try:
            with warnings.catch_warnings():
                # Drivers chat on every build; a build that fails raises, so nothing is lost.
                warnings.simplefilter("ignore", self._cl.CompilerWarning)
                built = self._cl.Program(self._context, source.text).build(list(source.options))
        except self._cl.Error as error:
            where = f"{self.facts.label}{cache_problem(self.facts.platform_name)}"
            raise DeviceError(f"the kernels of {program}.cl do not build on {where}: {error}") from error
        elapsed = time.perf_counter() - start
        if elapsed > SLOW_BUILD:
            logger.info("built %s.cl in %.1f s", program, elapsed)
        types = {"buffer": None, "int": np.int32, "long": np.int64, "real": self.dtype.type}
        functions = {}
        for function, arguments in source.signatures.items():
            kernel = self._cl.Kernel(built, function)
            kernel.set_scalar_arg_dtypes([types[argument] for argument in arguments])
            functions[function] = kernel
        return functions

    def launch(self, kernel: Any, size: int | tuple[int, ...], *arguments: Any, work_group: int | None = None) -> None:
        """Queue a kernel over `size` work-items; arrays, numbers and None (a null pointer) are its arguments."""
        lengths = (size,) if isinstance(size, int) else size
        items = self.constants.work_group if work_group is None else work_group
        padded = (-(-lengths[0] // items) * items, *lengths[1:])
        require_own_process()
        self.launches += 1
        values = [value.buffer if isinstance(value, DeviceArray) else value for value in arguments]
        local = (items,) + (1,) * (len(lengths) - 1)
        # Thousands of launches a second: a context manager would be felt here.
        try:
            kernel(self._queue, padded, local, *values)
        except self._cl.Error as error:
            raise self._refusal(f"starting the kernel {kernel.function_name}", error) from error

    def describe(self) -> dict[str, str | int | bool]:
        """Return facts for reports: device, driver, limits, precision and memory in use (bytes)."""
        facts = self.facts
        named = ("version", "driver", "kind", "units", "memory", "largest_buffer", "local_memory", "double")
        return {
            "device": facts.name,
            "platform": facts.platform_name,
            **{name: getattr(facts, name) for name in named},
            "class": self.constants.name,
            "precision": self.dtype.name,
            "budget": self.budget,
            "allocated": self.allocated,
            "pyopencl": self._cl.VERSION_TEXT,
        }


def require_precision(facts: DeviceFacts, precision: str) -> None:
    """Refuse, by DeviceError, double precision on a device without it."""
    if precision == "double" and not facts.double:
        raise DeviceError(
            f"{facts.label} has no double precision; use single precision (engine.precision), or another device: "
            "clalign doctor lists them"
        )


def check_budget(needed: int, shape: tuple[int, ...], left: int, facts: DeviceFacts) -> None:
    """Refuse, by MemoryBudgetError, an array of `needed` bytes where only so many are `left` of the budget."""
    if needed > min(left, facts.largest_buffer):
        raise MemoryBudgetError(
            f"an array of shape {shape} needs {needed} bytes on {facts.label}: {left} bytes are available, the largest "
            f"buffer is {facts.largest_buffer} bytes. Use fewer vertices, samples or functions, or a larger memory "
            "limit."
        )
