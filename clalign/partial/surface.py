"""A surface, whole or a part, with what its match with another one of a different extent is found by."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse import csgraph

from clalign.geometry.heat import FastMarching, HeatMethod, distance_solver
from clalign.geometry.operators import lumped_mass, mean_curvature, stiffness
from clalign.geometry.spectra import Spectrum, solve
from clalign.geometry.workers import processor_count
from clalign.mesh.mesh import Mesh
from clalign.mesh.topology import boundary_vertices
from clalign.part_rules import PartSampleRules

Solver = HeatMethod | FastMarching


@dataclass(frozen=True, eq=False)
class Rim:
    """Samples of a boundary.

    Attributes
    ----------
    vertices : (b,) int64.
    rows : (b, n) float32, distances from them along the surface.
    between : (b, b) float64, straight distances between them.
    """

    vertices: NDArray[np.int64]
    rows: NDArray[np.float32]
    between: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SampledSurface:
    """A surface in a unit of length that it shares with the other one.

    Attributes
    ----------
    mesh : connectivity and file numbers; its vertices are in its own unit.
    vertices : (n, 3) in the common unit, and so is all else.
    mass : (n,) vertex areas.
    stiffness : (n, n) cotangent matrix, free of units.
    curvature : (n,) mean curvature, 0 on the boundary, where it cannot be told.
    basis : Neumann eigenfunctions of the Laplace–Beltrami operator.
    to_boundary : (n,) distance to the boundary, infinite without one.
    samples : (S,) int64, each as far as possible from those before.
    rows : (S, n) float32, distances from the samples along this surface.
    rim : samples of the boundary.
    """

    mesh: Mesh
    vertices: NDArray[np.float64]
    mass: NDArray[np.float64]
    stiffness: sparse.csr_matrix
    curvature: NDArray[np.float64]
    basis: Spectrum
    to_boundary: NDArray[np.float64]
    samples: NDArray[np.int64]
    rows: NDArray[np.float32]
    rim: Rim

    @property
    def area(self) -> float:
        """Area of the surface."""
        return float(self.mass.sum())

    @property
    def closed(self) -> bool:
        """Whether the surface has no boundary."""
        return not len(self.rim.vertices)

    def scaled(self, factor: float) -> SampledSurface:
        """Return the same surface with all lengths multiplied by a factor."""
        basis, rim = self.basis, self.rim
        area = factor * factor
        return replace(
            self,
            vertices=factor * self.vertices,
            mass=area * self.mass,
            curvature=self.curvature / factor,
            basis=Spectrum(basis.eigenvalues / area, basis.functions / factor, area * basis.mass),
            to_boundary=factor * self.to_boundary,
            rows=np.float32(factor) * self.rows,
            rim=Rim(rim.vertices, np.float32(factor) * rim.rows, factor * rim.between),
        )

    def lower_rows(self) -> NDArray[np.float32]:
        """Return (S, n) lower bounds of the distances that the samples have on any surface of which this is a part.

        A path on the whole may leave the part and come back; what lies outside is at least as long as the straight
        line. So it is the shortest path in a graph of samples and boundary samples in which the latter are also joined
        by straight lines ("wormholes": Bracha, Halimi & Kimmel 2020).
        """
        if self.closed:
            return self.rows
        rim = self.rim
        count = len(self.samples)
        nodes = np.concatenate([self.samples, rim.vertices])
        graph = np.concatenate([self.rows, rim.rows])[:, nodes].astype(np.float64)
        graph = np.minimum(graph, graph.T)
        graph[count:, count:] = np.minimum(graph[count:, count:], rim.between)
        # An explicit zero would be no edge.
        shortest = csgraph.shortest_path(np.maximum(graph, 1e-9), method="FW")[:count, count:]
        lower = self.rows.copy()
        for number, row in enumerate(rim.rows):
            np.minimum(lower, shortest[:, number, None].astype(np.float32) + row[None], out=lower)
        return lower


def sampled_surface(
    mesh: Mesh, samples: int, functions: int, margin: float, rules: PartSampleRules, quantile: float, *, marched: bool
) -> SampledSurface:
    """Prepare a surface in the unit of its mesh, in which its area is 1.

    Parameters
    ----------
    samples : that are drawn.
    functions : eigenfunctions.
    margin : samples lie at least so far from the boundary, if that leaves half of the area.
    quantile : at which mean curvature is cut.
    marched : march fronts, which takes four times as long as heat and does not mind boundaries.

    Raises
    ------
    MeshError
        Distances cannot be computed on the mesh.
    ConvergenceError
        An eigenpair is not accurate.
    """
    vertices, faces, n = mesh.vertices, mesh.faces, mesh.n_vertices
    mass, weights = lumped_mass(vertices, faces), stiffness(vertices, faces)
    on_boundary = boundary_vertices(faces, n)
    curvature = np.where(on_boundary, 0.0, mean_curvature(vertices, faces, mass, weights))
    limit = float(np.quantile(np.abs(curvature), quantile))
    front = FastMarching(vertices, faces, mesh.name)
    solver = front if marched else distance_solver(vertices, faces, mesh.name)
    to_boundary = front.from_all(np.flatnonzero(on_boundary)) if on_boundary.any() else np.full(n, np.inf)
    inside = to_boundary >= margin
    if mass[inside].sum() < 0.5 * mass.sum():
        inside = to_boundary >= np.quantile(to_boundary, 0.4)
    chosen, rows = _spread(solver, inside, to_boundary if on_boundary.any() else _depth(vertices, mass), samples)
    return SampledSurface(
        mesh=mesh,
        vertices=vertices,
        mass=mass,
        stiffness=weights,
        curvature=np.clip(curvature, -limit, limit),
        basis=solve(weights, mass, functions, processor_count()),
        to_boundary=to_boundary,
        samples=chosen,
        rows=rows,
        rim=_rim(solver, vertices, on_boundary, rules.boundary),
    )


def _depth(vertices: NDArray[np.float64], mass: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return minus the distance of each vertex from the centroid: where sampling starts on a closed surface."""
    centre = mass @ vertices / mass.sum()
    return -np.linalg.norm(vertices - centre, axis=1)


def _rim(solver: Solver, vertices: NDArray[np.float64], on_boundary: NDArray[np.bool_], count: int) -> Rim:
    if not on_boundary.any():
        return Rim(np.zeros(0, np.int64), np.zeros((0, len(vertices)), np.float32), np.zeros((0, 0)))
    chosen, rows = _farthest(solver, on_boundary, int(np.flatnonzero(on_boundary)[0]), count)
    places = vertices[chosen]
    return Rim(chosen, rows, np.linalg.norm(places[:, None] - places[None], axis=2))


def _spread(
    solver: Solver, allowed: NDArray[np.bool_], depth: NDArray[np.float64], count: int
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Return farthest-point samples among allowed vertices; the first is the farthest from the deepest of them."""
    deepest = int(np.where(allowed, depth, -np.inf).argmax())
    first = int(np.where(allowed, solver.row(deepest), -1.0).argmax())
    return _farthest(solver, allowed, first, count)


def _farthest(
    solver: Solver, allowed: NDArray[np.bool_], first: int, count: int
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    following, chosen, rows = first, [], []
    gap = np.full(len(allowed), np.inf)
    for _ in range(min(count, int(allowed.sum()))):
        chosen.append(following)
        rows.append(solver.row(following).astype(np.float32))
        gap = np.minimum(gap, rows[-1])
        gap[following] = -1.0
        following = int(np.where(allowed, gap, -2.0).argmax())
    return np.array(chosen, dtype=np.int64), np.stack(rows)
