"""A registered mesh: the source's vertices and faces lying on the target's surface."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clalign.correspondence import Correspondence
from clalign.errors import InputError
from clalign.maps.file_maps import carried
from clalign.mesh.mesh import Mesh
from clalign.refinement.precise import SurfacePoints
from clalign.registration.laying import laid
from clalign.registration.quality import Quality, judged
from clalign.transfer.precise_map import precise_places


@dataclass(frozen=True, eq=False)
class Registration:
    """The source's connectivity lying on the target's surface.

    Everything is in the numbering of the source's file; positions are in the unit and place of the target's file.

    source, target : the meshes of the match.
    vertices : (file_count_x, 3) float64; NaN for vertices that are neither on the surface nor carried along.
    faces : (m, 3) int64, of the surface and of loose pieces.
    target_faces, barycentric : (file_count_x,) int64 and (file_count_x, 3) float64, where each vertex lies on the
        target's surface; -1 and zeros for vertices that do not.
    quality : what became of the faces, and how near the surface is.
    """

    source: Mesh
    target: Mesh
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    target_faces: NDArray[np.int64]
    barycentric: NDArray[np.float64]
    quality: Quality

    def facts(self) -> dict[str, Any]:
        """Return names and figures as plain values."""
        return {"source": self.source.name, "target": self.target.name, "quality": asdict(self.quality)}

    def positions(self, given: ArrayLike) -> NDArray[np.float64]:
        """Return (file_count_x, 3) positions of all vertices of the source's file.

        Parameters
        ----------
        given : (file_count_x, 3), the file's own; those of vertices without a place move along with the surface.
        """
        missing = ~np.isfinite(self.vertices).all(axis=1)
        found = self.vertices.copy()
        if missing.any():
            at = (np.asarray(given, dtype=np.float64)[missing] - self.source.offset) / self.source.scale
            found[missing] = _beside(self.source, self.source.from_file(self.vertices), at)
        return found


def register(correspondence: Correspondence) -> Registration:
    """Lay the source's connectivity on the target's surface, as a match says.

    Points in faces, from the match or read anew from its eigenfunctions, pull a surface that is as similar as possible
    to the source, alternating with projection onto the target; what is folded then is smoothed out in charts of the
    target. Vertices without a match, and those that the map crowds at the edge of a hole, continue the surface.

    Raises
    ------
    InputError
        No vertex of the source has a match.
    """
    source, target = correspondence.source, correspondence.target
    matched = source.map_from_file(target, correspondence.target_of_source) >= 0
    if not matched.any():
        raise InputError(f"{source.name}: no vertex has a match on {target.name}, so there is nothing to lay on it")
    found = laid(source, target, _matches(correspondence, matched), matched, correspondence.options.rules.registration)
    positions = found.positions * target.scale + target.offset
    vertices = source.to_file(positions, np.nan)
    vertices[source.loose.file_index] = _beside(source, positions, source.loose.vertices)
    return Registration(
        source=source,
        target=target,
        vertices=vertices,
        faces=source.all_file_faces,
        target_faces=source.to_file(np.where(found.lying, found.places.faces, -1), -1),
        barycentric=source.to_file(np.where(found.lying[:, None], found.places.barycentric, 0.0), 0.0),
        quality=judged(source, target, found.positions, found.places, found.lying),
    )


def _matches(correspondence: Correspondence, matched: NDArray[np.bool_]) -> SurfacePoints:
    """(n,) matches as points in faces, as the match has kept them or from its eigenfunctions."""
    if correspondence.barycentric is not None:
        faces, weights = map(correspondence.source.from_file, correspondence.barycentric)
        if (faces[matched] >= 0).all():
            return SurfacePoints(np.maximum(faces, 0), weights)
    return precise_places(correspondence)


def _beside(source: Mesh, positions: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (k, 3) beside the source, in its unit, moved along with its vertices to positions (n, 3)."""
    if not len(points):
        return np.zeros((0, 3))
    moved = replace(source, vertices=positions, scale=1.0, offset=np.zeros(3))
    return carried(source, moved, np.arange(source.n_vertices), points)
