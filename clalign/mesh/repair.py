"""Make a usable surface out of a defective mesh, with the way back to its file's vertex numbers.

The mesh is taken apart into faces and glued together again along those sides only where that gives a surface: sides
with exactly two faces, and of crowded edges those that belong to one patch or continue each other most straightly (so
a body survives when a fin or an inner wall is cut off it). The corners that are then connected around a point are the
vertices of the result, which splits pinched points and non-manifold edges in one step.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_tree

from clalign.errors import MeshError
from clalign.mesh import topology
from clalign.mesh.checks import MAX_COORDINATE, bare_vertices, components_by_area, diagnose, mesh_arrays
from clalign.mesh.defects import Surface
from clalign.mesh.topology import BoolArray, IntArray

_PASSES = 10
_MOST_AROUND = 16
"""Edges with more faces than this are cut without looking for the faces that continue each other."""


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
    area_share: float
    """Area that is left, as a part of that of all faces that have one."""
    merge_advice: str
    """What joining vertices at equal positions may mend, where that was not done and would join any; else empty."""


def repair(vertices: ArrayLike, faces: ArrayLike, *, merge: bool = False) -> Repaired:
    """Drop, cut and flip whatever keeps a mesh, (n, 3) and (m, 3), from being one oriented surface.

    merge : first join vertices at exactly equal positions.

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
    advice = "" if merge or not _has_doubles(surface) else "add --merge to join vertices at equal positions"
    surface = sound = _without_degenerate(surface, notes)
    if len(surface.faces):
        surface = _glued(surface, notes)
        surface = _largest_component(surface, notes)
    diagnosis = diagnose(surface.vertices, surface.faces)
    if diagnosis.refused or diagnosis.surface is None:
        reasons = "; ".join(defect.problem for defect in diagnosis.refused)
        changes = "; ".join(notes) or "no changes"
        way_out = f"; {advice}" if advice else ""
        raise MeshError(f"the mesh cannot be repaired; after {changes}: {reasons}{way_out}")
    final = diagnosis.surface
    notes += diagnosis.notes
    origin = surface.file_index[final.file_index]
    lost = len(points) - len(np.unique(origin))
    if lost:
        notes.append(f"{lost} of the {len(points)} given vertices are not in the result")
    share = _area_share(sound, surface.face_index[final.face_index])
    return Repaired(final.vertices, final.faces.astype(np.int32), origin, tuple(notes), share, advice)


def _has_doubles(surface: Surface) -> bool:
    return len(topology.merge_positions(surface.vertices)[0]) < len(surface.vertices)


def _area_share(surface: Surface, kept: IntArray) -> float:
    """Area of the faces with the given numbers `kept`, as a part of all."""
    areas = topology.face_areas(topology.boxed(surface.vertices)[0], surface.faces)
    return float(areas[np.isin(surface.face_index, kept)].sum() / areas.sum())


def _readable(surface: Surface, notes: list[str]) -> Surface:
    """Drop faces that name missing vertices or vertices without usable coordinates."""
    n = len(surface.vertices)
    known: BoolArray = np.all((surface.faces >= 0) & (surface.faces < n), axis=1)
    _note(notes, ~known, "faces with vertex numbers out of range dropped")
    # NaN compares false, so that it fails here as well.
    sound: BoolArray = np.all(np.abs(surface.vertices) <= MAX_COORDINATE, axis=1)
    placed: BoolArray = known.copy()
    placed[known] = np.all(sound[surface.faces[known]], axis=1)
    _note(notes, known & ~placed, "faces at NaN, infinite or giant coordinates dropped")
    return surface.keep(placed)


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
    double: BoolArray = topology.duplicate_faces(surface.faces)
    _note(notes, double, "repeated faces dropped")
    surface = surface.keep(~double)
    if not len(surface.faces):
        return surface
    bare, _ = bare_vertices(surface)
    flat: BoolArray = np.any(bare[surface.faces], axis=1)
    _note(notes, flat, "zero-area faces around vertices without area dropped")
    return surface.keep(~flat)


def _glued(surface: Surface, notes: list[str]) -> Surface:
    """Take the faces apart and glue them to a manifold, orientable surface, flipping faces where needed."""
    for _ in range(_PASSES):
        table = topology.edge_table(surface.faces, len(surface.vertices))
        one, other = _gluing(surface, table)
        agreeing, flip = _orientable(surface, table, one, other)
        _, fan = topology.corner_fans(surface.faces, one[agreeing], other[agreeing])
        _note(notes, flip, "faces turned round to agree with the others")
        before = len(surface.vertices)
        surface = _vertices_from_fans(surface, fan)
        surface = replace(surface, faces=topology.flipped(surface.faces, flip))
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
        straight = 4.0 * same_patch - np.einsum("ij,ij->i", away[a], away[b])
        order = np.lexsort((-straight, table.edge_of_half_edge[a]))
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
    # A spanning tree of the faces can always be oriented; the pairs that then disagree are the seam to cut.
    a, b = one % n_faces, other % n_faces
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
    return Surface(surface.vertices[origin], place[fan], surface.file_index[origin], surface.face_index)


def _largest_component(surface: Surface, notes: list[str]) -> Surface:
    """Keep the component with the largest area."""
    count, component, areas = components_by_area(surface)
    if count == 1:
        return surface
    largest = int(np.argmax(areas))
    share = 100 * areas[largest] / areas.sum()
    dropped = "1 smaller piece" if count == 2 else f"{count - 1} smaller pieces"
    notes.append(f"{dropped} dropped; the largest has {share:.4g} % of the area")
    return surface.keep(component == largest)


def _note(notes: list[str], bad: BoolArray, what: str) -> None:
    """Add a sentence if anything is marked."""
    if bad.any():
        notes.append(f"{int(bad.sum())} {what}")
