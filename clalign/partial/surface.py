"""A surface, whole or a part, with what its match with another one of a different extent is found by."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse import csgraph

from clalign.geometry.cache import ShapeCache
from clalign.geometry.geodesics import Sampler, affordable_samples
from clalign.geometry.heat import FastMarching, farthest_points
from clalign.geometry.operators import lumped_mass, mean_curvature, stiffness
from clalign.geometry.shape import stored_basis, stored_geodesics
from clalign.geometry.spectra import Spectrum
from clalign.mesh.mesh import Mesh
from clalign.mesh.topology import boundary_vertices
from clalign.rules.parts import PartRules


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


def whole_surface(
    mesh: Mesh, rules: PartRules, sampler: Sampler = farthest_points, cache: ShapeCache | None = None
) -> SampledSurface:
    """Prepare the surface that others are parts of, in the unit of its mesh, in which its area is 1.

    Parameters
    ----------
    sampler : `heat.farthest_points`, or what does the same elsewhere.
    cache : where spectra and distances are looked up first and stored after; None computes them.

    Raises
    ------
    MeshError
        Distances cannot be computed on the mesh.
    ConvergenceError
        An eigenpair is not accurate.
    """
    count = affordable_samples(mesh.n_vertices, rules.samples.places, rules.samples.fewest)
    geodesics = stored_geodesics(mesh, count, count, sampler, cache)
    front = FastMarching(mesh.vertices, mesh.faces, mesh.name)
    sampled = geodesics.samples, geodesics.rows
    return _surface(mesh, front, sampled, _to_boundary(mesh, front), rules.samples.functions, rules, cache)


def part_surface(
    mesh: Mesh, margin: float, functions: int, rules: PartRules, cache: ShapeCache | None = None
) -> SampledSurface:
    """Prepare a part, in the unit of its mesh, in which its area is 1.

    Distances are marched, which takes four times as long a row as heat, and does not mind boundaries.

    Parameters
    ----------
    margin : samples lie at least so far from the boundary, if that leaves half of the area.
    functions : eigenfunctions.
    cache : for spectra.

    Raises
    ------
    MeshError, ConvergenceError
        See `whole_surface`.
    """
    front = FastMarching(mesh.vertices, mesh.faces, mesh.name)
    mass, to_boundary = lumped_mass(mesh.vertices, mesh.faces), _to_boundary(mesh, front)
    inside = to_boundary >= margin
    if mass[inside].sum() < 0.5 * mass.sum():
        inside = to_boundary >= np.quantile(to_boundary, 0.4)
    depth = to_boundary
    if np.isinf(to_boundary).all():
        depth = -np.linalg.norm(mesh.vertices - mass @ mesh.vertices / mass.sum(), axis=1)
    deepest = int(np.where(inside, depth, -np.inf).argmax())
    first = int(np.where(inside, front.row(deepest), -1.0).argmax())
    sampled = _farthest(front, inside, first, rules.samples.samples)
    return _surface(mesh, front, sampled, to_boundary, functions, rules, cache)


def _surface(
    mesh: Mesh,
    front: FastMarching,
    sampled: tuple[NDArray[np.int64], NDArray[np.float32]],
    to_boundary: NDArray[np.float64],
    functions: int,
    rules: PartRules,
    cache: ShapeCache | None,
) -> SampledSurface:
    vertices, faces = mesh.vertices, mesh.faces
    mass, weights = lumped_mass(vertices, faces), stiffness(vertices, faces)
    on_boundary = boundary_vertices(faces, mesh.n_vertices)
    curvature = np.where(on_boundary, 0.0, mean_curvature(vertices, faces, mass, weights))
    limit = float(np.quantile(np.abs(curvature), rules.descriptors.quantile))
    return SampledSurface(
        mesh=mesh,
        vertices=vertices,
        mass=mass,
        stiffness=weights,
        curvature=np.clip(curvature, -limit, limit),
        basis=stored_basis(mesh, weights, mass, functions, cache),
        to_boundary=to_boundary,
        samples=sampled[0],
        rows=sampled[1],
        rim=_rim(front, vertices, on_boundary, rules.samples.boundary),
    )


def _to_boundary(mesh: Mesh, front: FastMarching) -> NDArray[np.float64]:
    on_boundary = np.flatnonzero(boundary_vertices(mesh.faces, mesh.n_vertices))
    return front.from_all(on_boundary) if on_boundary.size else np.full(mesh.n_vertices, np.inf)


def _rim(front: FastMarching, vertices: NDArray[np.float64], on_boundary: NDArray[np.bool_], count: int) -> Rim:
    if not on_boundary.any():
        return Rim(np.zeros(0, np.int64), np.zeros((0, len(vertices)), np.float32), np.zeros((0, 0)))
    chosen, rows = _farthest(front, on_boundary, int(np.flatnonzero(on_boundary)[0]), count)
    places = vertices[chosen]
    return Rim(chosen, rows, np.linalg.norm(places[:, None] - places[None], axis=2))


def _farthest(
    front: FastMarching, allowed: NDArray[np.bool_], first: int, count: int
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    following, chosen, rows = first, [], []
    gap = np.full(len(allowed), np.inf)
    for _ in range(min(count, int(allowed.sum()))):
        chosen.append(following)
        rows.append(front.row(following).astype(np.float32))
        gap = np.minimum(gap, rows[-1])
        gap[following] = -1.0
        following = int(np.where(allowed, gap, -2.0).argmax())
    return np.array(chosen, dtype=np.int64), np.stack(rows)
