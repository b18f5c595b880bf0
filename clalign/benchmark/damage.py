"""Meshes as people have them: damaged in known ways, with where every vertex went."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, cKDTree

from clalign.benchmark.perturb import nearest_on_the_same_side, simplified
from clalign.mesh.topology import edge_table, face_areas, face_normals, vertex_normals

Vertices = NDArray[np.float64]
Faces = NDArray[np.int64]

TOUCHING = 5
FINS = 40
SHELLS = 5
HOLES = 10
SPLIT = 200
SLIVER = 1e-6
"""How far from a side the new vertex of a sliver lies, in lengths of the side."""
NEEDLE = 1e-4
"""How far from an end of a side the new vertex of a needle lies, in lengths of the side."""
TURNED = 0.02
SAMPLED = 10_000
NEAREST = 6
"""Points among which a vertex finds the one that is its own on the same side."""
COARSE = 0.1
"""Share of the vertices of a coarse copy."""
REFINED = 0.04
"""Share of the faces that are refined three times, to 1/64 of their area."""


@dataclass(frozen=True)
class Damaged:
    """A damaged mesh.

    vertices, faces : (n', 3) float64 and (m', 3) int64.
    new_of_old : (n,) int64, the vertex here of every vertex of the sound mesh; -1 for one that has gone.
    """

    vertices: Vertices
    faces: Faces
    new_of_old: NDArray[np.int64]


def pinched(vertices: Vertices, faces: Faces, rng: np.random.Generator) -> Damaged:
    """Make sheets touch: vertices near each other in space that are no near neighbours become one."""
    n = len(vertices)
    around = edge_table(faces, n).edges
    step = np.linalg.norm(vertices[around[:, 0]] - vertices[around[:, 1]], axis=1).mean()
    normals = vertex_normals(vertices, faces)
    pairs = cKDTree(vertices).query_pairs(6 * step, output_type="ndarray")
    pairs = pairs[np.einsum("ij,ij->i", normals[pairs[:, 0]], normals[pairs[:, 1]]) < -0.5]
    gaps = np.linalg.norm(vertices[pairs[:, 0]] - vertices[pairs[:, 1]], axis=1)
    new_of_old, used = np.arange(n), np.zeros(n, dtype=bool)
    count = 0
    for a, b in pairs[np.argsort(gaps)]:
        if used[[a, b]].any():
            continue
        ring = np.unique(faces[np.isin(faces, (a, b)).any(axis=1)])
        if not used[ring].any():
            new_of_old[b] = a
            used[ring] = True
            count += 1
            if count == TOUCHING:
                break
    return Damaged(vertices, new_of_old[faces], new_of_old)


def finned(vertices: Vertices, faces: Faces, rng: np.random.Generator) -> Damaged:
    """Put triangles on edges that have two faces already."""
    n = len(vertices)
    table = edge_table(faces, n)
    chosen = rng.choice(np.flatnonzero(table.face_count == 2), size=FINS, replace=False)
    ends = table.edges[chosen]
    length = np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1)
    tips = vertices[ends].mean(axis=1) + length[:, None] * vertex_normals(vertices, faces)[ends[:, 0]]
    fins = np.column_stack([ends, n + np.arange(FINS)])
    return Damaged(np.concatenate([vertices, tips]), np.concatenate([faces, fins]), np.arange(n))


def unwelded(vertices: Vertices, faces: Faces, rng: np.random.Generator) -> Damaged:
    """Give every triangle vertices of its own."""
    corner = np.full(len(vertices), -1, dtype=np.int64)
    corner[faces.ravel()] = np.arange(faces.size)
    return Damaged(vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3), corner)


def shelled(vertices: Vertices, faces: Faces, rng: np.random.Generator) -> Damaged:
    """Put small balls of 26 vertices beside the surface."""
    n, extent = len(vertices), float(np.ptp(vertices, axis=0).max())
    directions = np.stack(np.meshgrid(*[np.arange(3.0) - 1] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    directions = directions[np.abs(directions).max(axis=1) == 1]
    ball = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    ball_faces = ConvexHull(ball).simplices.astype(np.int64)
    centres = vertices[rng.integers(0, n, SHELLS)] + 0.05 * extent * rng.standard_normal((SHELLS, 3))
    points = [vertices, *(centre + 0.01 * extent * ball for centre in centres)]
    sides = [faces, *(ball_faces + n + number * len(ball) for number in range(SHELLS))]
    return Damaged(np.concatenate(points), np.concatenate(sides), np.arange(n))


def holed(vertices: Vertices, faces: Faces, rng: np.random.Generator) -> Damaged:
    """Take away the faces around a few vertices."""
    gone = rng.choice(len(vertices), size=HOLES, replace=False)
    new_of_old = np.arange(len(vertices))
    new_of_old[gone] = -1
    return Damaged(vertices, faces[~np.isin(faces, gone).any(axis=1)], new_of_old)


def slivered(vertices: Vertices, faces: Faces, rng: np.random.Generator) -> Damaged:
    """Cut faces at points that almost lie on a side."""
    n = len(vertices)
    chosen = rng.choice(len(faces), size=SPLIT, replace=False)
    a, b, c = faces[chosen].T
    middle = 0.5 * (vertices[a] + vertices[b])
    points = middle + SLIVER * (vertices[c] - middle)
    new = n + np.arange(SPLIT)
    parts = [np.stack(part, axis=1) for part in ((a, b, new), (b, c, new), (c, a, new))]
    kept = np.delete(faces, chosen, axis=0)
    return Damaged(np.concatenate([vertices, points]), np.concatenate([kept, *parts]), np.arange(n))


def needled(vertices: Vertices, faces: Faces, rng: np.random.Generator) -> Damaged:
    """Cut edges, with the faces on both sides, very near one of their ends."""
    return _cut_edges(vertices, faces, rng, NEEDLE, both_sides=True)


def junctioned(vertices: Vertices, faces: Faces, rng: np.random.Generator) -> Damaged:
    """Cut edges in the middle with the face on one side only, so that T-junctions come about."""
    return _cut_edges(vertices, faces, rng, 0.5, both_sides=False)


def _cut_edges(
    vertices: Vertices, faces: Faces, rng: np.random.Generator, share: float, *, both_sides: bool
) -> Damaged:
    """Cut edges whose faces are not cut yet at a share of their length, with one of their faces or both."""
    n, m = len(vertices), len(faces)
    table = edge_table(faces, n)
    order = np.argsort(table.edge_of_half_edge, kind="stable")
    first = np.concatenate([[0], np.cumsum(table.face_count)[:-1]])
    busy, points, parts = np.zeros(m, dtype=bool), [vertices], [faces.copy()]
    count = 0
    for edge in rng.permutation(np.flatnonzero(table.face_count == 2)):
        sides = order[first[edge] : first[edge] + 2]
        if busy[sides % m].any() or count == SPLIT:
            continue
        busy[sides % m] = True
        low, high = table.edges[edge]
        points.append(((1 - share) * vertices[low] + share * vertices[high])[None])
        for side in sides if both_sides else sides[:1]:
            face, corner = side % m, side // m
            head = (corner + 1) % 3
            rest = faces[face].copy()
            rest[corner] = n + count
            parts[0][face, head] = n + count
            parts.append(rest[None])
        count += 1
    return Damaged(np.concatenate(points), np.concatenate(parts), np.arange(n))


def coarse(vertices: Vertices, faces: Faces, rng: np.random.Generator) -> Damaged:
    """Leave a tenth of the vertices; each old one belongs to the nearest that faces the same way.

    Raises
    ------
    InputError
        The package fast-simplification is not installed.
    """
    points, sides = simplified(vertices, faces, COARSE)
    normals = vertex_normals(points, sides), vertex_normals(vertices, faces)
    return Damaged(points, sides, nearest_on_the_same_side(points, normals[0], vertices, normals[1], NEAREST))


def uneven(vertices: Vertices, faces: Faces, rng: np.random.Generator) -> Damaged:
    """Refine one place three times: faces there have 1/64 of their area."""
    middle = vertices[faces].mean(axis=1)
    centre = middle[rng.integers(0, len(faces))]
    order = np.argsort(np.linalg.norm(middle - centre, axis=1))
    areas = face_areas(vertices, faces)[order]
    marked = np.zeros(len(faces), dtype=bool)
    marked[order[np.cumsum(areas) <= REFINED * areas.sum()]] = True
    n = len(vertices)
    for _ in range(3):
        vertices, faces, marked = _refined(vertices, faces, marked)
    return Damaged(vertices, faces, np.arange(n))


def _refined(vertices: Vertices, faces: Faces, marked: NDArray[np.bool_]) -> tuple[Vertices, Faces, NDArray[np.bool_]]:
    """Cut marked faces into four and their neighbours so that they fit; the small faces in marked ones are marked."""
    n, m = len(vertices), len(faces)
    table = edge_table(faces, n)
    cut = np.zeros(len(table.edges), dtype=bool)
    cut[table.edge_of_half_edge.reshape(3, m)[:, marked]] = True
    place = n + np.cumsum(cut) - 1
    on_side = np.where(cut, place, -1)[table.edge_of_half_edge].reshape(3, m).T
    points = np.concatenate([vertices, vertices[table.edges[cut]].mean(axis=1)])
    parts, inside = [], []
    for face, sides, inner in zip(faces.tolist(), on_side.tolist(), marked.tolist(), strict=True):
        pieces = _pieces(face, sides)
        parts += pieces
        inside += [inner] * len(pieces)
    return points, np.array(parts, dtype=np.int64), np.array(inside)


def _pieces(face: list[int], sides: list[int]) -> list[list[int]]:
    """Triangles of one face, some of whose sides (from each corner to the next) have a vertex in the middle, or -1."""
    a, b, c = face
    ab, bc, ca = sides
    cuts = sum(side >= 0 for side in sides)
    if cuts == 3:
        return [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
    if cuts == 0:
        return [face]
    if cuts == 1:
        turn = next(number for number, side in enumerate(sides) if side >= 0)
        a, b, c = face[turn:] + face[:turn]
        return [[a, sides[turn], c], [sides[turn], b, c]]
    turn = next(number for number, side in enumerate(sides) if side < 0)
    # The side from a to b is whole; those to c are cut.
    a, b, c = face[turn:] + face[:turn]
    bc, ca = sides[(turn + 1) % 3], sides[(turn + 2) % 3]
    return [[bc, c, ca], [a, b, bc], [a, bc, ca]]


def turned(vertices: Vertices, faces: Faces, rng: np.random.Generator) -> Damaged:
    """Reverse some of the faces."""
    chosen = rng.choice(len(faces), size=int(TURNED * len(faces)), replace=False)
    changed = faces.copy()
    changed[chosen] = changed[chosen][:, ::-1]
    return Damaged(vertices, changed, np.arange(len(vertices)))


def points(vertices: Vertices, faces: Faces, rng: np.random.Generator) -> Damaged:
    """Leave the vertices alone."""
    return Damaged(vertices, np.zeros((0, 3), dtype=np.int64), np.arange(len(vertices)))


def sampled(vertices: Vertices, faces: Faces, rng: np.random.Generator) -> Damaged:
    """Draw points from the surface; each vertex belongs to the nearest of them that faces the same way."""
    areas = face_areas(vertices, faces)
    chosen = rng.choice(len(faces), size=SAMPLED, p=areas / areas.sum())
    root, share = np.sqrt(rng.random(SAMPLED)), rng.random(SAMPLED)
    weights = np.stack([1 - root, root * (1 - share), root * share], axis=1)
    drawn = np.einsum("sc,scx->sx", weights, vertices[faces[chosen]])
    normals = face_normals(vertices, faces)[chosen], vertex_normals(vertices, faces)
    belongs = nearest_on_the_same_side(drawn, normals[0], vertices, normals[1], NEAREST)
    return Damaged(drawn, np.zeros((0, 3), dtype=np.int64), belongs)


DAMAGES: dict[str, Callable[[Vertices, Faces, np.random.Generator], Damaged]] = {
    "pinched": pinched,
    "fins": finned,
    "unwelded": unwelded,
    "shells": shelled,
    "holes": holed,
    "slivers": slivered,
    "needles": needled,
    "coarse": coarse,
    "uneven": uneven,
    "junctions": junctioned,
    "turned": turned,
    "points": points,
    "sampled": sampled,
}
