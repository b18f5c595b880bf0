"""Geodesic distances from single vertices, and the farthest-point samples that are drawn with them.

It is imported by the interpreter of `heat_process` too, which starts the sooner the less is imported here.
"""

from __future__ import annotations

import math
import os
import pickle
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.errors import MeshError

#: Square roots of the diffusion time that fit into the diameter: heat farther away than some 380 of them underflows,
#: and the distances there would all be the same. On bodies of 7,000 to 110,000 vertices the mean error is 1 % so.
REACH = 150.0
#: Mean edges along the diameter from which on fronts are marched instead: the heat method is 3 % wrong on a body of
#: 440,000 vertices and 10 % on a tube of 1,500 sections, whatever the time.
MARCHED = 600.0


@dataclass(frozen=True)
class Surface:
    """What sampling reads of a mesh: vertices (n, 3), faces (m, 3), vertex areas (n,), name for messages.

    time : diffusion time in squared mean edges, infinite where fronts are to be marched; see `diffusion_time`.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    mass: NDArray[np.float64]
    name: str
    time: float = 1.0


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

    distances, weights : (S, S) between samples, and (S,) area shares of all.
    """
    nearest = distances[:count].argmin(axis=0)
    return np.bincount(nearest, weights=weights, minlength=count).astype(np.float64)


def diffusion_time(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> float:
    """Return the time that heat needs to reach all of a surface, in squared mean edges and at least 1.

    A time of one squared mean edge gives the best distances nearby (Crane, Weischedel & Wardetzky 2013), but its heat
    underflows on fine or long meshes. The diameter is that of the graph of edges, found by two sweeps; beyond `MARCHED`
    edges the time is infinite.
    """
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import dijkstra

    from clalign.mesh.topology import edge_table

    n = len(vertices)
    low, high = edge_table(faces, n).edges.T
    length = np.linalg.norm(vertices[low] - vertices[high], axis=1)
    # An explicit zero would be no edge.
    graph = csr_matrix((np.maximum(length, np.finfo(np.float64).tiny), (low, high)), shape=(n, n))
    far = int(dijkstra(graph, directed=False, indices=0).argmax())
    diameter = float(dijkstra(graph, directed=False, indices=far).max())
    across = diameter / float(length.mean())
    return math.inf if across > MARCHED else max(1.0, (across / REACH) ** 2)


class HeatMethod:
    """Distances from single vertices by the heat method, factorised once; `name` is for messages.

    time : diffusion time in squared mean edges.

    Raises
    ------
    MeshError
        The mesh cannot be handled (not manifold, for example).
    """

    def __init__(self, vertices: NDArray[np.float64], faces: NDArray[np.int32], name: str, time: float = 1.0) -> None:
        import potpourri3d

        try:
            self._solver = potpourri3d.MeshHeatMethodDistanceSolver(vertices, faces, t_coef=time)
        except RuntimeError as error:
            raise MeshError(f"{name}: geodesic distances cannot be computed ({error})") from error
        self._name = name

    def row(self, vertex: int) -> NDArray[np.float64]:
        """Return the (n,) distances from one vertex; zero there and nowhere negative."""
        return _checked_row(self._solver.compute_distance(int(vertex)), vertex, self._name)


class FastMarching:
    """Distances from single vertices by fast marching (Kimmel & Sethian 1998); see `HeatMethod`.

    It takes one and a half times as long a row or more, and is right at any size: 0.7 % on a body of 7,000 vertices,
    0.1 % at 110,000.
    """

    def __init__(self, vertices: NDArray[np.float64], faces: NDArray[np.int32], name: str) -> None:
        import potpourri3d

        try:
            self._solver = potpourri3d.MeshFastMarchingDistanceSolver(vertices, faces)
        except RuntimeError as error:
            raise MeshError(f"{name}: geodesic distances cannot be computed ({error})") from error
        self._name = name

    def row(self, vertex: int) -> NDArray[np.float64]:
        """Return the (n,) distances from one vertex; zero there and nowhere negative."""
        return _checked_row(self._solver.compute_distance([[(int(vertex), [])]]), vertex, self._name)

    def from_all(self, vertices: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the (n,) distances from the nearest of some vertices."""
        sources: list[list[tuple[int, list[float]]]] = [[(int(vertex), [])] for vertex in vertices]
        return _checked_row(self._solver.compute_distance(sources), int(vertices[0]), self._name)


def _checked_row(values: Any, vertex: int, name: str) -> NDArray[np.float64]:
    distances: NDArray[np.float64] = np.asarray(values, dtype=np.float64)
    np.maximum(distances, 0.0, out=distances)
    distances[vertex] = 0.0
    if not np.isfinite(distances).all():
        raise MeshError(f"{name}: distances from vertex {vertex} are not finite; look for degenerate faces")
    return distances


def distance_solver(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], name: str, time: float | None = None
) -> HeatMethod | FastMarching:
    """Return what measures distances on a surface; `time` is its `diffusion_time`, found if None."""
    known = diffusion_time(vertices, faces) if time is None else time
    return FastMarching(vertices, faces, name) if math.isinf(known) else HeatMethod(vertices, faces, name, known)


def farthest_points(surface: Surface, count: int, kept: int, watch: Callable[[], None] = lambda: None) -> Geodesics:
    """Sample vertices, each as far as possible from those before, and measure distances from them.

    The first sample is the vertex farthest from the one nearest to the centroid, so that the samples do not depend on
    how the vertices are numbered.

    Parameters
    ----------
    surface : what is sampled.
    count : S, at most n.
    kept : N, at most S.
    watch : called before every sample; what it raises ends the sampling.

    Raises
    ------
    MeshError
        Distances cannot be computed on the mesh.
    """
    n = len(surface.vertices)
    solver = distance_solver(surface.vertices, surface.faces, surface.name, surface.time)
    samples = np.zeros(count, dtype=np.int64)
    rows = np.zeros((count, n), dtype=np.float32)
    gap = np.full(n, np.inf, dtype=np.float32)
    owner = np.zeros(n, dtype=np.int64)
    centre = surface.mass @ surface.vertices / surface.mass.sum()
    central = np.square(surface.vertices - centre).sum(axis=1).argmin()
    following = int(solver.row(int(central)).argmax())
    for index in range(count):
        watch()
        samples[index] = following
        rows[index] = solver.row(following)
        closer = rows[index] < gap
        gap[closer] = rows[index, closer]
        owner[closer] = index
        # A sample keeps its own cell, and is never taken twice, even where vertices coincide.
        gap[following] = -1.0
        owner[following] = index
        following = int(gap.argmax())
    # The factors and the rows beyond the first are the largest arrays, and what comes of them is to be sent away.
    del solver
    between = rows[:, samples].astype(np.float64)
    if kept < count:
        rows = rows[:kept].copy()
    areas = np.bincount(owner, weights=surface.mass, minlength=count).astype(np.float64)
    return Geodesics(samples, 0.5 * (between + between.T), rows, areas / areas.sum())


def answer() -> None:
    """Read the arguments of `farthest_points`, pickled, from standard input; write what it returns, or a MeshError."""
    # Native code prints to the standard output; only what is sent may go where the answer goes.
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    found: Geodesics | MeshError
    try:
        found = farthest_points(*pickle.load(sys.stdin.buffer))
    except MeshError as error:
        found = error
    pickle.dump(found, answers, pickle.HIGHEST_PROTOCOL)
    answers.close()
