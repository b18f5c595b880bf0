"""Parts of a surface, as scanners leave them: cut by a plane, or with large holes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from clalign.mesh.topology import edge_table, face_areas, face_components

Vertices = NDArray[np.float64]
Faces = NDArray[np.int64]
Mask = NDArray[np.bool_]

TRIES = 40
"""Planes or sets of balls that are drawn until one leaves a part in one piece ..."""
NEAR = 0.15
"""... whose area is the wanted one up to this part of it."""
BALLS = (5, 25)
"""Fewest and most balls that holes are made of."""


@dataclass(frozen=True)
class Kind:
    """A way to take a part.

    draw : draws a value for every face, of which the largest are taken away.
    shares : of the area that are left, from the first to the last.
    """

    draw: Callable[[Vertices, Faces, np.random.Generator], NDArray[np.float64]]
    shares: tuple[float, float]


def heights(vertices: Vertices, faces: Faces, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return the height of every face along a random direction: what lies above a plane is taken away."""
    direction = rng.standard_normal(3)
    return np.asarray(vertices[faces].mean(axis=1) @ direction)


def closeness(vertices: Vertices, faces: Faces, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return how near every face is to some random vertices along edges: balls around them are taken away."""
    n = len(vertices)
    low, high = edge_table(faces, n).edges.T
    length = np.maximum(np.linalg.norm(vertices[low] - vertices[high], axis=1), np.finfo(np.float64).tiny)
    centres = rng.choice(n, size=int(rng.integers(BALLS[0], BALLS[1] + 1)), replace=False)
    graph = csr_matrix((length, (low, high)), shape=(n, n))
    near = dijkstra(graph, directed=False, indices=centres, min_only=True)
    return -np.asarray(near[faces].mean(axis=1))


KINDS = {"cuts": Kind(heights, (0.1, 0.9)), "holes": Kind(closeness, (0.4, 0.85))}


def part_of(vertices: Vertices, faces: Faces, kind: Kind, share: float, rng: np.random.Generator) -> Mask:
    """Return the faces (m,) of a connected part that has about a share of the area; the nearest of all that are tried.

    Parameters
    ----------
    vertices, faces : (n, 3) and (m, 3).
    kind : one of `KINDS`.
    share : of the area.
    """
    area = face_areas(vertices, faces)
    best, gap = np.ones(len(faces), dtype=bool), np.inf
    for _ in range(TRIES):
        values = kind.draw(vertices, faces, rng)
        order = np.argsort(values, kind="stable")
        left = np.zeros(len(faces), dtype=bool)
        left[order[np.cumsum(area[order]) <= share * area.sum()]] = True
        part = _largest_piece(faces, area, left, len(vertices))
        miss = abs(float(area[part].sum() / area.sum()) / share - 1.0)
        if miss < gap:
            best, gap = part, miss
        if gap < NEAR:
            break
    return best


def _largest_piece(faces: Faces, area: NDArray[np.float64], mask: Mask, n: int) -> Mask:
    """Return the faces of the largest piece joined across edges among those of a mask."""
    kept = np.flatnonzero(mask)
    if not len(kept):
        return mask
    _, labels = face_components(edge_table(faces[kept], n), len(kept))
    largest = np.bincount(labels, weights=area[kept]).argmax()
    piece = np.zeros_like(mask)
    piece[kept[labels == largest]] = True
    return piece
