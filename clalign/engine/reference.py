"""The numpy backend: the executable specification that every kernel is tested against.

`Reference()` works in float64. `Reference(numpy.float32)` does every step in single precision: a kernel may err at most
twice as much.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clalign.engine.reference_arrays import ReferenceArrays
from clalign.engine.reference_losses import ReferenceLosses
from clalign.engine.reference_search import ReferenceSearches
from clalign.engine.reference_soft import ReferenceSoftMaps


class Reference(ReferenceArrays, ReferenceSoftMaps, ReferenceLosses, ReferenceSearches):
    """All functions of `clalign.engine.backend.Backend` in numpy.

    Parameters
    ----------
    dtype : numpy.float64 or numpy.float32, the precision of every step.
    """

    def __init__(self, dtype: Any = np.float64) -> None:
        self.dtype = np.dtype(dtype)

    @property
    def name(self) -> str:
        """Short description of where the arithmetic runs."""
        return f"numpy {np.__version__}, {self.dtype.name}"

    def describe(self) -> dict[str, str | int | bool]:
        """Return facts for reports: there is no device."""
        return {"device": self.name}
