"""STL, text or binary, through trimesh: it has no vertex numbers, so corners at one position become one vertex."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from clalign.mesh.reading.common import FileMesh, FormatError, damage_in_a_sentence
from clalign.mesh.topology import merge_positions


def read_stl(content: bytes, folder: Path) -> FileMesh:
    """Read the facets, and number their corners by first appearance."""
    from trimesh.exchange.stl import load_stl

    n_facets = int.from_bytes(content[80:84], "little")
    if len(content) != 84 + 50 * n_facets:
        # Text may come in any encoding; only the name of the solid can contain more than ASCII.
        content = content.decode("ascii", errors="replace").encode("ascii", errors="replace")
        if not (content.lstrip().lower().startswith(b"solid") and b"facet" in content and b"endsolid" in content):
            raise FormatError(
                f"is neither a whole text STL (solid ... endsolid) nor a binary one ({n_facets} facets would need "
                f"{84 + 50 * n_facets} bytes, the file has {len(content)}); it is truncated or has a wrong "
                "suffix; export it again"
            )
    with damage_in_a_sentence():
        loaded = load_stl(io.BytesIO(content))
        parts = list(loaded["geometry"].values()) if "geometry" in loaded else [loaded]
        corners = np.concatenate([np.zeros((0, 3)), *(np.asarray(p["vertices"], dtype=np.float64) for p in parts)])
        before = np.cumsum([0] + [len(p["vertices"]) for p in parts])
        numbers = [np.asarray(p["faces"], dtype=np.int64) + start for p, start in zip(parts, before, strict=False)]
        faces = np.concatenate([np.zeros((0, 3), dtype=np.int64), *numbers])
    if not len(faces):
        raise FormatError("has no facets, or is no STL file; is the suffix right? Otherwise export it again")
    first, vertex_of_corner = merge_positions(corners)
    note = (
        f"an STL file has no vertex numbers: its {len(corners)} corners were merged by position into {len(first)} "
        "vertices, numbered by first appearance"
    )
    return FileMesh(corners[first], vertex_of_corner[faces], (note,))
