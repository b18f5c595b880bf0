"""A mesh as arrays and plain values, to be kept within a result."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.mesh.defects import LoosePieces
from clalign.mesh.mesh import Mesh

_ARRAYS = ("vertices", "faces", "offset", "file_index", "vertex_of_file")
_LOOSE = ("file_index", "vertices", "piece", "faces")


def mesh_facts(mesh: Mesh) -> dict[str, Any]:
    """Return everything but the arrays as plain values."""
    return {
        "name": mesh.name,
        # Wherever the result is read from, it must know its own meshes.
        "path": mesh.path and str(Path(mesh.path).absolute()),
        "vertices": mesh.n_vertices,
        "faces": mesh.n_faces,
        "file_vertices": mesh.file_count,
        "carried_vertices": len(mesh.loose.file_index),
        "scale": float(mesh.scale),
        "notes": list(mesh.notes),
    }


def mesh_arrays(mesh: Mesh) -> dict[str, NDArray[Any]]:
    """Return the arrays by their names; see `stored_mesh`."""
    arrays = {name: getattr(mesh, name) for name in _ARRAYS}
    return arrays | {f"loose.{name}": getattr(mesh.loose, name) for name in _LOOSE}


def stored_mesh(facts: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Mesh:
    """Return the mesh of `mesh_facts` and `mesh_arrays`; KeyError for what is missing.

    Results of earlier versions have no vertices that were joined, parted or carried, or no faces of the carried ones.
    """
    file_index = arrays["file_index"]
    vertex_of_file = np.full(int(facts["file_vertices"]), -1, dtype=np.int64)
    vertex_of_file[file_index] = np.arange(len(file_index))
    loose = LoosePieces.none()
    if "loose.file_index" in arrays:
        none = np.zeros((0, 3), dtype=np.int64)
        loose = LoosePieces(*(arrays.get(f"loose.{name}", none) for name in _LOOSE))
    return Mesh(
        vertices=arrays["vertices"],
        faces=arrays["faces"],
        offset=arrays["offset"],
        file_index=file_index,
        vertex_of_file=arrays.get("vertex_of_file", vertex_of_file),
        scale=float(facts["scale"]),
        name=str(facts["name"]),
        path=facts["path"],
        notes=tuple(facts["notes"]),
        loose=loose,
    )
