"""Matches finer than a vertex: the point of the target surface that is closest in the aligned embedding."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CHUNK = 512


@dataclass(frozen=True)
class SurfacePoints:
    """Points on a triangle mesh.

    Attributes
    ----------
    faces : (n,) int64.
    barycentric : (n, 3) float64, weights of the face's corners; not negative, summing to 1.
    """

    faces: NDArray[np.int64]
    barycentric: NDArray[np.float64]


def closest_points(
    queries: NDArray[np.floating],
    embedding: NDArray[np.floating],
    triangles: NDArray[np.int32],
    nearest: NDArray[np.int64],
) -> SurfacePoints:
    """Return for each query the closest point on the faces around its nearest vertex, in the embedding.

    The embedded surface is the piecewise linear one: a point of a face is embedded at the same weights of its corners.

    Parameters
    ----------
    queries : (n, d), embedded source vertices.
    embedding : (p, d), embedded target vertices.
    triangles : (m, 3), faces of the target.
    nearest : (n,), nearest target vertex of each query.
    """
    order = np.argsort(triangles.ravel(), kind="stable")
    face_of_corner = order // 3
    starts = np.searchsorted(triangles.ravel()[order], np.arange(len(embedding) + 1))
    counts = np.diff(starts)[nearest]
    faces = np.zeros(len(queries), dtype=np.int64)
    barycentric = np.zeros((len(queries), 3))
    for begin in range(0, len(queries), CHUNK):
        rows = np.arange(begin, min(begin + CHUNK, len(queries)))
        owner = np.repeat(rows, counts[rows])
        first = np.cumsum(counts[rows]) - counts[rows]
        place = np.arange(owner.size) - np.repeat(first, counts[rows])
        around = face_of_corner[starts[nearest[owner]] + place]
        weights, squares = _closest_on_triangles(queries[owner], embedding[triangles[around]])
        best = np.lexsort((around, squares, owner))[first]
        faces[rows], barycentric[rows] = around[best], weights[best]
    return SurfacePoints(faces, barycentric)


def _closest_on_triangles(
    points: NDArray[np.floating], corners: NDArray[np.floating]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return weights (n, 3) of the closest points on triangles (n, 3, d) in any dimension, and squared distances (n,).

    The projection onto the plane where it falls inside the triangle, else the best of the projections onto its edges.
    """
    origin = corners[:, 0]
    first, second, offset = corners[:, 1] - origin, corners[:, 2] - origin, points - origin
    aa, ab, bb = _dot(first, first), _dot(first, second), _dot(second, second)
    pa, pb = _dot(offset, first), _dot(offset, second)
    determinant = aa * bb - ab * ab
    safe = np.where(determinant > 1e-14 * aa * bb, determinant, np.inf)
    u, v = (bb * pa - ab * pb) / safe, (aa * pb - ab * pa) / safe
    inside = np.isfinite(safe) & (u >= 0) & (v >= 0) & (u + v <= 1)
    candidates = [(np.where(inside, u, 0.0), np.where(inside, v, 0.0))]
    along = np.clip(pa / np.maximum(aa, 1e-300), 0.0, 1.0)
    candidates.append((along, np.zeros_like(along)))
    along = np.clip(pb / np.maximum(bb, 1e-300), 0.0, 1.0)
    candidates.append((np.zeros_like(along), along))
    edge = aa - 2 * ab + bb
    along = np.clip((pb - pa + aa - ab) / np.maximum(edge, 1e-300), 0.0, 1.0)
    candidates.append((1.0 - along, along))
    squares = np.stack([a * a * aa + 2 * a * b * ab + b * b * bb - 2 * a * pa - 2 * b * pb for a, b in candidates])
    squares[0] = np.where(inside, squares[0], np.inf)
    best = np.argmin(squares, axis=0)
    rows = np.arange(len(points))
    u = np.stack([a for a, _ in candidates])[best, rows]
    v = np.stack([b for _, b in candidates])[best, rows]
    weights = np.stack([1.0 - u - v, u, v], axis=1)
    return np.clip(weights, 0.0, 1.0), squares[best, rows] + _dot(offset, offset)


def _dot(a: NDArray[np.floating], b: NDArray[np.floating]) -> NDArray[np.float64]:
    return np.asarray(np.einsum("nd,nd->n", a, b), dtype=np.float64)
