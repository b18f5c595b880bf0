"""Lay a surface through a cloud of points.

The tetrahedra of the Delaunay triangulation are labelled inside or outside, and the faces between the two are the
surface: closed, oriented outward, and with the points as its vertices. Labels come from a signed graph of tetrahedra
(after Kolluri, Shewchuk & O'Brien 2004, "Spectral surface reconstruction from noisy point clouds"). Two neighbours
whose circumspheres nearly coincide lie on the same side; the two poles of a point, the largest empty balls on its two
sides (Amenta & Bern 1999), lie on different ones. A box around everything is outside. No normals are needed.

Where points lie on an open sheet, which has no inside, triangles on which the neighbourhoods of all three corners agree
are taken instead.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, cg
from scipy.spatial import Delaunay, QhullError, cKDTree

from clalign.mesh.topology import boxed, face_areas, face_normals, flipped, merge_positions, side_lengths

logger = logging.getLogger(__name__)

Points = NDArray[np.float64]
Faces = NDArray[np.int64]
Simplices = NDArray[np.int32]

BOX = 2.5
"""Half the side of the box that is outside, in longest sides of the cloud's own box."""
CONTRAST = 4.0
"""Exponent of the weights: spheres that coincide bind e⁸ times as strongly as spheres that touch."""
THIN = 1e-9
"""Points nearer than this part of their box to a line, on average, are on no surface."""
UNTIED = 1e-3
"""By how much, in distances to their neighbours, points are moved so that no four lie on a circle."""
FLAT = 1e-14
"""A tetrahedron of less volume, in products of its edges, has no circumsphere."""
SOLVED = 1e-4
"""Relative residual at which the labels stand: only their signs are used."""
MOST_STEPS = 5000
NEIGHBOURS = 6
LONGEST = 8.0
"""Triangles with a side longer than so many distances between neighbouring points span a hole."""
LEAST_COVERED = 0.9
"""Share of the points on the closed surface below which the cloud is taken for an open sheet."""
LARGEST_LIDS = 0.05
"""Share of the closed surface's area in triangles that span holes above which the cloud is taken for an open sheet."""
AGREEING = 2
"""Corners out of three whose neighbourhoods must have a triangle for it to be part of an open sheet."""


def surface_of_points(points: Points, normals: Points | None = None) -> Faces:
    """Return triangles (m, 3) on points (n, 3), without regard to whether they make a manifold surface.

    Of points at one place the first is a corner of triangles.

    normals : (n, 3), of any length, that say which side of an open sheet is its front; of a closed surface it is the
        outside.
    """
    first, _ = merge_positions(points)
    if len(first) < 4:
        return np.zeros((0, 3), dtype=np.int64)
    inside, _, _ = boxed(points[first])
    if np.linalg.matrix_rank(inside - inside.mean(axis=0), tol=THIN * np.sqrt(len(first))) < 2:
        return np.zeros((0, 3), dtype=np.int64)
    whole = _closed_surface(inside)
    faces = _without_spans(inside, whole)
    area, left = (float(face_areas(inside, each).sum()) for each in (whole, faces))
    # What was spanned is the lid of a sheet, or fills its hollows, and the sides of a sheet can be told by no inside.
    closed = len(np.unique(faces)) >= LEAST_COVERED * len(first) and left >= (1.0 - LARGEST_LIDS) * area
    if not closed:
        faces = _without_spans(inside, _open_sheet(inside))
    if normals is not None:
        agreement = np.einsum("fx,fcx->f", face_normals(inside, faces), normals[first][faces])
        # Triangles of a sheet come in any order of corners, those of a closed surface all in one.
        faces = flipped(faces, np.full(len(faces), agreement.sum() < 0) if closed else agreement < 0)
    return first[faces]


@dataclass(frozen=True)
class _Tetrahedra:
    """Delaunay tetrahedra of points and the corners of a box, with their circumspheres.

    corners, neighbours : (t, 4), neighbour k opposite to corner k, -1 for none.
    centres, radii : (t, 3) and (t,); infinite radius for flat ones.
    """

    points: Points
    corners: Simplices
    neighbours: Simplices
    centres: Points
    radii: NDArray[np.float64]

    @staticmethod
    def of(points: Points) -> _Tetrahedra:
        signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        every = np.concatenate([points, BOX * signs])
        found = Delaunay(every)
        first = every[found.simplices[:, 0]]
        sides = every[found.simplices[:, 1:]] - first[:, None]
        squared = np.einsum("tkx,tkx->tk", sides, sides)
        sound = np.abs(np.linalg.det(sides)) > FLAT * np.sqrt(squared.prod(axis=1))
        offset = np.zeros_like(first)
        offset[sound] = np.linalg.solve(2.0 * sides[sound], squared[sound][:, :, None])[:, :, 0]
        radii = np.where(sound, np.linalg.norm(offset, axis=1), np.inf)
        return _Tetrahedra(every, found.simplices, found.neighbors, first + offset, radii)

    def meeting(self, one: NDArray[np.int64], other: NDArray[np.int64]) -> NDArray[np.float64]:
        """Cosine of the angle at which circumspheres meet (p,): -1 if they coincide, 1 if they touch from outside."""
        a, b = self.radii[one], self.radii[other]
        sound = np.isfinite(a) & np.isfinite(b)
        cosine = np.full(len(one), -1.0)
        gap = np.square(self.centres[one[sound]] - self.centres[other[sound]]).sum(axis=1)
        a, b = a[sound], b[sound]
        cosine[sound] = np.clip((gap - a**2 - b**2) / (2.0 * a * b), -1.0, 1.0)
        return cosine


def _closed_surface(points: Points) -> Faces:
    """Faces between tetrahedra inside and outside, directed outward; none where points lie in a plane."""
    try:
        tetrahedra = _Tetrahedra.of(points)
    except QhullError as error:
        logger.info("no tetrahedra: %s", str(error).splitlines()[0])
        return np.zeros((0, 3), dtype=np.int64)
    inside = _labels(tetrahedra, len(points)) < 0
    parts = []
    for corner in range(4):
        across = tetrahedra.neighbours[:, corner]
        chosen = inside & (across >= 0) & ~inside[np.maximum(across, 0)]
        triangle = np.delete(tetrahedra.corners[chosen], corner, axis=1).astype(np.int64)
        apex = tetrahedra.points[tetrahedra.corners[chosen, corner]] - tetrahedra.points[triangle[:, 0]]
        inward = np.einsum("fx,fx->f", face_normals(tetrahedra.points, triangle), apex) > 0
        parts.append(np.where(inward[:, None], triangle[:, ::-1], triangle))
    return np.concatenate(parts)


def _labels(tetrahedra: _Tetrahedra, count: int) -> NDArray[np.float64]:
    """(t,) the least-squares labels, 1 at the box around the first `count` points and negative inside."""
    total = len(tetrahedra.corners)
    one = np.repeat(np.arange(total), 4)
    other = tetrahedra.neighbours.ravel().astype(np.int64)
    once = other > one
    one, other = one[once], other[once]
    alike = np.exp(-CONTRAST * (1.0 + tetrahedra.meeting(one, other)))
    first, second = _poles(tetrahedra, count)
    unlike = np.exp(CONTRAST * (tetrahedra.meeting(first, second) - 1.0))
    rows, columns = np.concatenate([one, first]), np.concatenate([other, second])
    weights = np.concatenate([alike, -unlike])
    adjacency = sparse.coo_matrix((weights, (rows, columns)), shape=(total, total)).tocsr()
    adjacency = adjacency + adjacency.T
    degree = np.bincount(rows, np.abs(weights), total) + np.bincount(columns, np.abs(weights), total)
    laplacian = (sparse.diags(degree) - adjacency).tocsr()
    outer = (tetrahedra.corners >= count).any(axis=1)
    system = laplacian[~outer][:, ~outer]
    diagonal = np.maximum(system.diagonal(), np.finfo(np.float64).tiny)
    scaled = LinearOperator(system.shape, matvec=lambda values: values.ravel() / diagonal, dtype=np.float64)
    pull = -np.asarray(laplacian[~outer][:, outer].sum(axis=1)).ravel()
    found, _ = cg(system, pull, rtol=SOLVED, maxiter=MOST_STEPS, M=scaled)
    label = np.ones(total)
    np.place(label, ~outer, found)
    return label


def _poles(tetrahedra: _Tetrahedra, count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The tetrahedra of the largest circumsphere of each point and of the largest on its other side, where both are."""
    tetrahedron = np.repeat(np.arange(len(tetrahedra.corners)), 4)
    point = tetrahedra.corners.ravel().astype(np.int64)
    usable = (point < count) & np.isfinite(tetrahedra.radii[tetrahedron])
    tetrahedron, point = tetrahedron[usable], point[usable]
    order = np.lexsort((-tetrahedra.radii[tetrahedron], point))
    tetrahedron, point = tetrahedron[order], point[order]
    poles = np.full((2, count), -1, dtype=np.int64)
    named, place = np.unique(point, return_index=True)
    poles[0, named] = tetrahedron[place]
    away = tetrahedra.centres[poles[0]] - tetrahedra.points[:count]
    beyond = np.einsum("tx,tx->t", tetrahedra.centres[tetrahedron] - tetrahedra.points[point], away[point]) < 0
    named, place = np.unique(point[beyond], return_index=True)
    poles[1, named] = tetrahedron[beyond][place]
    both = (poles >= 0).all(axis=0)
    return poles[0, both], poles[1, both]


def _open_sheet(points: Points) -> Faces:
    """Triangles in the planar Delaunay triangulations of the neighbourhoods of at least two of their corners."""
    from potpourri3d import PointCloudLocalTriangulation

    # Points of a regular grid lie on common circles: each neighbourhood would choose diagonals of its own.
    spacing = _spacing(points)[:, None]
    moved = points + UNTIED * spacing * np.random.default_rng(0).standard_normal(points.shape)
    local = np.asarray(PointCloudLocalTriangulation(moved).get_local_triangulation(), dtype=np.int64).reshape(-1, 3)
    triangles = np.sort(local[(local >= 0).all(axis=1)], axis=1)
    unique, votes = np.unique(triangles, axis=0, return_counts=True)
    return unique[votes >= AGREEING]


def _spacing(points: Points) -> NDArray[np.float64]:
    """(n,) mean distance from each point to its nearest neighbours."""
    distance = cKDTree(points).query(points, k=min(NEIGHBOURS + 1, len(points)))[0]
    return np.asarray(distance[:, 1:].mean(axis=1))


def _without_spans(points: Points, faces: Faces) -> Faces:
    """Leave out triangles that are large for the distances between points there: they span a hole of the cloud."""
    spacing = _spacing(points)
    longest = side_lengths(points, faces).max(axis=1)
    return faces[longest <= LONGEST * spacing[faces].max(axis=1)]
