"""The arithmetic: one protocol, a numpy reference and OpenCL kernels behind it."""

from __future__ import annotations

from clalign.engine.backend import Array, Backend, Band
from clalign.engine.reference import Reference
from clalign.options import EngineOptions

__all__ = ["HOST", "Array", "Backend", "Band", "Reference", "open_backend"]

HOST: Backend = Reference()
"""numpy in double precision: where functions of arrays compute that are not told where."""


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
    from clalign.engine.kernels import open_kernels

    return open_kernels(chosen)
