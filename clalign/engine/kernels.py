"""The OpenCL backend: the functions of `clalign.engine.backend.Backend` as kernels on one device."""

from __future__ import annotations

from clalign.engine.device import Device
from clalign.engine.kernels_arrays import KernelArrays
from clalign.engine.kernels_losses import KernelLosses
from clalign.engine.kernels_products import KernelProducts
from clalign.engine.kernels_search import KernelSearches
from clalign.engine.kernels_soft import KernelSoftMaps
from clalign.options import EngineOptions


class Kernels(KernelLosses, KernelSoftMaps, KernelSearches, KernelProducts, KernelArrays):
    """All kernels of one device. Use it from one thread: kernels and scratch memory are kept between calls.

    Nothing waits for the device but `numpy`, `total`, ``float``, and `array`, whose copy comes after all that is
    queued; with `out` given, and after a first call with the same shapes, nothing is allocated or built.
    """

    def __init__(self, device: Device) -> None:
        super().__init__(device)

    def describe(self) -> dict[str, str | int | bool]:
        """Return facts about the device for reports."""
        return self.device.describe()


def open_kernels(options: EngineOptions) -> Kernels:
    """Open the device that the options name.

    Raises
    ------
    DeviceError
        No usable device, or not the one asked for.
    """
    return Kernels(Device(options.device, options.precision, options.memory))
