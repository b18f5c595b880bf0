"""Either backend under one name, and opening the one that the options name."""

from __future__ import annotations

from typing import TypeAlias

from clalign.engine.reference import Reference
from clalign.options import EngineOptions

Backend: TypeAlias = Reference
"""What callers annotate with: `Reference`, or `Kernels`, which follow its signatures without being one at run time.

Calls belong to one thread; results are bitwise the same from run to run on one device.
"""


def open_backend(options: EngineOptions | None = None) -> Backend:
    """Open the backend that the options name.

    Parameters
    ----------
    options : backend, device, precision and memory limit; None takes the defaults.

    Raises
    ------
    DeviceError
        No usable OpenCL device, or the one asked for is not there; the message lists what is.
    """
    chosen = EngineOptions() if options is None else options
    if chosen.backend == "reference":
        return Reference()
    from clalign.engine.device import Device
    from clalign.engine.kernels import Kernels

    return Kernels(Device(chosen.device, chosen.precision, chosen.memory, chosen.device_class))
