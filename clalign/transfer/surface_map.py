"""A match in the vertex order of the loaded meshes, able to carry values from one shape to the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from clalign.correspondence import Correspondence
from clalign.errors import ResultError
from clalign.mesh.mesh import Mesh
from clalign.refinement.precise import SurfacePoints
from clalign.transfer.precise_map import precise_places

Direction = Literal["to_source", "to_target"]


@dataclass(frozen=True)
class SurfaceMap:
    """For every vertex of one shape a place on the other, in the order of the meshes' own arrays.

    Attributes
    ----------
    vertex : (n,) int64, vertex of the other shape; -1 where there is none.
    corners : (n, 3) int64, the vertices of the other shape between which the place lies.
    weights : (n, 3) float64, its barycentric coordinates there.
    """

    vertex: NDArray[np.int64]
    corners: NDArray[np.int64]
    weights: NDArray[np.float64]

    @property
    def matched(self) -> NDArray[np.bool_]:
        """(n,) bool: vertices that have a match."""
        return self.vertex >= 0

    def pull(self, values: NDArray[np.floating]) -> NDArray[np.float64]:
        """Carry values from the other shape to this one, interpolated in faces where the map is known that finely.

        Values (n_other,) or (n_other, c) become (n,) or (n, c) float64; rows without a match are zero (see `matched`).
        """
        values = np.asarray(values, dtype=np.float64)
        pulled = np.einsum("nc,nc...->n...", self.weights, values[np.maximum(self.corners, 0)])
        pulled[~self.matched] = 0.0
        return np.asarray(pulled)


def surface_map(
    correspondence: Correspondence, direction: Direction = "to_source", *, precise: bool = False
) -> SurfaceMap:
    """Return the map that carries values of the target "to_source", or of the source "to_target".

    "to_source" pulls functions on the target back through `target_of_source`, within faces where the match has kept
    that; "to_target" pulls functions on the source back through `source_of_target`.

    precise : within faces in both directions, read from the eigenfunctions where the match has kept vertices only.
    """
    source, target = correspondence.source, correspondence.target
    forward = direction == "to_source"
    here, there = (source, target) if forward else (target, source)
    matches = correspondence.target_of_source if forward else correspondence.source_of_target
    coarse = vertex_map(matches, here, there)
    if forward and correspondence.barycentric is not None:
        points = SurfacePoints(*map(source.from_file, correspondence.barycentric))
    elif precise:
        points = precise_places(correspondence, forward=forward)
    else:
        return coarse
    known = (points.faces >= 0) & coarse.matched
    corners = np.where(known[:, None], there.faces[np.maximum(points.faces, 0)], coarse.corners)
    return SurfaceMap(coarse.vertex, corners, np.where(known[:, None], points.barycentric, coarse.weights))


def vertex_map(file_map: NDArray[np.integer], here: Mesh, there: Mesh) -> SurfaceMap:
    """Return a map given in the numbering of the files in that of the meshes' arrays.

    Parameters
    ----------
    file_map : (here.file_count,) int, for every vertex of one file a vertex of the other; -1 for none.

    Raises
    ------
    ResultError
        The map's length or an index does not fit the two files.
    """
    file_map = np.asarray(file_map)
    if file_map.shape != (here.file_count,):
        raise ResultError(
            f"the map has shape {file_map.shape}, but {here.name} has {here.file_count} vertices in its file"
        )
    outside = np.flatnonzero((file_map < -1) | (file_map >= there.file_count))
    if outside.size:
        raise ResultError(
            f"vertex {outside[0]} of {here.name} is mapped to {file_map[outside[0]]}, but {there.name} has vertices 0 "
            f"to {there.file_count - 1}; maps are zero-based here"
        )
    chosen = here.map_from_file(there, file_map)
    corners = np.repeat(chosen[:, None], 3, axis=1)
    return SurfaceMap(chosen, corners, np.tile([1.0, 0.0, 0.0], (len(chosen), 1)))
