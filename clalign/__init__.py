"""Dense correspondence between two non-rigid shapes by aligning scale-invariant Laplace–Beltrami eigenfunctions.

>>> import clalign
>>> result = clalign.match("source.ply", "target.ply")  # doctest: +SKIP
>>> result.target_of_source  # doctest: +SKIP

Importing the package is light: the names below are loaded on first use, and no OpenCL device is opened before a
match runs.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .collection.run import match_collection
    from .correspondence import Alternative, Correspondence
    from .data import bundled_pair
    from .errors import (
        ClalignError,
        ClalignWarning,
        ConfidenceWarning,
        ConvergenceError,
        DeviceError,
        InputError,
        MemoryBudgetError,
        MeshError,
        OptionError,
        ResultError,
    )
    from .evaluation.errors import evaluate
    from .maps.file_maps import VertexStatus
    from .matching.pair import match
    from .mesh.mesh import load_mesh
    from .options import Options
    from .registration.register import Registration, register

__version__ = "0.1.0"

_HOMES = {
    "Alternative": "correspondence",
    "ClalignError": "errors",
    "ClalignWarning": "errors",
    "ConfidenceWarning": "errors",
    "ConvergenceError": "errors",
    "Correspondence": "correspondence",
    "DeviceError": "errors",
    "InputError": "errors",
    "MemoryBudgetError": "errors",
    "MeshError": "errors",
    "OptionError": "errors",
    "Options": "options",
    "Registration": "registration.register",
    "ResultError": "errors",
    "VertexStatus": "maps.file_maps",
    "bundled_pair": "data",
    "evaluate": "evaluation.errors",
    "load_mesh": "mesh.mesh",
    "match": "matching.pair",
    "match_collection": "collection.run",
    "notebook_html": "presentation.notebook",
    "register": "registration.register",
}

__all__ = [
    "Alternative",
    "ClalignError",
    "ClalignWarning",
    "ConfidenceWarning",
    "ConvergenceError",
    "Correspondence",
    "DeviceError",
    "InputError",
    "MemoryBudgetError",
    "MeshError",
    "OptionError",
    "Options",
    "Registration",
    "ResultError",
    "VertexStatus",
    "__version__",
    "bundled_pair",
    "evaluate",
    "load_mesh",
    "match",
    "match_collection",
    "register",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f".{_HOMES[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
