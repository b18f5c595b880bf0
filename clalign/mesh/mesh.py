"""Triangle meshes as the method sees them: one clean surface of unit area that remembers its file's vertex numbers."""

from __future__ import annotations

import logging
import os
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clalign.errors import MeshError
from clalign.mesh.checks import diagnose
from clalign.mesh.defects import Diagnosis, LoosePieces
from clalign.mesh.reading import expanded, mesh_stem, read_mesh_file
from clalign.mesh.topology import boxed, face_areas

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Mesh:
    """A connected, oriented, manifold triangle surface of unit area, with or without boundary.

    It is the working copy of what a file holds, as it was most likely meant; results are in the file's own numbers.
    """

    vertices: NDArray[np.float64]
    """(n, 3) positions in units of sqrt(area), centred at the area centroid."""
    faces: NDArray[np.int32]
    """(m, 3) vertex numbers, consistently oriented; a closed surface points outward."""
    scale: float
    """Length in the file of one unit of length here: `vertices * scale + offset` are the file's positions."""
    offset: NDArray[np.float64]
    """(3,) the file's position of the area centroid."""
    name: str
    """Stem of the file name, or the caller's word for the mesh."""
    path: str | None
    """The file, if there was one."""
    file_index: NDArray[np.int64]
    """(n,) number in the file of each vertex; the same for several where sheets of the file were parted."""
    vertex_of_file: NDArray[np.int64]
    """(file_count,) the vertex here of every vertex of the file; the same for several that were joined, −1 for those
    off the surface."""
    notes: tuple[str, ...]
    """What was put right while loading, as sentences for the user."""
    loose: LoosePieces = field(default_factory=LoosePieces.none)
    """Smaller pieces that are carried along with the surface, in its unit and place."""

    def __repr__(self) -> str:
        return f"<Mesh {self.name}: {self.n_vertices:,} vertices, {self.n_faces:,} faces>"

    @property
    def file_count(self) -> int:
        """Number of vertices in the file."""
        return len(self.vertex_of_file)

    @property
    def n_vertices(self) -> int:
        """Number of vertices on the surface."""
        return len(self.vertices)

    @property
    def n_faces(self) -> int:
        """Number of triangles."""
        return len(self.faces)

    @property
    def file_faces(self) -> NDArray[np.int64]:
        """(m, 3) corners of the triangles, numbered as in the file."""
        return self.file_index[self.faces]

    @property
    def all_file_faces(self) -> NDArray[np.int64]:
        """(m + q, 3) `file_faces`, and after them the triangles of loose pieces."""
        return np.concatenate([self.file_faces, self.loose.faces])

    def file_vertices(self) -> NDArray[np.float64]:
        """(n, 3) positions of the vertices in the file's own unit and place."""
        return self.vertices * self.scale + self.offset

    def file_positions(self) -> NDArray[np.float64]:
        """(file_count, 3) positions in the file's unit and order; vertices without a place lie at the centroid."""
        positions = self.to_file(self.file_vertices(), self.offset)
        positions[self.loose.file_index] = self.loose.vertices * self.scale + self.offset
        return positions

    def to_file(self, values: NDArray, fill: ArrayLike) -> NDArray:
        """Values (n, …) of the vertices in the order of the file (file_count, …), `fill` off the surface."""
        filled = np.full((self.file_count, *values.shape[1:]), fill, dtype=values.dtype)
        on_surface = self.vertex_of_file >= 0
        filled[on_surface] = values[self.vertex_of_file[on_surface]]
        return filled

    def from_file(self, values: NDArray) -> NDArray:
        """Values (file_count, …) in the order of the file as those of the vertices (n, …)."""
        return values[self.file_index]

    def map_to_file(self, other: Mesh, matches: NDArray[np.integer]) -> NDArray[np.int64]:
        """Turn a map (n,) to vertices of `other` into one between the files (file_count,), −1 for none in both."""
        return self.to_file(np.where(matches >= 0, other.file_index[matches], -1), -1)

    def map_from_file(self, other: Mesh, matches: NDArray[np.integer]) -> NDArray[np.int64]:
        """Turn a map (file_count,) between the files into one to vertices of `other`: (n,), −1 for no match."""
        mine = self.from_file(matches)
        return np.where(mine >= 0, other.vertex_of_file[mine], -1)


def load_mesh(path: str | os.PathLike[str], *, strict: bool = False, component: int | None = None) -> Mesh:
    """Read a mesh file, keeping the file's vertex numbers.

    Parameters
    ----------
    path : a file of any format in `clalign.mesh.reading`.
    strict : refuse what is no surface as it stands; otherwise it is put right as it was most likely meant, with a note.
    component : number of the piece to match, from 1 for the largest; None for the largest if it stands out.

    Raises
    ------
    MeshError
        if the file cannot be read, or has a defect that the method cannot work with.
    """
    raw, path = read_mesh_file(path), expanded(path)
    found = diagnose(raw.vertices, raw.faces, str(path), strict=strict, component=component, normals=raw.normals)
    return _mesh_from_diagnosis(found, mesh_stem(path.name), str(path), raw.notes)


def mesh_from_arrays(
    vertices: ArrayLike,
    faces: ArrayLike = (),
    name: str = "mesh",
    path: str | os.PathLike[str] | None = None,
    *,
    strict: bool = False,
    component: int | None = None,
    normals: ArrayLike | None = None,
) -> Mesh:
    """Read two arrays as a surface and scale it to unit area; without faces, lay a surface through the points.

    Parameters
    ----------
    vertices : (n, 3) float, positions in any unit.
    faces : (m, 3) int, vertex numbers counted from 0; empty for a cloud of points.
    name, path : what the mesh is called, and where the arrays came from, in messages.
    strict, component : see `load_mesh`.
    normals : (n, 3) of a cloud, which say where the front of an open sheet is.

    Raises
    ------
    MeshError
        if there is a defect that the method cannot work with.
    """
    file = None if path is None else os.fspath(path)
    known = None if normals is None else np.asarray(normals, dtype=np.float64)
    found = diagnose(vertices, faces, file or name, strict=strict, component=component, normals=known)
    return _mesh_from_diagnosis(found, name, file, ())


def as_mesh(thing: Any, name: str = "mesh", *, strict: bool = False, component: int | None = None) -> Mesh:
    """Take a mesh in any form a caller may hold it in.

    Parameters
    ----------
    thing : Mesh, str, path-like, object with `vertices` and perhaps `faces` (such as trimesh.Trimesh), pair (vertices,
        faces), or an array of points (n, 3)
    name : str
        name for a mesh that does not come from a file.
    strict, component
        see `load_mesh`; a `Mesh` is taken as it is.

    Raises
    ------
    MeshError
        if `thing` is none of these, or is a mesh that cannot be used.
    """
    if isinstance(thing, Mesh):
        return thing
    if isinstance(thing, (str, os.PathLike)):
        return load_mesh(thing, strict=strict, component=component)
    if hasattr(thing, "vertices"):
        return mesh_from_arrays(thing.vertices, getattr(thing, "faces", ()), name, strict=strict, component=component)
    if isinstance(thing, (tuple, list)) and len(thing) == 2:
        return mesh_from_arrays(thing[0], thing[1], name, strict=strict, component=component)
    if isinstance(thing, np.ndarray):
        return mesh_from_arrays(thing, (), name, strict=strict, component=component)
    raise MeshError(
        f"{name}: expected a path, a trimesh object, a pair (vertices, faces) or an array of points (n, 3), not "
        f"{type(thing).__name__}. Of a scene, load the mesh first."
    )


def _mesh_from_diagnosis(diagnosis: Diagnosis, name: str, path: str | None, notes: tuple[str, ...]) -> Mesh:
    """Refuse with the reasons, or scale the surface that the diagnosis left."""
    surface = diagnosis.usable_surface(name, path)
    vertices, scale, offset = unit_area(surface.vertices, surface.faces)
    notes = notes + diagnosis.notes
    for note in notes:
        log.info("%s: %s", name if path is None else path, note)
    return Mesh(
        vertices=vertices,
        faces=surface.faces.astype(np.int32),
        scale=scale,
        offset=offset,
        name=name,
        path=path,
        file_index=surface.file_index,
        vertex_of_file=surface.vertex_of_file(),
        notes=notes,
        loose=replace(diagnosis.loose, vertices=(diagnosis.loose.vertices - offset) / scale),
    )


def unit_area(
    vertices: NDArray[np.float64], faces: NDArray[np.integer]
) -> tuple[NDArray[np.float64], float, NDArray[np.float64]]:
    """Move the area centroid of a surface with positive area to the origin and scale its area to 1.

    Returns
    -------
    scaled, scale, offset : (n, 3), float and (3,); `vertices == scaled * scale + offset` up to rounding.
    """
    inside, middle, extent = boxed(vertices)
    areas = face_areas(inside, faces)
    centroid = (areas[:, None] * inside[faces].mean(axis=1)).sum(axis=0) / float(areas.sum())
    # Moving rounds the places, and thin faces change their area with them; what counts is that of the moved ones.
    centred = inside - centroid
    side = float(np.sqrt(face_areas(centred, faces).sum()))
    return centred / side, extent * side, middle + extent * centroid
