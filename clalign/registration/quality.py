"""What became of the source's faces on the target's surface: folded, collapsed, distorted, and how far away."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clalign.mesh.mesh import Mesh
from clalign.mesh.topology import edge_table, face_areas, face_normals
from clalign.refinement.precise import SurfacePoints
from clalign.registration.measures import relative_areas, stretches
from clalign.registration.places import interpolated, nearest_corner, some, walked
from clalign.registration.rigidity import Springs
from clalign.registration.untangling import turned_over

COLLAPSED = 0.01
"""A face with less than this share of its area, relative to the whole surface, has collapsed."""


@dataclass(frozen=True)
class Quality:
    """Figures of a registered surface.

    Attributes
    ----------
    flipped : share of the faces that are turned over: in a chart of the target's surface, or, for those that do not
        lie on it, against the turn of the surface around them.
    collapsed : share of the faces with less than `COLLAPSED` of their area.
    distance, largest_distance : mean and largest distance from the vertices that lie on the target to its surface, in
        mean edges of the registered surface.
    middles : mean distance from the middles of their faces to the target's surface, in mean edges: how finely the
        source resolves it.
    filled : share of the vertices that have no place on the target and continue the surface smoothly.
    shear : mean over the area of σ₁/σ₂, the singular values of the map of each face; 1 is conformal.
    area_change : mean over the area of |ln(σ₁σ₂)|; 0 keeps areas, relative to the whole.
    """

    flipped: float
    collapsed: float
    distance: float
    largest_distance: float
    middles: float
    filled: float
    shear: float
    area_change: float


def judged(
    source: Mesh, target: Mesh, positions: NDArray[np.float64], places: SurfacePoints, lying: NDArray[np.bool_]
) -> Quality:
    """Return the figures of a source laid on a target.

    Parameters
    ----------
    positions : (n, 3), in the unit and place of the target's mesh.
    places, lying : (n,) where vertices lie on the target, and which of them do.
    """
    faces, rest = source.faces, source.vertices
    on = lying[faces].all(axis=1)
    turned = turned_over(faces, target, places, lying)
    springs = Springs.of(rest, faces)
    surroundings = np.einsum("mk,mkl->ml", face_normals(rest, faces), springs.rotations(positions)[faces].sum(axis=1))
    turned |= ~on & (np.einsum("mk,mk->m", surroundings, face_normals(positions, faces)) <= 0)
    table = edge_table(faces, len(rest))
    edge = float(np.linalg.norm(positions[table.edges[:, 0]] - positions[table.edges[:, 1]], axis=1).mean())
    found = walked(positions[lying], target, nearest_corner(target.faces, some(places, lying)))
    off = np.linalg.norm(positions[lying] - interpolated(target.vertices, target.faces, found), axis=1) / edge
    middle = positions[faces[on]].mean(axis=1)
    start = nearest_corner(target.faces, some(places, faces[on][:, 0]))
    under = interpolated(target.vertices, target.faces, walked(middle, target, start))
    areas = face_areas(rest, faces)
    weight = areas / areas.sum()
    grown = relative_areas(positions, rest, faces)
    stretch = stretches(positions, rest, faces)
    ratio = stretch[:, 0] / np.maximum(stretch[:, 1], 1e-6 * stretch[:, 0])
    return Quality(
        flipped=float(turned.mean()),
        collapsed=float((grown < COLLAPSED).mean()),
        distance=float(off.mean()),
        largest_distance=float(off.max()),
        middles=float(np.linalg.norm(middle - under, axis=1).mean() / edge) if on.any() else 0.0,
        filled=float((~lying).mean()),
        shear=float(weight @ ratio),
        area_change=float(weight @ np.abs(np.log(np.maximum(grown, 1e-6)))),
    )
