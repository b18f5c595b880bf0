"""Geodesic distances: rows from farthest-point samples, low-rank factors, and the dense matrix of small meshes."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from clalign.geometry.heat import FarthestPoints, HeatMethod, Surface, farthest_points
from clalign.geometry.operators import lumped_mass
from clalign.mesh.mesh import Mesh

logger = logging.getLogger(__name__)

Sampler = Callable[[Surface, int, int, int], FarthestPoints]

#: Bound of (samples × vertices): a row of the heat method takes about half a microsecond a vertex on one core.
ROW_VERTICES = 20_000_000


@dataclass(frozen=True)
class Geodesics:
    """Distances from farthest-point samples, in the length unit of the mesh.

    Attributes
    ----------
    samples : (S,) int64, vertices in farthest-point order: the first s of them are a farthest-point sampling too.
    distances : (S, S) float64 between samples, symmetric with zero diagonal.
    rows : (N, n) float32 from the first N samples to all vertices.
    weights : (S,) float64, share of the area that is closest to each sample; sums to 1.
    """

    samples: NDArray[np.int64]
    distances: NDArray[np.float64]
    rows: NDArray[np.float32]
    weights: NDArray[np.float64]

    def sample_weights(self, count: int) -> NDArray[np.float64]:
        """Return the area shares of the first `count` samples, those of later samples given to the nearest of them."""
        return prefix_shares(self.distances, self.weights, count)


def prefix_shares(distances: NDArray[np.float64], weights: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return the (count,) area shares of the first samples when those of later ones go to the nearest of them.

    Parameters
    ----------
    distances : (S, S) between samples.
    weights : (S,) area shares of all samples.
    """
    nearest = distances[:count].argmin(axis=0)
    return np.bincount(nearest, weights=weights, minlength=count).astype(np.float64)


@dataclass(frozen=True)
class DistanceFactors:
    """All geodesic distances of a shape in low rank, D ≈ U T Uᵀ.

    Attributes
    ----------
    left : (n, r) float64, U, orthonormal in the vertex areas.
    core : (r, r) float64, T, symmetric.
    """

    left: NDArray[np.float64]
    core: NDArray[np.float64]


def farthest_point_geodesics(
    mesh: Mesh, search_samples: int, factor_samples: int, sampler: Sampler = farthest_points
) -> Geodesics:
    """Sample vertices, each as far as possible from those before, and measure distances from them.

    The first sample is the vertex farthest from the one nearest to the centroid, so that the samples do not depend on
    how the vertices are numbered. The work is proportional to samples × vertices; above `ROW_VERTICES` fewer samples
    than asked for are taken, never less than `factor_samples`, which is logged. Memory: only N full rows are kept.

    Parameters
    ----------
    mesh : of unit area.
    search_samples : S, samples whose mutual distances are kept.
    factor_samples : N, samples whose full rows are kept (at most S).
    sampler : `heat.farthest_points`, or what does the same elsewhere.

    Raises
    ------
    MeshError
        The heat method fails on the mesh.
    """
    n = mesh.n_vertices
    count = affordable_samples(n, search_samples, factor_samples)
    if count < min(search_samples, n):
        logger.info("%s: %d geodesic samples instead of %d (%d vertices)", mesh.name, count, search_samples, n)
    mass = lumped_mass(mesh.vertices, mesh.faces)
    surface = Surface(mesh.vertices, mesh.faces, mass, mesh.name)
    found = sampler(surface, _central_vertex(mesh, mass), count, min(factor_samples, count))
    between = found.between.astype(np.float64)
    return Geodesics(
        samples=found.samples,
        distances=0.5 * (between + between.T),
        rows=found.rows,
        weights=found.areas / found.areas.sum(),
    )


def affordable_samples(vertices: int, search_samples: int, factor_samples: int) -> int:
    """Return the number of samples that `farthest_point_geodesics` takes on a mesh of so many vertices."""
    return min(search_samples, vertices, max(ROW_VERTICES // vertices, factor_samples))


def _central_vertex(mesh: Mesh, mass: NDArray[np.float64]) -> int:
    centre = mass @ mesh.vertices / mass.sum()
    return int(np.square(mesh.vertices - centre).sum(axis=1).argmin())


def low_rank(geodesics: Geodesics, mass: NDArray[np.float64], rank: int | None = None) -> DistanceFactors:
    """Return factors of the matrix of all distances from the rows of the first N samples.

    With R the (n, N) columns of D at the samples and V Λ Vᵀ their N × N block, D ≈ R V Λ⁻¹ Vᵀ Rᵀ over the pairs whose
    |λ| is largest (Shamai, Zibulevsky and Kimmel). Half of them are kept: the small ones are errors of the heat
    method, and their inverses would be the largest numbers in the product.

    Parameters
    ----------
    geodesics : from `farthest_point_geodesics`.
    mass : (n,) vertex areas.
    rank : number of pairs kept; None for N / 2.
    """
    count = len(geodesics.rows)
    kept = max(count // 2, 1) if rank is None else min(rank, count)
    values, vectors = np.linalg.eigh(geodesics.distances[:count, :count])
    strongest = np.sort(np.argsort(-np.abs(values), kind="stable")[:kept])
    columns = geodesics.rows.T.astype(np.float64) @ vectors[:, strongest]
    root = np.sqrt(mass)[:, None]
    left, triangle = scipy.linalg.qr(columns * root, mode="economic", check_finite=False)
    core = (triangle / values[strongest]) @ triangle.T
    return DistanceFactors(left=left / root, core=0.5 * (core + core.T))


def all_pairs(mesh: Mesh) -> NDArray[np.float64]:
    """Return the (n, n) distances between all vertices, symmetric with zero diagonal. For small meshes."""
    heat = HeatMethod(mesh.vertices, mesh.faces, mesh.name)
    distances = np.stack([heat.row(vertex) for vertex in range(mesh.n_vertices)])
    return 0.5 * (distances + distances.T)
