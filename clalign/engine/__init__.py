"""The arithmetic: OpenCL kernels, and the numpy reference that specifies them."""

from __future__ import annotations

from clalign.engine.backend import Backend, open_backend
from clalign.engine.band import Band
from clalign.engine.reference import Reference

__all__ = ["HOST", "Backend", "Band", "Reference", "open_backend"]

HOST: Backend = Reference()
"""numpy in double precision: where functions of arrays compute that are not told where."""
