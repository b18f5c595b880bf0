"""Geodesic distances: rows from farthest-point samples, low-rank factors, and the dense matrix of small meshes."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from clalign.geometry.heat import Geodesics, Surface, diffusion_time, distance_solver, farthest_points
from clalign.geometry.operators import lumped_mass
from clalign.mesh.mesh import Mesh

logger = logging.getLogger(__name__)

Sampler = Callable[[Surface, int, int], Geodesics]

#: Bound of (samples × vertices): a row of the heat method takes about half a microsecond a vertex on one core.
ROW_VERTICES = 20_000_000


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
    """Return the distances from farthest-point samples of a mesh (see `heat.farthest_points`).

    The work is proportional to samples × vertices; above `ROW_VERTICES` fewer samples than asked for are taken, never
    less than `factor_samples`, which is logged. Memory: only N full rows are kept.

    Parameters
    ----------
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
    time = diffusion_time(mesh.vertices, mesh.faces)
    surface = Surface(mesh.vertices, mesh.faces, mass, mesh.name, time)
    return sampler(surface, count, min(factor_samples, count))


def affordable_samples(vertices: int, search_samples: int, factor_samples: int) -> int:
    """Return the number of samples that `farthest_point_geodesics` takes on a mesh of so many vertices."""
    return min(search_samples, vertices, max(ROW_VERTICES // vertices, factor_samples))


def low_rank(geodesics: Geodesics, mass: NDArray[np.float64], rank: int | None = None) -> DistanceFactors:
    """Return factors of the matrix of all distances from the rows of the first N samples, and vertex areas (n,).

    With R the (n, N) columns of D at the samples and V Λ Vᵀ their N × N block, D ≈ R V Λ⁻¹ Vᵀ Rᵀ over the pairs whose
    |λ| is largest (Shamai, Zibulevsky and Kimmel). Half of them are kept: the small ones are errors of the heat
    method, and their inverses would be the largest numbers in the product.

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
    solver = distance_solver(mesh.vertices, mesh.faces, mesh.name)
    distances = np.stack([solver.row(vertex) for vertex in range(mesh.n_vertices)])
    return 0.5 * (distances + distances.T)
