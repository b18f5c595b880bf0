"""Distances carried from one shape to another by the truth: the shapes made isometric for a study of the method."""

from __future__ import annotations

import dataclasses

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from clalign.errors import ResultError
from clalign.evaluation.truth import Truth
from clalign.geometry.geodesics import DistanceFactors, Geodesics
from clalign.geometry.shape import Shape
from clalign.mesh.mesh import Mesh


def with_distances_of(target: Shape, source: Shape, truth: Truth) -> Shape:
    """Return the target with every geodesic distance replaced by that between the true points of the source.

    D_Y(i, j) becomes D_X(π(i), π(j)) for π the truth from the target to the source. Where the truth does not name a
    target vertex, π is that of the nearest one that it names.

    Raises
    ------
    ResultError
        The truth has no point on both surfaces.
    """
    source_of_target, target_of_source = total_maps(source.mesh, target.mesh, truth)
    # With Q R the decomposition of the carried factor in the target's areas, U T Uᵀ = Q (R T Rᵀ) Qᵀ.
    root = np.sqrt(target.mass)[:, None]
    left, triangle = scipy.linalg.qr(source.factors.left[source_of_target] * root, mode="economic")
    core = triangle @ source.factors.core @ triangle.T
    geodesics = Geodesics(
        samples=target_of_source[source.geodesics.samples],
        distances=source.geodesics.distances,
        rows=source.geodesics.rows[:, source_of_target],
        weights=source.geodesics.weights,
    )
    return dataclasses.replace(
        target, geodesics=geodesics, factors=DistanceFactors(left=left / root, core=0.5 * (core + core.T))
    )


def total_maps(source: Mesh, target: Mesh, truth: Truth) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the true source vertex of every target vertex, (n_y,), and the other way round, (n_x,), compact.

    Vertices that the truth does not name take what their nearest named neighbour in space has.

    Raises
    ------
    ResultError
        The truth has no point on both surfaces.
    """
    truth.check_against(source.file_count, target.file_count)
    source_points = source.vertex_of_file()[truth.source_points]
    target_points = target.vertex_of_file()[truth.target_points]
    known = (source_points >= 0) & (target_points >= 0)
    if not known.any():
        raise ResultError(f"the truth has no point on both {source.name} and {target.name}")
    return (
        _filled(target.vertices, target_points[known], source_points[known]),
        _filled(source.vertices, source_points[known], target_points[known]),
    )


def _filled(vertices: NDArray[np.float64], named: NDArray[np.int64], values: NDArray[np.int64]) -> NDArray[np.int64]:
    found = np.full(len(vertices), -1, dtype=np.int64)
    found[named] = values
    known = np.flatnonzero(found >= 0)
    nearest = cKDTree(vertices[known]).query(vertices)[1]
    return found[known[nearest]]
