"""The launcher of a device: the kernels of its class, as the operations of the backend queue them."""

from __future__ import annotations

from typing import TypeAlias

from clalign.engine.cpu_searches import CpuSearches
from clalign.engine.cpu_soft_maps import CpuSoftMaps
from clalign.engine.device import Device
from clalign.engine.device_class import CpuClass
from clalign.engine.gpu_searches import GpuSearches
from clalign.engine.gpu_soft_maps import GpuSoftMaps


class CpuLauncher(CpuSoftMaps, CpuSearches):
    """All kernels of the class of CPUs."""


class GpuLauncher(GpuSoftMaps, GpuSearches):
    """All kernels of the class of GPUs."""


AnyLauncher: TypeAlias = CpuLauncher | GpuLauncher
"""Both have the same methods: the type checker compares every call with either."""


def launcher(device: Device) -> AnyLauncher:
    """Return the launcher of the class of a device."""
    constants = device.constants
    return CpuLauncher(device, constants) if isinstance(constants, CpuClass) else GpuLauncher(device, constants)
