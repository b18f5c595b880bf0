"""Flat charts of parts of a surface, in which nothing is folded: Tutte's embedding with mean value weights.

    u_i = Σ_j λ_ij u_j,  λ_ij = (tan(α/2) + tan(β/2)) / |x_i − x_j|

for inner vertices, the outer boundary on a circle (Floater 2003). All weights are positive, so that no triangle is
turned over in the plane, however the surface bends in space.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.linalg import spsolve

from clalign.mesh.topology import boundary_edges, edge_loops, edge_table
from clalign.refinement.precise import SurfacePoints

AT_ONCE = 256


def mean_value_weights(vertices: NDArray[np.float64], faces: NDArray[np.integer]) -> sparse.csr_matrix:
    """Return (n, n) λ, not negative and not symmetric, of a surface (n, 3), (m, 3)."""
    count, entries = len(vertices), []
    for k in range(3):
        here, right, left = faces[:, k], faces[:, (k + 1) % 3], faces[:, (k + 2) % 3]
        to_right, to_left = vertices[right] - vertices[here], vertices[left] - vertices[here]
        long_right, long_left = np.linalg.norm(to_right, axis=1), np.linalg.norm(to_left, axis=1)
        # tan(α/2) = |a × b| / (|a||b| + a·b), kept finite for angles near π.
        sine = np.linalg.norm(np.cross(to_right, to_left), axis=1)
        scale = np.maximum(long_right * long_left, 1e-300)
        tangent = sine / np.maximum(scale + np.einsum("mk,mk->m", to_right, to_left), 1e-4 * scale)
        tangent = np.maximum(tangent, 1e-4)
        entries += [(tangent / np.maximum(long_right, 1e-150), here, right)]
        entries += [(tangent / np.maximum(long_left, 1e-150), here, left)]
    values, rows, columns = (np.concatenate(parts) for parts in zip(*entries, strict=True))
    return sparse.coo_matrix((values, (rows, columns)), shape=(count, count)).tocsr()


def settled(places: NDArray[np.float64], weights: sparse.csr_matrix, free: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return places (n, d) with the free ones moved to the weighted means of their neighbours.

    Parameters
    ----------
    weights : (n, n), not negative.
    free : (n,) vertices that move; every part of them has a neighbour that does not.
    """
    if not free.any():
        return places
    rows = weights[free]
    total = sparse.diags(np.asarray(rows.sum(axis=1)).ravel())
    found = places.copy()
    solution = spsolve(sparse.csc_matrix(total - rows[:, free]), np.asarray(rows[:, ~free] @ places[~free]))
    found[free] = solution.reshape(-1, places.shape[1])
    return found


def signed_areas(flat: NDArray[np.float64], faces: NDArray[np.integer]) -> NDArray[np.float64]:
    """Return (m,) areas of triangles in the plane (n, 2), negative where they are turned over."""
    first, second = flat[faces[:, 1]] - flat[faces[:, 0]], flat[faces[:, 2]] - flat[faces[:, 0]]
    return np.asarray((first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2)


@dataclass(frozen=True)
class Chart:
    """A part of a surface laid into the plane.

    faces : (m,) faces of the surface, ascending.
    corners : (m, 3) their corners, as rows of `flat`.
    flat : (k, 2).
    """

    faces: NDArray[np.int64]
    corners: NDArray[np.int64]
    flat: NDArray[np.float64]

    @staticmethod
    def of(vertices: NDArray[np.float64], triangles: NDArray[np.integer], faces: NDArray[np.int64]) -> Chart | None:
        """Return a chart of connected faces of a surface, or None where they cannot be laid flat.

        All holes but the longest, which becomes the outside, are closed with a vertex in their middle.
        """
        used, local = np.unique(triangles[faces], return_inverse=True)
        corners = local.reshape(-1, 3).astype(np.int64)
        points, closed = vertices[used], corners
        rim = boundary_edges(corners, len(used))
        if not len(rim) or len(np.unique(rim[:, 0])) < len(rim):
            return None
        count, loop = edge_loops(rim)
        length = np.bincount(loop, weights=np.linalg.norm(points[rim[:, 0]] - points[rim[:, 1]], axis=1))
        outer = int(length.argmax())
        for number in range(count):
            if number == outer:
                continue
            edges = rim[loop == number]
            tip = np.full(len(edges), len(points))
            points = np.concatenate([points, points[edges[:, 0]].mean(axis=0, keepdims=True)])
            closed = np.concatenate([closed, np.stack([edges[:, 1], edges[:, 0], tip], axis=1)])
        table = edge_table(closed, len(points))
        if len(points) - len(table.edges) + len(closed) != 1:
            return None
        ring = _walk_round(rim[loop == outer])
        gone = np.linalg.norm(points[ring] - points[np.roll(ring, -1)], axis=1)
        angle = 2 * np.pi * np.concatenate([[0.0], np.cumsum(gone)[:-1]]) / gone.sum()
        flat = np.zeros((len(points), 2))
        flat[ring] = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        free = np.ones(len(points), dtype=bool)
        free[ring] = False
        flat = settled(flat, mean_value_weights(points, closed), free)
        if (signed_areas(flat, corners) <= 0).any():
            return None
        return Chart(faces, corners, flat)

    def laid(self, points: SurfacePoints) -> NDArray[np.float64]:
        """Return (n, 2) where points in faces of the chart lie in the plane."""
        row = np.searchsorted(self.faces, points.faces)
        return np.asarray(np.einsum("nc,nck->nk", points.barycentric, self.flat[self.corners[row]]))

    def lifted(self, flat: NDArray[np.float64]) -> SurfacePoints:
        """Return points of the plane (n, 2) as points in faces; one outside the chart goes to a face nearby."""
        a, b, c = (self.flat[self.corners[:, k]] for k in range(3))
        double = 2 * signed_areas(self.flat, self.corners)

        def cross(p: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float64]:
            return p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]

        rows, chosen = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 3))]
        for begin in range(0, len(flat), AT_ONCE):
            at = flat[begin : begin + AT_ONCE, None]
            weights = np.stack([cross(b - at, c - at), cross(c - at, a - at), cross(a - at, b - at)], axis=2)
            weights /= double[:, None]
            rows.append(weights.min(axis=2).argmax(axis=1))
            chosen.append(np.clip(weights[np.arange(len(at)), rows[-1]], 0.0, None))
        within = np.concatenate(chosen)
        return SurfacePoints(self.faces[np.concatenate(rows)], within / within.sum(axis=1, keepdims=True))


def _walk_round(edges: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the vertices of a closed loop of directed edges (b, 2), one after the other."""
    following = dict(edges.tolist())
    ring = [int(edges[0, 0])]
    while len(ring) < len(edges):
        ring.append(following[ring[-1]])
    return np.array(ring)
