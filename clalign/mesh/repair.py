"""Make a usable surface out of a defective mesh, with the way back to its file's vertex numbers.

Loading reads most meshes as the surface that was meant (`clalign.mesh.checks`). A repaired copy goes further: faces
that name no vertex or lie at no place are dropped, one-sided surfaces are cut open, and one piece alone is kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clalign.errors import MeshError
from clalign.mesh import topology
from clalign.mesh.checks import MAX_COORDINATE, examined, mesh_arrays
from clalign.mesh.defects import Surface
from clalign.mesh.examination import Examination
from clalign.mesh.surface_checks import area_share
from clalign.mesh.topology import BoolArray
from clalign.mesh.welding import duplicate_places, joined


@dataclass(frozen=True)
class Repaired:
    """A mesh that loads without complaint."""

    vertices: NDArray[np.float64]
    """(n, 3) positions, unchanged."""
    faces: NDArray[np.int32]
    """(m, 3) consistently oriented; outward where there is an inside."""
    file_index: NDArray[np.int64]
    """(n,) the given number of every vertex: the lowest where some were joined, the same for several where the surface
    was cut open."""
    notes: tuple[str, ...]
    """What was changed, as sentences for the user; empty if nothing was."""
    area_share: float
    """Area that is left, as a part of that of all faces that have one."""
    merge_advice: str
    """What joining vertices at equal positions may mend, where that was not done and would join any; else empty."""


def repair(
    vertices: ArrayLike,
    faces: ArrayLike,
    *,
    merge: bool = False,
    component: int = 1,
    normals: NDArray[np.float64] | None = None,
) -> Repaired:
    """Drop, cut and flip whatever keeps a mesh, (n, 3) and (m, 3), from being one oriented surface.

    merge : first join vertices at exactly equal positions.
    component : number of the piece to keep, from 1 for the largest.
    normals : (n, 3) of points without faces, which say where the front of an open sheet is.

    Raises
    ------
    MeshError
        if no usable surface is left, with the reason.
    """
    notes: list[str] = []
    points, triangles = mesh_arrays(vertices, faces)
    surface = _readable(Surface.whole(points, triangles), notes)
    if merge:
        surface = _merged(surface, notes)
    if not len(surface.faces) and len(triangles):
        raise MeshError(f"the mesh cannot be repaired; after {'; '.join(notes)}: no face is left")
    known = normals if normals is None or merge else normals[surface.file_index]
    diagnosis = examined(Examination(surface, component=component, cut_open=True, alone=True, normals=known))
    left = surface if diagnosis.surface is None else diagnosis.surface
    advice = "" if merge or not duplicate_places(left.vertices) else "add --merge to join vertices at equal positions"
    if diagnosis.refused or diagnosis.surface is None:
        reasons = "; ".join(defect.problem for defect in diagnosis.refused)
        changes = "; ".join([*notes, *diagnosis.notes]) or "no changes"
        way_out = f"; {advice}" if advice else ""
        raise MeshError(f"the mesh cannot be repaired; after {changes}: {reasons}{way_out}")
    final = diagnosis.surface
    notes += diagnosis.notes
    lost = len(points) - int((final.vertex_of_file() >= 0).sum())
    if lost:
        notes.append(f"{lost} of the {len(points)} given vertices are not in the result")
    # Of points all that there is of a surface was laid through them.
    share = area_share(surface, np.isin(surface.face_index, final.face_index)) if len(triangles) else 1.0
    return Repaired(final.vertices, final.faces.astype(np.int32), final.file_index, tuple(notes), share, advice)


def _readable(surface: Surface, notes: list[str]) -> Surface:
    """Drop faces that name missing vertices or vertices without usable coordinates."""
    n = len(surface.vertices)
    known: BoolArray = np.all((surface.faces >= 0) & (surface.faces < n), axis=1)
    _note(notes, ~known, "faces with vertex numbers out of range dropped")
    # NaN compares false, so that it fails here as well.
    sound: BoolArray = np.all(np.abs(surface.vertices) <= MAX_COORDINATE, axis=1)
    placed: BoolArray = known.copy()
    placed[known] = np.all(sound[surface.faces[known]], axis=1)
    _note(notes, known & ~placed, "faces at NaN, infinite or giant coordinates dropped")
    return surface.keep(placed) if len(surface.faces) else surface


def _merged(surface: Surface, notes: list[str]) -> Surface:
    """Join vertices at equal positions; each keeps the lowest of their numbers."""
    first, merged = topology.merge_positions(surface.vertices)
    count = len(surface.vertices) - len(first)
    if count:
        notes.append(f"{count} vertices joined to others at the same position")
    return joined(surface, first[merged])


def _note(notes: list[str], bad: BoolArray, what: str) -> None:
    """Add a sentence if anything is marked."""
    if bad.any():
        notes.append(f"{int(bad.sum())} {what}")
