"""Distances on the target that errors are measured in, and those of another shape in their place for a study."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from clalign.evaluation.truth import Truth, true_maps
from clalign.geometry.geodesics import DistanceFactors
from clalign.geometry.heat import FastMarching, Geodesics, distance_solver
from clalign.geometry.shape import Shape
from clalign.mesh.mesh import Mesh

DistanceMethod = Literal["heat", "bounded", "marching"]
METHODS: dict[str, str] = {
    "heat": "heat method (potpourri3d)",
    "bounded": "heat method (potpourri3d), at least the straight distance",
    "marching": "fast marching (potpourri3d)",
}
DIAMETER_SWEEPS = 8


class Distances:
    """Geodesic distances on one mesh in sqrt(area), from rows of the heat method.

    The heat method underestimates the distance to the next vertex by about a tenth (measured on bodies of 5,000 to
    7,000 vertices: 0.88 of the edge on average, 0.96 two edges away). "bounded" replaces whatever is below the
    straight distance by it, which no geodesic is shorter than; "marching" is fast marching, right to half a percent.
    """

    def __init__(self, mesh: Mesh, method: DistanceMethod = "heat") -> None:
        self._mesh = mesh
        surface = mesh.vertices, mesh.faces, mesh.name
        self._solver = FastMarching(*surface) if method == "marching" else distance_solver(*surface)
        self._bounded = method == "bounded"

    def row(self, vertex: int) -> NDArray[np.float64]:
        """Return the (n,) distances from one vertex."""
        row = self._solver.row(vertex)
        if self._bounded:
            row = np.maximum(row, np.linalg.norm(self._mesh.vertices - self._mesh.vertices[vertex], axis=1))
        return row

    def from_matches(self, matches: NDArray[np.int64], *truths: NDArray[np.int64]) -> list[NDArray[np.float64]]:
        """Return (p,) distances from matched vertices to the true ones, of each of several truths (p,).

        One row from the match serves all, and points with one match share it.
        """
        errors = [np.empty(matches.size) for _ in truths]
        for match, points in _grouped(matches):
            row = self.row(match)
            for found, truth in zip(errors, truths, strict=True):
                found[points] = row[truth[points]]
        return errors

    def to_face_points(
        self, truth: NDArray[np.int64], corners: NDArray[np.int32], weights: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return (p,) distances from true vertices to points inside faces.

        In a face that has the true vertex as a corner it is the straight distance, which is exact there; in others
        the distances of the corners (p, 3) are interpolated by the barycentric weights (p, 3).
        """
        distances = np.empty(truth.size)
        for vertex, points in _grouped(truth):
            distances[points] = np.sum(self.row(vertex)[corners[points]] * weights[points], axis=1)
        inside = np.einsum("pc,pcx->px", weights, self._mesh.vertices[corners])
        straight = np.linalg.norm(inside - self._mesh.vertices[truth], axis=1)
        adjacent = (corners == truth[:, None]).any(axis=1)
        return np.where(adjacent | (self._bounded & (straight > distances)), straight, distances)

    def diameter(self) -> float:
        """Return the largest distance seen from `DIAMETER_SWEEPS` farthest points, starting far from the centroid."""
        centre = self._mesh.vertices.mean(axis=0)
        vertex = int(np.square(self._mesh.vertices - centre).sum(axis=1).argmax())
        gap = np.full(self._mesh.n_vertices, np.inf)
        diameter = 0.0
        for _ in range(DIAMETER_SWEEPS):
            row = self.row(vertex)
            diameter = max(diameter, float(row.max()))
            gap = np.minimum(gap, row)
            vertex = int(gap.argmax())
        return diameter


def with_distances_of(target: Shape, source: Shape, truth: Truth) -> Shape:
    """Return the target with every geodesic distance replaced by that between the true points of the source.

    D_Y(i, j) becomes D_X(π(i), π(j)) for π the truth from the target to the source. Where the truth does not name a
    target vertex, π is that of the nearest one that it names.

    Raises
    ------
    ResultError
        The truth has no point on both surfaces.
    """
    maps = true_maps(source.mesh, target.mesh, truth)
    # With Q R the decomposition of the pulled-back factor in the target's areas, U T Uᵀ = Q (R T Rᵀ) Qᵀ.
    root = np.sqrt(target.mass)[:, None]
    left, triangle = scipy.linalg.qr(source.factors.left[maps.source_of_target] * root, mode="economic")
    core = triangle @ source.factors.core @ triangle.T
    geodesics = Geodesics(
        samples=maps.target_of_source[source.geodesics.samples],
        distances=source.geodesics.distances,
        rows=source.geodesics.rows[:, maps.source_of_target],
        weights=source.geodesics.weights,
    )
    return replace(target, geodesics=geodesics, factors=DistanceFactors(left=left / root, core=0.5 * (core + core.T)))


def _grouped(vertices: NDArray[np.int64]) -> list[tuple[int, NDArray[np.int64]]]:
    """Return every distinct vertex with the positions where it stands."""
    distinct, first = np.unique(np.sort(vertices), return_index=True)
    return list(zip(distinct.tolist(), np.split(np.argsort(vertices, kind="stable"), first[1:]), strict=True))
