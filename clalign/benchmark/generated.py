"""Pairs of any size made in code: one bumpy body in two poses, each meshed in its own random way."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, cKDTree
from scipy.spatial.transform import Rotation

from clalign.benchmark.pairs import LoadedPair
from clalign.errors import OptionError
from clalign.evaluation.truth import Truth
from clalign.mesh.mesh import Mesh, mesh_from_arrays

SMALLEST = 100
BUMPS = 9
BEND = 0.3
JITTER = 0.25


def generated_pair(count: int, seed: int = 0) -> LoadedPair:
    """Return a pair of meshes of `count` vertices each and the nearest target vertex of every source vertex.

    The body is a stretched sphere with bumps and no symmetry; the target is bent about an axis across it. Both are the
    convex hull of a rotated and jittered spiral of points on the sphere, so that no two vertices are the same point and
    no two faces the same triangle.

    Raises
    ------
    OptionError
        Fewer vertices than `SMALLEST`.
    """
    if count < SMALLEST:
        raise OptionError(f"a generated mesh has at least {SMALLEST} vertices, got {count}")
    source_points, target_points = (points_on_sphere(count, seed=1000 * seed + side) for side in (1, 2))
    source = mesh_on_sphere(source_points, _body(source_points, seed), f"generated-{count}-source")
    target = mesh_on_sphere(target_points, _bent(_body(target_points, seed)), f"generated-{count}-target")
    _, nearest = cKDTree(target_points).query(source_points)
    return LoadedPair(f"generated {count}", source, target, Truth(np.arange(count), nearest.astype(np.int64)), None)


def points_on_sphere(count: int, seed: int) -> NDArray[np.float64]:
    """Return a Fibonacci spiral in a random order, jittered and rotated."""
    rng = np.random.default_rng(seed)
    order = rng.permutation(count)
    height = 1.0 - (2.0 * order + 1.0) / count
    angle = order * np.pi * (3.0 - 5.0**0.5)
    across = np.sqrt(1.0 - height**2)
    points = np.stack([across * np.cos(angle), across * np.sin(angle), height], axis=1)
    points += JITTER * np.sqrt(4.0 * np.pi / count) * rng.uniform(-1.0, 1.0, points.shape)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points @ Rotation.from_rotvec(rng.uniform(-2.0, 2.0, 3)).as_matrix().T


def _body(directions: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
    """Return the points of the body in some directions."""
    rng = np.random.default_rng(seed)
    centres = rng.normal(size=(BUMPS, 3))
    centres /= np.linalg.norm(centres, axis=1, keepdims=True)
    bumps = np.exp(8.0 * (directions @ centres.T - 1.0)) @ rng.uniform(0.2, 0.6, size=BUMPS)
    points: NDArray[np.float64] = directions * np.array([1.0, 0.7, 0.55]) * (1.0 + bumps)[:, None]
    return points


def _bent(points: NDArray[np.float64]) -> NDArray[np.float64]:
    angle = BEND * points[:, 0] / 2.0
    x, y, z = points.T
    return np.stack([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle), z], axis=1)


def mesh_on_sphere(directions: NDArray[np.float64], points: NDArray[np.float64], name: str) -> Mesh:
    """Return a mesh of points (n, 3) with the triangles of the convex hull of their directions (n, 3), unit vectors."""
    faces = ConvexHull(directions).simplices.astype(np.int64)
    inward = np.linalg.det(directions[faces]) < 0
    faces[inward] = faces[inward, ::-1]
    return mesh_from_arrays(points, faces, name)
