"""Maps between two surfaces as maps between their files, with what hangs loose carried along.

A loose piece (an eye, a tongue, a shell) has no eigenfunctions in common with the surface beside it. It moves with the
surface near it: by the similarity that takes the vertices of the source around it to their matches, in the sense of
least squares weighted by nearness (moving least squares: Schaefer, McPhail & Warren 2006; rotation from the singular
value decomposition: Arun, Huang & Blostein 1987).
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from clalign.maps.point_maps import PointMaps
from clalign.mesh.mesh import Mesh
from clalign.mesh.topology import vertex_normals

AROUND = 64
"""Vertices of the surface that a loose vertex moves with."""
LARGEST_SCALE = 2.0
"""A piece grows or shrinks by this factor at most."""
SAME_PIECE = 0.5
"""Two pieces are matched if one comes to lie this near the other, on average, as a part of the other's size."""
SETTLING = 5
"""Steps in which a carried piece is shifted onto the one that it is matched with."""


class VertexStatus(IntEnum):
    """How a vertex of a file came to its match."""

    UNMATCHED = 0
    """It has none: it is in no face, part of a piece that was left out, or not covered by the part that was matched."""
    MATCHED = 1
    """It lies on the surface that was matched."""
    CARRIED = 2
    """It hangs loose beside the surface and was carried along with it."""


def vertex_status(mesh: Mesh, matches: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Return the `VertexStatus` of every vertex of a file (file_count,) under a map in the numbering of the files."""
    status = np.full(mesh.file_count, VertexStatus.UNMATCHED, dtype=np.uint8)
    status[matches >= 0] = VertexStatus.MATCHED
    loose = mesh.loose.file_index
    status[loose[matches[loose] >= 0]] = VertexStatus.CARRIED
    return status


def file_maps(source: Mesh, target: Mesh, maps: PointMaps) -> PointMaps:
    """Return maps between two surfaces in the numbering of their files.

    Parameters
    ----------
    source, target : the surfaces.
    maps : target_of_source (n_x,) and source_of_target (n_y,), vertices of the surfaces; -1 for none.

    Returns
    -------
    PointMaps
        target_of_source (file_count_x,) and source_of_target (file_count_y,): vertices of the files, -1 for none. A
        loose vertex is matched with the nearest vertex of the piece that its own comes to lie on, else with the
        nearest one of the surface.
    """
    return PointMaps(_file_map(source, target, maps.target_of_source), _file_map(target, source, maps.source_of_target))


def _file_map(here: Mesh, there: Mesh, matches: NDArray[np.int64]) -> NDArray[np.int64]:
    found = here.map_to_file(there, matches)
    found[here.loose.file_index] = _carried_matches(here, there, matches)
    return found


def _carried_matches(here: Mesh, there: Mesh, matches: NDArray[np.int64]) -> NDArray[np.int64]:
    """(k,) the vertex of the other file for every loose vertex."""
    loose = here.loose
    found = np.empty(len(loose.vertices), dtype=np.int64)
    if not len(loose.vertices):
        return found
    if not (matches >= 0).any():
        return np.full_like(found, -1)
    places = carried(here, there, matches, loose.vertices)
    surface = cKDTree(there.vertices)
    for piece in range(int(loose.piece.max()) + 1):
        mine = loose.piece == piece
        rivals = [_approach(places[mine], there, number) for number in np.unique(there.loose.piece)]
        distance, index = min(rivals, key=lambda rival: rival[0], default=(np.inf, None))
        if index is None or distance > SAME_PIECE:
            index = there.file_index[surface.query(places[mine])[1]]
        found[mine] = index
    return found


def _approach(places: NDArray[np.float64], there: Mesh, piece: int) -> tuple[float, NDArray[np.int64]]:
    """How far carried places (k, 3) lie from a piece, in sizes of the piece; and its vertices nearest to them."""
    mine = np.flatnonzero(there.loose.piece == piece)
    points = there.loose.vertices[mine]
    tree = cKDTree(points)
    size = max(float(np.linalg.norm(np.ptp(points, axis=0))), np.finfo(np.float64).tiny)
    distance = float(tree.query(places)[0].mean()) / size
    for _ in range(SETTLING):
        places = places + (points[tree.query(places)[1]] - places).mean(axis=0)
    return distance, there.loose.file_index[mine[tree.query(places)[1]]]


def carried(here: Mesh, there: Mesh, matches: NDArray[np.int64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Move points beside one surface to where they lie beside the other.

    Parameters
    ----------
    here, there : the surfaces.
    matches : (n,) int, the vertex of `there` for every vertex of `here`; those with -1 are passed over.
    points : (k, 3), in the unit and place of `here`.

    Returns
    -------
    (k, 3) float64, in the unit and place of `there`.
    """
    known = np.flatnonzero(matches >= 0)
    distance, order = cKDTree(here.vertices[known]).query(points, k=min(AROUND, len(known)))
    near = known[order]
    weight = 1.0 / (distance**2 + np.mean(distance, axis=1, keepdims=True) ** 2)
    weight /= weight.sum(axis=1, keepdims=True)
    mine, other = here.vertices[near], there.vertices[matches[near]]
    middle, other_middle = (np.einsum("ka,kax->kx", weight, rows)[:, None] for rows in (mine, other))
    mine, other = mine - middle, other - other_middle
    spread = np.einsum("ka,kax,kax->k", weight, mine, mine)
    # Normals tell the two sides of a flat neighbourhood apart; they weigh as much as the places.
    normals = vertex_normals(here.vertices, here.faces)[near]
    other_normals = vertex_normals(there.vertices, there.faces)[matches[near]]
    cross = np.einsum("ka,kax,kay->kxy", weight, mine, other)
    cross += spread[:, None, None] * np.einsum("ka,kax,kay->kxy", weight, normals, other_normals)
    left, _, right = np.linalg.svd(cross)
    rotation = left @ right
    turned = np.einsum("kax,kxy->kay", mine, rotation)
    factor = np.einsum("ka,kax,kax->k", weight, turned, other) / np.maximum(spread, np.finfo(np.float64).tiny)
    factor = np.clip(factor, 1.0 / LARGEST_SCALE, LARGEST_SCALE)
    moved = np.einsum("kx,kxy->ky", points - middle[:, 0], rotation)
    return np.asarray(factor[:, None] * moved + other_middle[:, 0], dtype=np.float64)
