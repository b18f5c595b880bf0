"""Take the faces of a mesh apart and glue them together again where that gives an oriented surface.

Faces are glued along sides with exactly two faces, and of crowded edges along those that belong to one patch or
continue each other most straightly (so a body survives when a fin or an inner wall is cut off it). The corners that are
then connected around a point are the vertices of the result, which splits pinched points and non-manifold edges in one
step.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_tree

from clalign.mesh import topology
from clalign.mesh.defects import Surface
from clalign.mesh.topology import BoolArray, IntArray

_PASSES = 10
FEW_CROSSED = 0.05
"""Share of sides in a one-sided patch, in faces, up to which those that run against each other are where it is cut."""
_MOST_AROUND = 16
"""Edges with more faces than this are cut without looking for the faces that continue each other."""


@dataclass(frozen=True)
class Glued:
    """A manifold, oriented surface, and what it took to get there."""

    surface: Surface
    turned: IntArray
    """Given numbers of the faces that were reversed."""
    doubled: int
    """How many vertices more there are than before."""
    dropped: IntArray
    """Given numbers of the faces at edges that could not be cut."""
    left: int
    """Edges and vertices that are still no surface after all passes; 0 for every mesh that is known."""


def glued(surface: Surface) -> Glued:
    """Return the surface glued anew: manifold and orientable, with faces reversed and vertices doubled where needed.

    Vertices that no face uses any more are left out; a given vertex that was split has several copies.
    """
    doubled = 0
    turned: list[IntArray] = []
    dropped: list[IntArray] = []
    for _ in range(_PASSES):
        table = topology.edge_table(surface.faces, len(surface.vertices))
        one, other = _gluing(surface, table)
        agreeing, flip = _orientable(surface, table, one, other)
        _, fan = topology.corner_fans(surface.faces, one[agreeing], other[agreeing])
        turned.append(surface.face_index[flip])
        before = len(surface.vertices)
        surface = _vertices_from_fans(surface, fan)
        surface = replace(surface, faces=topology.flipped(surface.faces, flip))
        doubled += len(surface.vertices) - before
        table = topology.edge_table(surface.faces, len(surface.vertices))
        crowded = table.face_count > 2
        if not crowded.any() and len(surface.vertices) == before:
            break
        if crowded.any():
            # Both ends of such an edge are still connected another way, so that cutting did not separate its faces.
            bad = np.zeros(len(surface.faces), dtype=bool)
            bad[np.flatnonzero(crowded[table.edge_of_half_edge]) % len(bad)] = True
            dropped.append(surface.face_index[bad])
            surface = surface.keep(~bad)
    table = topology.edge_table(surface.faces, len(surface.vertices))
    fans = topology.fan_counts(surface.faces, table, len(surface.vertices))
    left = int((table.face_count > 2).sum() + (fans > 1).sum())
    return Glued(surface, _gathered(turned), doubled, _gathered(dropped), left)


def _gathered(parts: list[IntArray]) -> IntArray:
    return np.concatenate([np.zeros(0, dtype=np.int64), *parts])


def _gluing(surface: Surface, table: topology.EdgeTable) -> tuple[IntArray, IntArray]:
    """Pairs of half-edges to glue: the two of a proper edge, and of crowded edges those that continue each other."""
    one, other = topology.paired_half_edges(table)
    around = table.face_count[table.edge_of_half_edge]
    free = np.flatnonzero((around > 2) & (around <= _MOST_AROUND))
    free = free[np.argsort(table.edge_of_half_edge[free], kind="stable")]
    _, patch = topology.face_components(table, len(surface.faces))
    away = _away_from_edge(surface)
    firsts, seconds = [one], [other]
    for attempt in range(_MOST_AROUND // 2):
        a, b = _pairs_on_same_edge(free, table.edge_of_half_edge)
        same_patch = patch[a % len(patch)] == patch[b % len(patch)]
        if attempt:
            # Beside the best pair only sheets that are one anyway go on across the edge.
            a, b, same_patch = a[same_patch], b[same_patch], same_patch[same_patch]
        if not len(a):
            break
        # Two sheets that lie on each other go on equally straight; each is turned one way.
        agreeing = table.forward[a] != table.forward[b]
        fit = 4.0 * same_patch + agreeing - np.einsum("ij,ij->i", away[a], away[b])
        order = np.lexsort((-fit, table.edge_of_half_edge[a]))
        best = order[np.unique(table.edge_of_half_edge[a[order]], return_index=True)[1]]
        firsts.append(a[best])
        seconds.append(b[best])
        free = free[~np.isin(free, np.concatenate([a[best], b[best]]))]
    return np.concatenate(firsts), np.concatenate(seconds)


def _away_from_edge(surface: Surface) -> NDArray[np.float64]:
    """(3m, 3) unit vector within the face, square to each half-edge; zero where the face has no area."""
    inside, _, _ = topology.boxed(surface.vertices)
    tail = inside[surface.faces.T.ravel()]
    along = inside[np.roll(surface.faces, -1, axis=1).T.ravel()] - tail
    across = inside[np.roll(surface.faces, -2, axis=1).T.ravel()] - tail
    length = np.maximum((along * along).sum(axis=1, keepdims=True), np.finfo(np.float64).tiny)
    across = across - along * (across * along).sum(axis=1, keepdims=True) / length
    norm = np.linalg.norm(across, axis=1, keepdims=True)
    return np.divide(across, norm, out=np.zeros_like(across), where=norm > 0)


def _pairs_on_same_edge(half_edges: IntArray, edge: IntArray) -> tuple[IntArray, IntArray]:
    """All pairs of half-edges, given sorted by edge, that lie on one edge."""
    firsts, seconds = [half_edges[:0]], [half_edges[:0]]
    for step in range(1, _MOST_AROUND):
        a, b = half_edges[:-step], half_edges[step:]
        together = edge[a] == edge[b]
        firsts.append(a[together])
        seconds.append(b[together])
    return np.concatenate(firsts), np.concatenate(seconds)


def _orientable(
    surface: Surface, table: topology.EdgeTable, one: IntArray, other: IntArray
) -> tuple[BoolArray, BoolArray]:
    """Which pairs (p,) to keep glued so that the surface has two sides, and which faces (m,) to flip."""
    n_faces = len(surface.faces)
    flip, twisted = topology.coherent_orientation(surface.faces, table, one, other)
    if not twisted.any():
        return np.ones(len(one), dtype=bool), flip
    a, b = one % n_faces, other % n_faces
    conflict = table.forward[one] == table.forward[other]
    crossed = conflict & twisted[a]
    if crossed.sum() <= FEW_CROSSED * twisted.sum():
        # As good as all faces are turned one way already: the few sides at which they are not are the seam.
        flip, _ = topology.coherent_orientation(surface.faces, table, one[~crossed], other[~crossed])
        return ~crossed, flip
    # A spanning tree of the faces can always be oriented; the pairs that then disagree are the seam to cut.
    tree = _spanning_pairs(n_faces, a, b)
    flip, _ = topology.coherent_orientation(surface.faces, table, one[tree], other[tree])
    conflict = (table.forward[one] ^ flip[a]) == (table.forward[other] ^ flip[b])
    return ~conflict, flip


def _spanning_pairs(n_faces: int, a: IntArray, b: IntArray) -> IntArray:
    """Numbers of the pairs (a, b) of faces that form a spanning forest, short in steps."""
    root_edges = np.unique(topology.graph_components(n_faces, a, b)[1], return_index=True)[1]
    # One extra node is joined to a face of every component, so that a single breadth-first tree reaches all.
    first = np.concatenate([a, np.full(len(root_edges), n_faces)])
    second = np.concatenate([b, root_edges])
    graph = coo_matrix((np.ones(len(first)), (first, second)), shape=(n_faces + 1, n_faces + 1)).tocsr()
    tree = breadth_first_tree(graph, n_faces, directed=False).tocoo()
    low, high = np.minimum(tree.row, tree.col).astype(np.int64), np.maximum(tree.row, tree.col).astype(np.int64)
    wanted = np.unique((low * (n_faces + 1) + high)[high < n_faces])
    keys, index = np.unique(np.minimum(a, b) * np.int64(n_faces + 1) + np.maximum(a, b), return_index=True)
    return index[np.isin(keys, wanted)]


def _vertices_from_fans(surface: Surface, fan: IntArray) -> Surface:
    """The surface whose vertices are the fans (m, 3) of corners, ordered as the vertices that they come from."""
    count = int(fan.max()) + 1
    vertex = np.zeros(count, dtype=np.int64)
    vertex[fan.ravel()] = surface.faces.ravel()
    order = np.argsort(vertex, kind="stable")
    place = np.zeros(count, dtype=np.int64)
    place[order] = np.arange(count)
    origin = vertex[order]
    return replace(surface, vertices=surface.vertices[origin], faces=place[fan], file_index=surface.file_index[origin])
