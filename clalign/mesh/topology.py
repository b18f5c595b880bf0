"""Edges, fans, components, areas and normals of a triangle mesh, as functions over its two arrays.

Every function is vectorised and takes `vertices` (n, 3) float and `faces` (m, 3) int, which must be valid numbers of
vertices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csgraph

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

CAP_AREA = 0.1
"""Holes whose flat caps take less than this part of the area leave no doubt about which side is outside."""


@dataclass(frozen=True)
class EdgeTable:
    """The edges of a mesh and the half-edges (sides of faces) that lie on them.

    Half-edge `c * m + f` runs along face `f` from its corner `c` to the next one.
    """

    edges: IntArray
    """(e, 2) vertex pairs, smaller number first, in lexicographic order."""
    edge_of_half_edge: IntArray
    """(3m,) the edge that a half-edge lies on."""
    face_count: IntArray
    """(e,) faces on each edge: 1 on the boundary, 2 inside a surface."""
    forward: BoolArray
    """(3m,) True where the half-edge runs from the smaller vertex number to the larger one."""


def edge_table(faces: NDArray[np.integer], n_vertices: int) -> EdgeTable:
    """Gather the half-edges of `faces` (m, 3) into edges; O(m log m)."""
    faces = np.asarray(faces, dtype=np.int64)
    tail = faces.T.ravel()
    head = np.roll(faces, -1, axis=1).T.ravel()
    forward = tail < head
    keys = np.minimum(tail, head) * np.int64(n_vertices) + np.maximum(tail, head)
    unique, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
    edges = np.stack([unique // n_vertices, unique % n_vertices], axis=1) if len(unique) else np.zeros((0, 2), np.int64)
    return EdgeTable(edges, inverse.reshape(-1).astype(np.int64), counts.astype(np.int64), forward)


def paired_half_edges(table: EdgeTable) -> tuple[IntArray, IntArray]:
    """Both half-edges of every edge with exactly two faces: two (p,) arrays, in the order of the edges."""
    order = np.argsort(table.edge_of_half_edge, kind="stable")
    start = np.concatenate([[0], np.cumsum(table.face_count)[:-1]]).astype(np.int64)
    first = start[table.face_count == 2]
    return order[first], order[first + 1]


def boundary_edges(faces: NDArray[np.integer], n_vertices: int) -> IntArray:
    """(b, 2) edges that belong to one face only, directed as in that face."""
    table = edge_table(faces, n_vertices)
    lonely = table.face_count[table.edge_of_half_edge] == 1
    tail = np.asarray(faces, dtype=np.int64).T.ravel()
    head = np.roll(np.asarray(faces, dtype=np.int64), -1, axis=1).T.ravel()
    return np.stack([tail[lonely], head[lonely]], axis=1)


def boundary_vertices(faces: NDArray[np.integer], n_vertices: int) -> BoolArray:
    """(n,) True for the vertices on the boundary."""
    on_boundary = np.zeros(n_vertices, dtype=bool)
    on_boundary[boundary_edges(faces, n_vertices).ravel()] = True
    return on_boundary


def face_normals(vertices: FloatArray, faces: NDArray[np.integer]) -> FloatArray:
    """(m, 3) cross products of two sides: twice the area long, right-handed."""
    origin = vertices[faces[:, 0]]
    return np.cross(vertices[faces[:, 1]] - origin, vertices[faces[:, 2]] - origin)


def face_areas(vertices: FloatArray, faces: NDArray[np.integer]) -> FloatArray:
    """(m,) area of each face, in the squared unit of the vertices."""
    return 0.5 * np.linalg.norm(face_normals(vertices, faces), axis=1)


def side_lengths(vertices: FloatArray, faces: NDArray[np.integer]) -> FloatArray:
    """(m, 3) length of the side of each face that ends at each of its corners."""
    corners = vertices[faces]
    return np.asarray(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2), dtype=np.float64)


def vertex_areas(vertices: FloatArray, faces: NDArray[np.integer]) -> FloatArray:
    """(n,) a third of the area of the faces around each vertex; sums to the total area."""
    areas: FloatArray = np.repeat(face_areas(vertices, faces) / 3.0, 3)
    return np.bincount(np.asarray(faces).ravel(), weights=areas, minlength=len(vertices)).astype(np.float64)


def vertex_normals(vertices: FloatArray, faces: NDArray[np.integer]) -> FloatArray:
    """(n, 3) area-weighted unit normals; zero where a vertex has no area."""
    normals = face_normals(vertices, faces)
    flat = np.asarray(faces).ravel()
    around = [np.bincount(flat, weights=np.repeat(column, 3), minlength=len(vertices)) for column in normals.T]
    summed = np.stack(around, axis=1)
    length = np.linalg.norm(summed, axis=1, keepdims=True)
    return np.divide(summed, length, out=np.zeros(summed.shape), where=length > 0)


def connected_components(faces: NDArray[np.integer], n_vertices: int) -> tuple[int, IntArray]:
    """Count the components joined by shared vertices, and label each vertex (n,); a lone vertex is one."""
    tail = np.asarray(faces).ravel()
    head = np.roll(np.asarray(faces), -1, axis=1).ravel()
    return graph_components(n_vertices, tail, head)


def face_components(table: EdgeTable, n_faces: int) -> tuple[int, IntArray]:
    """Count the patches of faces joined across edges with exactly two faces, and label each face (m,)."""
    one, other = paired_half_edges(table)
    return graph_components(n_faces, one % n_faces, other % n_faces)


def corner_fans(faces: NDArray[np.integer], one: IntArray, other: IntArray) -> tuple[int, IntArray]:
    """Join the corners of faces that are glued along pairs of half-edges into fans.

    Parameters
    ----------
    faces : (m, 3) int
    one, other : (p,) int, half-edges glued to each other (see `EdgeTable`).

    Returns
    -------
    count, fan : int, (m, 3) int
        On a manifold each vertex has one fan; with fewer pairs the fans are the vertices of the surface cut open.
    """
    faces = np.asarray(faces, dtype=np.int64)
    n_faces = len(faces)
    tail = faces.T.ravel()
    following = (np.arange(3 * n_faces) + n_faces) % max(3 * n_faces, 1)
    same_way = tail[one] == tail[other]
    first = np.concatenate([one, following[one]])
    second = np.concatenate([np.where(same_way, other, following[other]), np.where(same_way, following[other], other)])
    count, label = graph_components(3 * n_faces, first, second)
    return count, label.reshape(3, n_faces).T


def fan_counts(faces: NDArray[np.integer], table: EdgeTable, n_vertices: int) -> IntArray:
    """Count the fans of faces around each vertex (n,): 1 on a manifold, more where sheets touch, 0 if unreferenced."""
    count, fan = corner_fans(faces, *paired_half_edges(table))
    vertex_of_fan = np.zeros(count, dtype=np.int64)
    vertex_of_fan[fan.ravel()] = np.asarray(faces).ravel()
    return np.bincount(vertex_of_fan, minlength=n_vertices).astype(np.int64)


def coherent_orientation(
    faces: NDArray[np.integer], table: EdgeTable, one: IntArray, other: IntArray
) -> tuple[BoolArray, BoolArray]:
    """Find which faces to flip so that glued faces agree, flipping as few as possible in each patch.

    The patches of the double cover (every face in both orientations) come in pairs; a patch that is joined to its own
    reverse cannot be oriented.

    Parameters
    ----------
    faces, table : (m, 3) int, and their edges.
    one, other : (p,) int, half-edges glued to each other.

    Returns
    -------
    flip, twisted : (m,) bool each; faces to reverse, and faces of patches that have no orientation.
    """
    n_faces = len(faces)
    a, b = one % n_faces, other % n_faces
    conflict = table.forward[one] == table.forward[other]
    first = np.concatenate([a, a + n_faces])
    second = np.concatenate([np.where(conflict, b + n_faces, b), np.where(conflict, b, b + n_faces)])
    count, label = graph_components(2 * n_faces, first, second)
    kept = np.bincount(label[:n_faces], minlength=count)
    reversed_ = np.bincount(label[n_faces:], minlength=count)
    twisted = label[:n_faces] == label[n_faces:]
    mine, mirror = label[:n_faces], label[n_faces:]
    votes = kept[mine] - reversed_[mine]
    flip = np.where(votes == 0, mine > mirror, votes < 0) & ~twisted
    return flip, twisted


def signed_volume(vertices: FloatArray, faces: NDArray[np.integer]) -> float:
    """Volume enclosed by a closed surface, positive if its faces point outward."""
    corners = vertices[faces]
    return float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) / 6.0


def merge_positions(points: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Find points (n, 3) with bitwise equal positions (0.0 and -0.0 count as equal).

    Returns
    -------
    first : (u,) int, the first point at every position, ascending.
    merged : (n,) int, for every point, which of the u positions it lies at.
    """
    key = np.zeros(len(points), dtype=np.int64)
    for axis in range(points.shape[1]):
        values, rank = np.unique(points[:, axis] + 0.0, return_inverse=True)
        _, key = np.unique(key * len(values) + rank.reshape(-1), return_inverse=True)
        key = key.reshape(-1).astype(np.int64)
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    order = np.argsort(first)
    place = np.zeros(len(first), dtype=np.int64)
    place[order] = np.arange(len(first))
    return first[order].astype(np.int64), place[inverse.reshape(-1)]


def outward_sign(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> int:
    """+1 if the faces of an oriented surface point outward, -1 if inward, 0 if a boundary leaves it open.

    Small holes are closed with flat caps, so that a body with a missing patch still has an inside.
    """
    inside, _, _ = boxed(vertices)
    edges = boundary_edges(faces, len(vertices))
    volume = signed_volume(inside, faces)
    if len(edges):
        count, label = edge_loops(edges)
        summed = np.stack([np.bincount(label, weights=inside[edges[:, 0], axis]) for axis in range(3)], axis=1)
        tips = summed / np.bincount(label, minlength=count)[:, None]
        caps = np.stack([inside[edges[:, 1]], inside[edges[:, 0]], tips[label]], axis=1).reshape(-1, 3)
        cap_faces = np.arange(len(caps)).reshape(-1, 3)
        if face_areas(caps, cap_faces).sum() > CAP_AREA * face_areas(inside, faces).sum():
            return 0
        volume += signed_volume(caps, cap_faces)
    # A flat pillow has no inside either; rounding must not choose one.
    return 0 if abs(volume) < 1e-9 else int(np.sign(volume))


def flipped(faces: NDArray[np.int64], flip: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Copy of `faces` (m, 3) with the marked ones reversed."""
    return np.where(flip[:, None], faces[:, [0, 2, 1]], faces)


def repeated_corners(faces: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(m,) True for every face that names a vertex twice."""
    return np.any(faces == np.roll(faces, 1, axis=1), axis=1)


def duplicate_faces(faces: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(m,) True for every face on the same three vertices as an earlier one, in whatever order."""
    corners = np.sort(faces, axis=1)
    order = np.lexsort((np.arange(len(faces)), corners[:, 2], corners[:, 1], corners[:, 0]))
    repeated = (np.diff(corners[order], axis=0) == 0).all(axis=1)
    bad = np.zeros(len(faces), dtype=bool)
    bad[order[1:][repeated]] = True
    return bad


def edge_loops(edges: NDArray[np.int64]) -> tuple[int, NDArray[np.int64]]:
    """Number of connected components of an edge list (b, 2), and the component of every edge."""
    numbers, compact = np.unique(edges, return_inverse=True)
    compact = compact.reshape(-1, 2)
    count, label = graph_components(len(numbers), compact[:, 0], compact[:, 1])
    return count, label[compact[:, 0]]


def boxed(vertices: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Bring the bounding box to the range -1 to 1, so that squares and products of coordinates stay within float64.

    Returns
    -------
    inside, middle, extent : (n, 3), (3,) and float, half the longest side of the box.
        `vertices == inside * extent + middle` up to rounding.
    """
    middle = 0.5 * vertices.min(axis=0) + 0.5 * vertices.max(axis=0)
    extent = float(np.abs(vertices - middle).max())
    return (vertices - middle) / (extent if extent > 0 else 1.0), middle, extent


def graph_components(n_nodes: int, first: NDArray[np.integer], second: NDArray[np.integer]) -> tuple[int, IntArray]:
    """Connected components of an undirected graph given by its edge list."""
    graph = coo_matrix((np.ones(len(first)), (first, second)), shape=(n_nodes, n_nodes))
    count, label = csgraph.connected_components(graph, directed=False)
    return int(count), label.astype(np.int64)
