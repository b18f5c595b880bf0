"""The OpenCL backend: the operations of `clalign.engine.reference.Reference` as kernels on one device."""

from __future__ import annotations

from clalign.engine.kernels_losses import KernelLosses
from clalign.engine.kernels_search import KernelSearches
from clalign.engine.kernels_soft import KernelSoftMaps


class Kernels(KernelLosses, KernelSoftMaps, KernelSearches):
    """All kernels of one device. Use it from one thread: kernels and scratch memory are kept between calls.

    What an operation computes, its numpy twin in `Reference` says. Nothing waits for the device but `numpy`, `total`,
    ``float``, and `array`, whose copy comes after all that is queued; with `out` given, and after a first call with the
    same shapes, nothing is allocated or built.
    """
