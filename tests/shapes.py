"""Small meshes made in code, for every room's tests."""

from __future__ import annotations

import heapq
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

Vertices = NDArray[np.float64]
Faces = NDArray[np.int64]


class Pair(NamedTuple):
    """Two meshes of one shape, numbered independently, and the target vertex of every source vertex."""

    source: tuple[Vertices, Faces]
    target: tuple[Vertices, Faces]
    truth: NDArray[np.int64]
    mirrored: NDArray[np.int64] | None = None


def icosphere(subdivisions: int) -> tuple[Vertices, Faces]:
    """Unit sphere of 10 * 4**subdivisions + 2 vertices, faces outward."""
    golden = (1 + 5**0.5) / 2
    corners = np.array([[a, b * golden, 0.0] for b in (1, -1) for a in (-1, 1)])
    vertices = np.concatenate([np.roll(corners, turn, axis=1) for turn in range(3)])
    faces = ConvexHull(vertices).simplices.astype(np.int64)
    inward = np.linalg.det(vertices[faces]) < 0
    faces[inward] = faces[inward, ::-1]
    for _ in range(subdivisions):
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        unique, inverse = np.unique(edges, axis=0, return_inverse=True)
        middle = (len(vertices) + inverse).reshape(-1, 3)
        vertices = np.concatenate([vertices, vertices[unique].mean(axis=1)])
        corner = [np.stack([faces[:, i], middle[:, i], middle[:, i - 1]], axis=1) for i in range(3)]
        faces = np.concatenate([*corner, middle])
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True), faces


def bumpy_sphere(subdivisions: int = 3, seed: int = 0) -> tuple[Vertices, Faces]:
    """Sphere with random smooth bumps: no symmetry, so that there is one right map of it to itself."""
    directions, faces = icosphere(subdivisions)
    rng = np.random.default_rng(seed)
    centres = rng.normal(size=(6, 3))
    centres /= np.linalg.norm(centres, axis=1, keepdims=True)
    heights = rng.uniform(0.25, 0.7, size=6)
    bumps = np.exp(6 * (directions @ centres.T - 1)) @ heights
    stretched = directions * np.array([1.0, 0.8, 0.65])
    return stretched * (1 + bumps)[:, None], faces


LIMBS = np.array([[1.0, 0.0, 0.2], [0.1, 1.0, 0.1], [-0.9, 0.5, 0.0], [-0.5, -0.9, 0.1], [0.5, -0.7, -0.8]])
"""Directions of the limbs of `limbed_sphere`; no rotation carries them to each other."""


def limbed_sphere(lengths: tuple[float, ...], subdivisions: int = 3) -> tuple[Vertices, Faces]:
    """Ball with five limbs of given lengths, in units of its radius, along `LIMBS`."""
    directions, faces = icosphere(subdivisions)
    along = LIMBS / np.linalg.norm(LIMBS, axis=1, keepdims=True)
    return directions * (1 + np.exp(12 * (directions @ along.T - 1)) @ np.array(lengths))[:, None], faces


def bent(vertices: Vertices, angle: float = 0.6) -> Vertices:
    """Bend a shape about its longest axis: nearly an isometry for small angles and thin shapes."""
    turn = angle * vertices[:, 0] / np.ptp(vertices[:, 0])
    x, y, z = vertices.T
    return np.stack([x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn), z], axis=1)


def renumbered(vertices: Vertices, faces: Faces, seed: int) -> tuple[Vertices, Faces, NDArray[np.int64]]:
    """Shuffle the vertices, the faces and their corners; also return the new number of every old vertex."""
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(vertices))
    new_of_old = np.empty(len(vertices), dtype=np.int64)
    new_of_old[order] = np.arange(len(vertices))
    corners = (np.arange(3) + rng.integers(0, 3, size=(len(faces), 1))) % 3
    shuffled = np.take_along_axis(new_of_old[faces], corners, axis=1)
    return vertices[order], shuffled[rng.permutation(len(faces))], new_of_old


def decimated(vertices: Vertices, faces: Faces, count: int) -> tuple[NDArray[np.int64], Faces]:
    """Collapse shortest edges of a closed manifold until `count` vertices remain.

    Return the kept vertices, ascending, and the faces between them (numbered by place among the kept).
    """
    rings: list[set[int]] = [set() for _ in vertices]
    for number, face in enumerate(faces):
        for vertex in face:
            rings[vertex].add(number)
    triangles = [tuple(int(v) for v in face) for face in faces]
    alive = np.ones(len(vertices), dtype=bool)

    def neighbours(vertex: int) -> set[int]:
        return {v for number in rings[vertex] for v in triangles[number]} - {vertex}

    # Plain numbers: numpy is slow on three of them at a time.
    points = vertices.tolist()

    def length(a: int, b: int) -> float:
        return math.dist(points[a], points[b])

    def normal(a: int, b: int, c: int) -> tuple[float, float, float]:
        ux, uy, uz = (p - q for p, q in zip(points[b], points[a], strict=True))
        vx, vy, vz = (p - q for p, q in zip(points[c], points[a], strict=True))
        return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx

    def flips(gone: int, kept: int) -> bool:
        for number in rings[gone] - rings[kept]:
            before = triangles[number]
            after = tuple(kept if v == gone else v for v in before)
            old, new = normal(*before), normal(*after)
            if sum(p * q for p, q in zip(old, new, strict=True)) <= 0.3 * math.hypot(*old) * math.hypot(*new):
                return True
        return False

    queue = [(length(a, b), a, b) for a in range(len(vertices)) for b in neighbours(a)]
    heapq.heapify(queue)
    remaining = len(vertices)
    while remaining > count and queue:
        _, gone, kept = heapq.heappop(queue)
        if not (alive[gone] and alive[kept]) or kept not in neighbours(gone):
            continue
        if len(neighbours(gone) & neighbours(kept)) != 2 or flips(gone, kept):
            continue
        for number in list(rings[gone]):
            if number in rings[kept]:
                for vertex in triangles[number]:
                    rings[vertex].discard(number)
            else:
                triangles[number] = tuple(kept if v == gone else v for v in triangles[number])
                rings[kept].add(number)
        rings[gone].clear()
        alive[gone] = False
        remaining -= 1
        for vertex in neighbours(kept):
            heapq.heappush(queue, (length(kept, vertex), kept, vertex))
            heapq.heappush(queue, (length(kept, vertex), vertex, kept))
    kept_vertices = np.flatnonzero(alive)
    place = np.cumsum(alive) - 1
    left = sorted(set().union(*(rings[v] for v in kept_vertices)))
    return kept_vertices, place[np.array([triangles[number] for number in left])]


def write_off(path: Path, vertices: Vertices, faces: Faces) -> Path:
    """Write an OFF file with full precision."""
    lines = ["OFF", f"{len(vertices)} {len(faces)} 0"]
    lines += [" ".join(repr(float(value)) for value in row) for row in vertices]
    lines += [f"3 {a} {b} {c}" for a, b, c in faces.tolist()]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return path
