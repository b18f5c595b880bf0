"""From the numbers of a mesh file to those of the surface that was loaded from it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clalign.mesh.mesh import Mesh


def compact_of_file(mesh: Mesh) -> NDArray[np.int64]:
    """Return (file_count,) int64, the vertex of `mesh` for every vertex of its file, -1 for those off the surface."""
    compact = np.full(mesh.file_count, -1, dtype=np.int64)
    compact[mesh.file_index] = np.arange(mesh.n_vertices)
    return compact
