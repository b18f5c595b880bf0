"""Folded places of a map between surfaces, told in flat charts of the target and smoothed out there.

Normals do not tell whether a face is turned over where neither mesh resolves the surface: between toes, in an ear, in
an armpit. A chart does: laid flat, the target's triangles all turn one way round, and the places of a face's corners
among them turn that way or the other.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from clalign.mesh.mesh import Mesh
from clalign.mesh.topology import face_normals, graph_components, vertex_normals
from clalign.refinement.precise import SurfacePoints
from clalign.registration.chart import Chart, mean_value_weights, settled, signed_areas
from clalign.registration.places import interpolated, some, with_some

SURE = 0.3
"""Cosine between the normals of a face and of the target at all its corners from which on it is not turned over."""
RINGS, ROUNDS = 2, 12
"""Rings of faces about a fold that move in the first round, and rounds, each of which adds a ring."""
AROUND, MOST_AROUND = 2, 6
"""Rings of faces about places that a chart has at least and, where those do not hang together, at most."""


def turned_over(
    faces: NDArray[np.int32], target: Mesh, places: SurfacePoints, lying: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return (m,) which faces are turned over, or torn apart, by a map of their vertices to places on the target.

    Parameters
    ----------
    faces : (m, 3) of the source.
    places : (n,) for every vertex of the source.
    lying : (n,) vertices that lie on the target; faces with others are not looked at.
    """
    turned = np.zeros(len(faces), dtype=bool)
    doubtful = _doubtful(faces, target, places) & lying[faces].all(axis=1)
    for cluster in _clusters(faces, len(places.faces), doubtful):
        turned[cluster] = _turned_in_chart(faces[cluster], target, places)[0]
    return turned


def untangled(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    target: Mesh,
    places: SurfacePoints,
    lying: NDArray[np.bool_],
) -> SurfacePoints:
    """Return places of a source's vertices under which, as far as that is possible, no face is turned over.

    Around faces that are, the vertices move to weighted means of their neighbours in a chart, the rim staying where it
    is; the part that moves grows until nothing is turned over in it.

    Parameters
    ----------
    vertices, faces : (n, 3) and (m, 3) of the source.
    places : (n,) on the target, the ones to begin with.
    lying : (n,) vertices that lie on the target; the others have no places.
    """
    weights, known = mean_value_weights(vertices, faces), lying[faces].all(axis=1)
    for number in range(ROUNDS):
        turned = turned_over(faces, target, places, lying)
        if not turned.any():
            break
        around = grown_faces(faces, len(vertices), turned, RINGS + number) & known
        for part in _clusters(faces, len(vertices), around):
            before, chart = _turned_in_chart(faces[part], target, places)
            used, local = np.unique(faces[part], return_inverse=True)
            free = _inside(faces, part, len(vertices))[used]
            if chart is None or not free.any():
                continue
            flat = settled(chart.laid(some(places, used)), weights[used][:, used], free)
            if (signed_areas(flat, local.reshape(-1, 3)) <= 0).sum() <= before.sum():
                places = with_some(places, used[free], chart.lifted(flat[free]))
    return places


def grown_faces(faces: NDArray[np.integer], count: int, chosen: NDArray[np.bool_], rings: int) -> NDArray[np.bool_]:
    """Return (m,) the chosen faces and those around them, ring by ring of shared vertices; `count` vertices in all."""
    for _ in range(rings):
        near = np.zeros(count, dtype=bool)
        near[faces[chosen]] = True
        chosen = near[faces].any(axis=1)
    return chosen


def _inside(faces: NDArray[np.integer], part: NDArray[np.int64], count: int) -> NDArray[np.bool_]:
    """(count,) the vertices all of whose faces are in a part."""
    within = np.bincount(faces[part].ravel(), minlength=count)
    return (within > 0) & (within == np.bincount(faces.ravel(), minlength=count))


def _doubtful(faces: NDArray[np.int32], target: Mesh, places: SurfacePoints) -> NDArray[np.bool_]:
    """(m,) faces that do not clearly look as the target does at all their corners."""
    normals = interpolated(vertex_normals(target.vertices, target.faces), target.faces, places)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    own = face_normals(interpolated(target.vertices, target.faces, places), faces)
    own /= np.maximum(np.linalg.norm(own, axis=1, keepdims=True), 1e-300)
    return np.asarray(np.einsum("mk,mck->mc", own, normals[faces]).min(axis=1) < SURE)


def _clusters(faces: NDArray[np.integer], count: int, chosen: NDArray[np.bool_]) -> Iterator[NDArray[np.int64]]:
    """The chosen faces, by the parts in which they hang together at vertices."""
    rows = np.flatnonzero(chosen)
    if not rows.size:
        return
    corners = faces[rows].astype(np.int64)
    _, label = graph_components(count, corners[:, :2].ravel(), corners[:, 1:].ravel())
    mine = label[corners[:, 0]]
    for number in np.unique(mine):
        yield rows[mine == number]


def _turned_in_chart(
    corners: NDArray[np.integer], target: Mesh, places: SurfacePoints
) -> tuple[NDArray[np.bool_], Chart | None]:
    """Which faces (m, 3) are turned over in a chart about the places of their corners; all where there is none."""
    used, local = np.unique(corners, return_inverse=True)
    here = some(places, used)
    chart = _chart_about(target, here)
    if chart is None:
        return np.ones(len(corners), dtype=bool), None
    return signed_areas(chart.laid(here), local.reshape(-1, 3)) <= 0, chart


def _chart_about(target: Mesh, places: SurfacePoints) -> Chart | None:
    """A chart of the connected faces about places, or None if there is none."""
    own = np.zeros(target.n_faces, dtype=bool)
    own[places.faces] = True
    for rings in range(AROUND, MOST_AROUND + 1):
        within = np.flatnonzero(grown_faces(target.faces, target.n_vertices, own, rings))
        corners = target.faces[within].astype(np.int64)
        _, label = graph_components(target.n_vertices, corners[:, :2].ravel(), corners[:, 1:].ravel())
        reached = np.unique(label[target.faces[own, 0]])
        if len(reached) == 1:
            chart = Chart.of(target.vertices, target.faces, within[label[corners[:, 0]] == reached[0]])
            if chart is not None:
                return chart
    return None
