"""The OpenCL backend: the operations of `clalign.engine.reference.Reference` as kernels on one device."""

from __future__ import annotations

from clalign.engine.device import Device
from clalign.engine.kernels_losses import KernelLosses
from clalign.engine.kernels_search import KernelSearches
from clalign.engine.kernels_soft import KernelSoftMaps
from clalign.options import EngineOptions


class Kernels(KernelLosses, KernelSoftMaps, KernelSearches):
    """All kernels of one device. Use it from one thread: kernels and scratch memory are kept between calls.

    What an operation computes, its numpy twin in `Reference` says. Nothing waits for the device but `numpy`, `total`,
    ``float``, and `array`, whose copy comes after all that is queued; with `out` given, and after a first call with the
    same shapes, nothing is allocated or built.
    """


def open_kernels(options: EngineOptions) -> Kernels:
    """Open the device that the options name.

    Raises
    ------
    DeviceError
        No usable device, or not the one asked for.
    """
    return Kernels(Device(options.device, options.precision, options.memory))
