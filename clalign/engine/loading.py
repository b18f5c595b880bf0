"""OpenCL, loaded once a process: with caches that take files, and not again in a process that was forked later."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from clalign.errors import DeviceError
from clalign.storage.files import KERNEL_VARIABLE, ensure_driver_caches, takes_files

INSTALL_HINT = 'pip install "clalign[pocl]"'
LOADER_VARIABLES = ("OCL_ICD_VENDORS", "OCL_ICD_FILENAMES", "OPENCL_VENDOR_PATH")
"""Environment variables that say where the loader looks for drivers, in place of where they are installed."""
POCL = "Portable Computing Language"

_process: int | None = None
"""The process in which drivers were asked for devices, which starts their threads."""


def load() -> Any:
    """Return pyopencl.

    Raises
    ------
    DeviceError
        It cannot be imported, or drivers were in use when this process was forked.
    """
    require_own_process()
    ensure_driver_caches()
    try:
        import pyopencl
    except ImportError as error:
        raise DeviceError(f"OpenCL cannot be loaded ({error}). Install a driver: {INSTALL_HINT}") from error
    global _process
    _process = os.getpid()
    return pyopencl


def require_own_process() -> None:
    """Raise DeviceError in a process that was forked after its parent had used OpenCL: it would wait for ever."""
    # The threads of the driver are not copied by a fork.
    if _process is not None and _process != os.getpid():
        raise DeviceError(
            "OpenCL was opened before this process was forked, and cannot be used in it; start workers with spawn: "
            'multiprocessing.get_context("spawn")'
        )


def no_driver(error: object) -> DeviceError:
    """Return the sentence on a loader without drivers."""
    for name in LOADER_VARIABLES:
        if os.environ.get(name):
            return DeviceError(f"no OpenCL driver is found: {name} is set to {os.environ[name]}; unset it ({error})")
    return DeviceError(f"no OpenCL driver is installed ({error}). For a CPU driver: {INSTALL_HINT}")


def no_device(platforms: Sequence[str]) -> DeviceError:
    """Return the sentence on drivers, given by the names of their platforms, without any device."""
    if any(POCL in name for name in platforms):
        folder = os.environ.get(KERNEL_VARIABLE) or Path.home() / ".cache" / "pocl"
        return DeviceError(
            f"PoCL is loaded but has no device; mostly its folder of kernels, {folder}, takes no files: set "
            f"{KERNEL_VARIABLE} to a folder that does"
        )
    return DeviceError(f"OpenCL has a loader but no device. For a CPU driver: {INSTALL_HINT}")


def cache_problem(platform: str) -> str:
    """Return what is wrong with the folder that the user has named for PoCL's kernels, as the end of a sentence."""
    folder = os.environ.get(KERNEL_VARIABLE)
    if POCL not in platform or not folder or takes_files(Path(folder)):
        return ""
    return f" ({KERNEL_VARIABLE} is set to {folder}, which takes no files: set it to a folder that does)"
