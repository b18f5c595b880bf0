"""Join what a file holds apart although it lies together: seams, corners of single triangles, T-junctions, needles.

Only the boundary is looked at, but for vertices without any area: two sheets that touch in their interior stay two.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from clalign.mesh import topology
from clalign.mesh.defects import Surface
from clalign.mesh.topology import BoolArray, IntArray

NEAR = 1e-6
"""Vertices closer than this part of the longest side of the box are one: text files keep six digits."""
NEAR_ROUNDING = 4 * float(np.finfo(np.float32).eps)
"""... or than this part of the largest coordinate, which is how well single precision knows a place."""
NEAR_EDGES = 0.01
"""... but never farther than this part of the median edge."""
_MOST_CUTS = 20
"""A face is cut at one of its sides at a time; sides with vertices on them are looked for so often."""
_CROWD = 300
"""Vertices of the boundary around a side above which it is not looked at."""
_COLLAPSES = 20


def welding_distance(surface: Surface) -> float:
    """Distance in the file's unit below which two vertices of the boundary are one."""
    edges = topology.side_lengths(surface.vertices, surface.faces)
    edges = edges[edges > 0]
    if not edges.size:
        return 0.0
    extent = float(np.ptp(surface.vertices, axis=0).max())
    wanted = max(NEAR * extent, NEAR_ROUNDING * float(np.abs(surface.vertices).max()))
    return min(wanted, NEAR_EDGES * float(np.median(edges)))


def boundary_partners(surface: Surface, rim: IntArray, distance: float) -> IntArray:
    """(n,) for every vertex the first vertex of the boundary that lies at its place; itself where there is none.

    Vertices are chained: each is within `distance` of another one at the same place.

    rim : the vertices of the boundary, at least one.
    """
    partner = np.arange(len(surface.vertices))
    # Very many vertices can share one place; pairs are counted between places.
    at_place, place = topology.merge_positions(surface.vertices[rim])
    pairs = cKDTree(surface.vertices[rim[at_place]]).query_pairs(distance, output_type="ndarray")
    _, label = topology.graph_components(len(at_place), pairs[:, 0], pairs[:, 1])
    first = np.full(len(at_place), len(partner), dtype=np.int64)
    np.minimum.at(first, label, rim[at_place])
    partner[rim] = first[label[place]]
    return partner


def joined(surface: Surface, partner: IntArray) -> Surface:
    """The surface on which every vertex has become its partner (n,), which must be a partner of itself.

    Of a given vertex with several copies one must stay to be known by. Faces can end up with a corner named twice, or
    as copies of each other.
    """
    kept: BoolArray = partner == np.arange(len(partner))
    place = np.cumsum(kept) - 1
    here = np.full(len(surface.joined_to), -1, dtype=np.int64)
    here[surface.file_index] = np.arange(len(partner))
    now = here[surface.joined_to]
    gone = now >= 0
    gone[gone] = ~np.isin(surface.joined_to[gone], surface.file_index[kept])
    joined_to = surface.joined_to.copy()
    joined_to[gone] = surface.file_index[partner[now[gone]]]
    return replace(
        surface,
        vertices=surface.vertices[kept],
        faces=place[partner[surface.faces]],
        file_index=surface.file_index[kept],
        joined_to=joined_to,
    )


def neighbours_of_bare(surface: Surface, bare: BoolArray) -> IntArray:
    """(n,) for every vertex without area the vertex at the end of its shortest edges that has some; else itself.

    Parameters
    ----------
    bare : (n,) True for the vertices without area.
    """
    edges = topology.edge_table(surface.faces, len(surface.vertices)).edges
    length = np.linalg.norm(surface.vertices[edges[:, 0]] - surface.vertices[edges[:, 1]], axis=1)
    tail, head = np.concatenate([edges[:, 0], edges[:, 1]]), np.concatenate([edges[:, 1], edges[:, 0]])
    partner, settled = np.arange(len(bare)), ~bare
    for _ in range(_COLLAPSES):
        usable = ~settled[tail] & settled[head]
        if not usable.any():
            break
        tails, heads = tail[usable], head[usable]
        order = np.lexsort((heads, np.tile(length, 2)[usable], tails))
        moved, first = np.unique(tails[order], return_index=True)
        partner[moved] = partner[heads[order[first]]]
        settled[moved] = True
    return partner


def cut_at_junctions(surface: Surface, distance: float) -> tuple[Surface, IntArray]:
    """Cut the faces along whose boundary side another vertex of the boundary lies, so that the two become neighbours.

    Parameters
    ----------
    distance : how far from a side a vertex may lie, in the file's unit.

    Returns
    -------
    cut, vertices : the surface, and the vertices (k,) at which faces were cut. Parts of a face keep its number.
    """
    found: list[IntArray] = []
    for _ in range(_MOST_CUTS):
        sides, on_side, off_middle = _junctions(surface, distance)
        if not len(sides):
            break
        m = len(surface.faces)
        # One side a face and one vertex a side, then again: what was cut has new sides.
        # Of several on a side the one nearest its middle, so that n of them take about log n rounds.
        order = np.lexsort((on_side, off_middle, sides % m))
        first = order[np.unique(sides[order] % m, return_index=True)[1]]
        face, corner, vertex = sides[first] % m, sides[first] // m, on_side[first]
        head = surface.faces[face, (corner + 1) % 3]
        faces = surface.faces.copy()
        faces[face, (corner + 1) % 3] = vertex
        rest = np.stack([vertex, head, surface.faces[face, (corner + 2) % 3]], axis=1)
        surface = replace(
            surface,
            faces=np.concatenate([faces, rest]),
            face_index=np.concatenate([surface.face_index, surface.face_index[face]]),
        )
        found.append(vertex)
    return surface, np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *found]))


def _junctions(surface: Surface, distance: float) -> tuple[IntArray, IntArray, NDArray[np.float64]]:
    """Half-edges of the boundary and vertices of the boundary that lie within them, and how far off the middle.

    Sides with very many vertices around them (hair, grass) are left as they are.
    """
    table = topology.edge_table(surface.faces, len(surface.vertices))
    lonely = np.flatnonzero(table.face_count[table.edge_of_half_edge] == 1)
    if not len(lonely):
        return lonely, lonely, np.zeros(0)
    tail = surface.faces.T.ravel()[lonely]
    head = np.roll(surface.faces, -1, axis=1).T.ravel()[lonely]
    rim = np.unique(np.concatenate([tail, head]))
    start, along = surface.vertices[tail], surface.vertices[head] - surface.vertices[tail]
    length = np.linalg.norm(along, axis=1)
    tree = cKDTree(surface.vertices[rim])
    middle = start + 0.5 * along
    crowd = tree.query_ball_point(middle, 0.5 * length, return_length=True)
    quiet = crowd <= _CROWD
    lonely, start, along, length, middle = (each[quiet] for each in (lonely, start, along, length, middle))
    if not len(lonely):
        return lonely, lonely, np.zeros(0)
    near = tree.query_ball_point(middle, 0.5 * length, return_sorted=True)
    side = np.repeat(np.arange(len(lonely)), [len(each) for each in near])
    vertex = rim[np.concatenate([np.asarray(each, dtype=np.int64) for each in near])] if len(side) else side
    offset = surface.vertices[vertex] - start[side]
    share = np.einsum("ij,ij->i", offset, along[side]) / np.maximum(length[side] ** 2, np.finfo(np.float64).tiny)
    away = np.linalg.norm(offset - share[:, None] * along[side], axis=1)
    apart = np.minimum(share, 1 - share) * length[side]
    opposite = np.roll(surface.faces, -2, axis=1).T.ravel()[lonely][side]
    hit = (away <= distance) & (apart > distance) & (vertex != opposite)
    return lonely[side[hit]], vertex[hit], np.abs(share[hit] - 0.5)


def duplicate_places(vertices: NDArray[np.float64]) -> bool:
    """Whether any two vertices (n, 3) have bitwise the same place."""
    return len(topology.merge_positions(vertices)[0]) < len(vertices)
