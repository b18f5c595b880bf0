"""Points on a surface, and the nearest of them to points in space, found without leaving the sheet that one is on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from clalign.mesh.mesh import Mesh
from clalign.mesh.topology import boundary_edges, boundary_vertices, edge_table, vertex_normals
from clalign.refinement.precise import SurfacePoints, closest_points

NORMALS = 0.1
"""How far apart two points at one place count whose normals are at right angles, in sqrt(2 area)."""
STEPS = 40
"""Of a walk from vertex to vertex; one is seldom longer than the way that a point has moved, in edges."""
EDGES = 8
"""Of a rim that are looked at for each point."""
FARTHER = 2.0
"""Where a walk ends so many times farther away than the nearest place with a like normal, that one is taken."""


def some(points: SurfacePoints, rows: NDArray) -> SurfacePoints:
    """Return some of the points: by their numbers, or by a mask."""
    return SurfacePoints(points.faces[rows], points.barycentric[rows])


def with_some(points: SurfacePoints, rows: NDArray, others: SurfacePoints) -> SurfacePoints:
    """Return the points with others in the place of some."""
    faces, barycentric = points.faces.copy(), points.barycentric.copy()
    faces[rows], barycentric[rows] = others.faces, others.barycentric
    return SurfacePoints(faces, barycentric)


def at_vertices(mesh: Mesh, vertices: NDArray[np.int64]) -> SurfacePoints:
    """Return vertices (n,) of a mesh as points in faces."""
    flat = mesh.faces.ravel()
    corner = np.zeros(mesh.n_vertices, dtype=np.int64)
    corner[flat[::-1]] = np.arange(len(flat))[::-1]
    faces, place = np.divmod(corner[vertices], 3)
    return SurfacePoints(faces, np.eye(3)[place])


def interpolated(values: NDArray[np.float64], faces: NDArray[np.integer], points: SurfacePoints) -> NDArray[np.float64]:
    """Return values (n_vertices, c) of a mesh at points in its faces, (n, c)."""
    return np.asarray(np.einsum("nc,nck->nk", points.barycentric, values[faces[points.faces]]))


def nearest_corner(faces: NDArray[np.integer], points: SurfacePoints) -> NDArray[np.int64]:
    """Return the vertex (n,) whose weight is the largest at each point."""
    return faces[points.faces, points.barycentric.argmax(axis=1)].astype(np.int64)


def walked(queries: NDArray[np.float64], mesh: Mesh, start: NDArray[np.int64]) -> SurfacePoints:
    """Return for each point in space (n, 3) the place nearest to it that a descent from a vertex (n,) leads to.

    Every step goes to the nearest point on the faces around a vertex, and on to the corner that this is nearest to, so
    that the sheet is never left: of a hand on a hip, the palm stays in the hand.
    """
    found = closest_points(queries, mesh.vertices, mesh.faces, start)
    at, rest = start.copy(), np.arange(len(queries))
    for _ in range(STEPS):
        ahead = nearest_corner(mesh.faces, some(found, rest))
        rest, ahead = rest[ahead != at[rest]], ahead[ahead != at[rest]]
        if not rest.size:
            break
        at[rest] = ahead
        found = with_some(found, rest, closest_points(queries[rest], mesh.vertices, mesh.faces, ahead))
    return found


class Projection:
    """The projection onto a surface.

    Parameters
    ----------
    mesh : the surface.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self.rim = boundary_vertices(mesh.faces, mesh.n_vertices)
        normals = vertex_normals(mesh.vertices, mesh.faces)
        self._tree = cKDTree(np.concatenate([mesh.vertices, NORMALS * normals], axis=1))

    def __call__(
        self, queries: NDArray[np.float64], normals: NDArray[np.float64], start: SurfacePoints
    ) -> SurfacePoints:
        """Return the nearest place of each point (n, 3): by a walk from where it was, unless that ends far away.

        Parameters
        ----------
        queries, normals : (n, 3), points and unit normals.
        start : where the points were.
        """
        near = walked(queries, self.mesh, nearest_corner(self.mesh.faces, start))
        _, seen = self._tree.query(np.concatenate([queries, NORMALS * normals], axis=1))
        other = walked(queries, self.mesh, seen.astype(np.int64))
        far = self.distance(queries, near) > FARTHER * self.distance(queries, other)
        return with_some(near, far, some(other, far))

    def positions(self, points: SurfacePoints) -> NDArray[np.float64]:
        """Return (n, 3) where points in faces lie."""
        return interpolated(self.mesh.vertices, self.mesh.faces, points)

    def distance(self, queries: NDArray[np.float64], points: SurfacePoints) -> NDArray[np.float64]:
        """Return (n,) how far points in space are from places."""
        return np.asarray(np.linalg.norm(queries - self.positions(points), axis=1))

    def at_rim(self, points: SurfacePoints) -> NDArray[np.bool_]:
        """Return (n,) which places are nearest to a corner on the edge of the surface."""
        return self.rim[nearest_corner(self.mesh.faces, points)]


class Rim:
    """The edges of a surface that belong to one face only.

    Parameters
    ----------
    mesh : a surface with a boundary.
    """

    def __init__(self, mesh: Mesh) -> None:
        table = edge_table(mesh.faces, mesh.n_vertices)
        lonely = np.flatnonzero(table.face_count[table.edge_of_half_edge] == 1)
        self._corner, self._face = np.divmod(lonely, mesh.n_faces)
        edges = boundary_edges(mesh.faces, mesh.n_vertices)
        self._tail, self._head = mesh.vertices[edges[:, 0]], mesh.vertices[edges[:, 1]]
        self._middle = cKDTree((self._tail + self._head) / 2)

    def nearest(self, queries: NDArray[np.float64]) -> SurfacePoints:
        """Return the nearest point on the rim of each point in space (n, 3), among the edges with near middles."""
        _, near = self._middle.query(queries, k=min(EDGES, len(self._tail)))
        near = near.reshape(len(queries), -1)
        along = self._head[near] - self._tail[near]
        share = np.einsum("nek,nek->ne", queries[:, None] - self._tail[near], along)
        share = np.clip(share / np.maximum(np.einsum("nek,nek->ne", along, along), 1e-300), 0.0, 1.0)
        off = np.linalg.norm(queries[:, None] - self._tail[near] - share[:, :, None] * along, axis=2)
        rows, best = np.arange(len(queries)), off.argmin(axis=1)
        edge, share = near[rows, best], share[rows, best]
        barycentric = np.zeros((len(queries), 3))
        barycentric[rows, self._corner[edge]] = 1.0 - share
        barycentric[rows, (self._corner[edge] + 1) % 3] = share
        return SurfacePoints(self._face[edge], barycentric)
