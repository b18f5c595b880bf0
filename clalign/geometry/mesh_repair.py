"""Make a usable surface out of a defective mesh, with the way back to its file's vertex numbers.

The mesh is taken apart into faces and glued together again along those sides only where that gives a surface: sides
with exactly two faces, and from crowded edges the two that belong to the same patch (so a body survives when a fin is
cut off it). The corners that are then connected around a point are the vertices of the result, which splits pinched
points and non-manifold edges in one step.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_tree

from clalign.errors import MeshError
from clalign.geometry import mesh_topology as topology
from clalign.geometry.mesh_checks import MAX_COORDINATE, bare_vertices, diagnose, mesh_arrays, pieces_by_area
from clalign.geometry.mesh_defects import Surface
from clalign.geometry.mesh_topology import BoolArray, IntArray

_PASSES = 10


@dataclass(frozen=True)
class Repaired:
    """A mesh that loads without complaint."""

    vertices: NDArray[np.float64]
    """(n, 3) positions, unchanged."""
    faces: NDArray[np.int32]
    """(m, 3) consistently oriented; outward where there is an inside."""
    file_index: NDArray[np.int64]
    """(n,) the given number of every vertex; a number appears several times where the surface was cut open."""
    notes: tuple[str, ...]
    """What was changed, as sentences for the user; empty if nothing was."""


def repair(vertices: ArrayLike, faces: ArrayLike, *, merge: bool = False) -> Repaired:
    """Drop, cut and turn whatever keeps a mesh from being one oriented surface.

    Parameters
    ----------
    vertices : (n, 3) float
    faces : (m, 3) int
    merge : bool
        first join vertices at exactly equal positions.

    Returns
    -------
    Repaired

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
    surface = _without_degenerate(surface, notes)
    if len(surface.faces):
        surface = _glued(surface, notes)
        surface = _largest_piece(surface, notes)
    diagnosis = diagnose(surface.vertices, surface.faces)
    if diagnosis.refused or diagnosis.surface is None:
        reasons = "; ".join(defect.problem for defect in diagnosis.refused)
        raise MeshError(f"the mesh cannot be repaired; after {'; '.join(notes) or 'no changes'}: {reasons}")
    final = diagnosis.surface
    notes += diagnosis.notes
    origin = surface.file_index[final.file_index]
    lost = len(points) - len(np.unique(origin))
    if lost:
        notes.append(f"{lost} of the {len(points)} given vertices are not in the result")
    return Repaired(final.vertices, final.faces.astype(np.int32), origin, tuple(notes))


def _readable(surface: Surface, notes: list[str]) -> Surface:
    """Drop faces that name missing vertices or vertices without usable coordinates."""
    n = len(surface.vertices)
    known: BoolArray = np.all((surface.faces >= 0) & (surface.faces < n), axis=1)
    _note(notes, ~known, "faces with vertex numbers out of range dropped")
    sound = np.isfinite(surface.vertices).all(axis=1) & (np.abs(surface.vertices) <= MAX_COORDINATE).all(axis=1)
    placed = known.copy()
    placed[known] = sound[surface.faces[known]].all(axis=1)
    _note(notes, known & ~placed, "faces at NaN, infinite or giant coordinates dropped")
    kept = replace(surface, faces=np.where(placed[:, None], surface.faces, 0)) if n else surface
    return kept.keep(placed)


def _merged(surface: Surface, notes: list[str]) -> Surface:
    """Join vertices at equal positions; each keeps the lowest of their numbers."""
    first, merged = topology.merge_positions(surface.vertices)
    count = len(surface.vertices) - len(first)
    if count:
        notes.append(f"{count} vertices joined to others at the same position")
    return Surface(surface.vertices[first], merged[surface.faces], surface.file_index[first], surface.face_index)


def _without_degenerate(surface: Surface, notes: list[str]) -> Surface:
    """Drop faces with repeated corners, repeated faces, and the flat faces around vertices without area."""
    a, b, c = surface.faces.T
    repeated: BoolArray = np.asarray((a == b) | (b == c) | (c == a))
    _note(notes, repeated, "faces that name a vertex twice dropped")
    surface = surface.keep(~repeated)
    double = topology.duplicate_faces(surface.faces)
    _note(notes, double, "repeated faces dropped")
    surface = surface.keep(~double)
    if not len(surface.faces):
        return surface
    bare, _ = bare_vertices(surface)
    flat = bare[surface.faces].any(axis=1)
    _note(notes, flat, "zero-area faces around vertices without area dropped")
    return surface.keep(~flat)


def _glued(surface: Surface, notes: list[str]) -> Surface:
    """Take the faces apart and glue them to a manifold, orientable surface, turning faces where needed."""
    for _ in range(_PASSES):
        table = topology.edge_table(surface.faces, len(surface.vertices))
        one, other = _gluing(table, len(surface.faces))
        agreeing, turn = _orientable(surface, table, one, other)
        _, fan = topology.corner_fans(surface.faces, one[agreeing], other[agreeing])
        _note(notes, turn, "faces turned round to agree with the others")
        before = len(surface.vertices)
        surface = _vertices_from_fans(surface, fan)
        surface = replace(surface, faces=topology.turned(surface.faces, turn))
        if len(surface.vertices) > before:
            notes.append(f"cut open where it was no surface: {len(surface.vertices) - before} vertices doubled")
        table = topology.edge_table(surface.faces, len(surface.vertices))
        crowded = table.face_count > 2
        if not crowded.any() and len(surface.vertices) == before:
            return surface
        if crowded.any():
            # Both ends of such an edge are still connected another way, so that cutting did not separate its faces.
            bad = np.zeros(len(surface.faces), dtype=bool)
            bad[np.flatnonzero(crowded[table.edge_of_half_edge]) % len(bad)] = True
            _note(notes, bad, "faces at edges that could not be cut dropped")
            surface = surface.keep(~bad)
    return surface


def _gluing(table: topology.EdgeTable, n_faces: int) -> tuple[IntArray, IntArray]:
    """Pairs of half-edges to glue: the two of every proper edge, and of crowded ones the only two of a patch."""
    one, other = topology.paired_half_edges(table)
    crowded = np.flatnonzero(table.face_count[table.edge_of_half_edge] > 2)
    if not len(crowded):
        return one, other
    _, patch = topology.face_components(table, n_faces)
    keys = table.edge_of_half_edge[crowded] * np.int64(n_faces) + patch[crowded % n_faces]
    order = np.argsort(keys, kind="stable")
    _, start, counts = np.unique(keys[order], return_index=True, return_counts=True)
    twos = start[counts == 2]
    return np.concatenate([one, crowded[order[twos]]]), np.concatenate([other, crowded[order[twos + 1]]])


def _orientable(
    surface: Surface, table: topology.EdgeTable, one: IntArray, other: IntArray
) -> tuple[BoolArray, BoolArray]:
    """Which pairs (p,) to keep glued so that the surface has two sides, and which faces (m,) to turn."""
    n_faces = len(surface.faces)
    turn, twisted = topology.coherent_orientation(surface.faces, table, one, other)
    if not twisted.any():
        return np.ones(len(one), dtype=bool), turn
    # A spanning tree of the faces can always be oriented; the pairs that then disagree are the seam to cut.
    a, b = one % n_faces, other % n_faces
    tree = _spanning_pairs(n_faces, a, b)
    turn, _ = topology.coherent_orientation(surface.faces, table, one[tree], other[tree])
    conflict = (table.forward[one] ^ turn[a]) == (table.forward[other] ^ turn[b])
    return ~conflict, turn


def _spanning_pairs(n_faces: int, a: IntArray, b: IntArray) -> IntArray:
    """Numbers of the pairs (a, b) of faces that form a spanning forest, short in steps."""
    root_edges = np.unique(topology.graph_pieces(n_faces, a, b)[1], return_index=True)[1]
    # One extra node is joined to a face of every piece, so that a single breadth-first tree reaches all.
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
    return Surface(surface.vertices[origin], place[fan], surface.file_index[origin], surface.face_index)


def _largest_piece(surface: Surface, notes: list[str]) -> Surface:
    """Keep the piece with the largest area."""
    count, piece, areas = pieces_by_area(surface)
    if count == 1:
        return surface
    largest = int(np.argmax(areas))
    share = 100 * areas[largest] / areas.sum()
    notes.append(f"{count - 1} smaller pieces dropped; the largest has {share:.4g} % of the area")
    return surface.keep(piece == largest)


def _note(notes: list[str], bad: BoolArray, what: str) -> None:
    """Add a sentence if anything is marked."""
    if bad.any():
        notes.append(f"{int(bad.sum())} {what}")
