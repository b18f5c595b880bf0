"""The heat method, and the farthest-point samples that are drawn with it.

It is imported by the interpreter of `heat_process` too, which starts the sooner the less is imported here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clalign.errors import MeshError


@dataclass(frozen=True)
class Surface:
    """What sampling reads of a mesh: vertices (n, 3), faces (m, 3), vertex areas (n,), name for messages."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    mass: NDArray[np.float64]
    name: str


@dataclass(frozen=True)
class FarthestPoints:
    """Farthest-point samples with their distances.

    Attributes
    ----------
    samples : (S,) int64, vertices.
    between : (S, S) float32, distances from each sample to all samples, as computed, so not quite symmetric.
    rows : (N, n) float32 from the first N samples to all vertices.
    areas : (S,) float64, area that is closest to each sample.
    """

    samples: NDArray[np.int64]
    between: NDArray[np.float32]
    rows: NDArray[np.float32]
    areas: NDArray[np.float64]


class HeatMethod:
    """Distances from single vertices by the heat method, factorised once.

    Parameters
    ----------
    vertices : (n, 3).
    faces : (m, 3).
    name : of the mesh, for messages.

    Raises
    ------
    MeshError
        The mesh cannot be handled (not manifold, for example).
    """

    def __init__(self, vertices: NDArray[np.float64], faces: NDArray[np.int32], name: str) -> None:
        import potpourri3d

        try:
            self._solver = potpourri3d.MeshHeatMethodDistanceSolver(vertices, faces)
        except RuntimeError as error:
            raise MeshError(f"{name}: geodesic distances cannot be computed ({error})") from error
        self._name = name

    def row(self, vertex: int) -> NDArray[np.float64]:
        """Return the (n,) distances from one vertex; zero there and nowhere negative."""
        distances: NDArray[np.float64] = np.asarray(self._solver.compute_distance(int(vertex)), dtype=np.float64)
        np.maximum(distances, 0.0, out=distances)
        distances[vertex] = 0.0
        if not np.isfinite(distances).all():
            raise MeshError(f"{self._name}: distances from vertex {vertex} are not finite; look for degenerate faces")
        return distances


def farthest_points(
    surface: Surface, central: int, count: int, kept: int, watch: Callable[[], None] | None = None
) -> FarthestPoints:
    """Sample vertices, each as far as possible from those before, and measure distances from them.

    Parameters
    ----------
    surface : what is sampled.
    central : the first sample is the vertex farthest from this one.
    count : S, at most n.
    kept : N, at most S.
    watch : called before every sample; what it raises ends the sampling.

    Raises
    ------
    MeshError
        The heat method fails on the mesh.
    """
    n = len(surface.vertices)
    heat = HeatMethod(surface.vertices, surface.faces, surface.name)
    samples = np.zeros(count, dtype=np.int64)
    rows = np.zeros((count, n), dtype=np.float32)
    gap = np.full(n, np.inf, dtype=np.float32)
    owner = np.zeros(n, dtype=np.int64)
    following = int(heat.row(central).argmax())
    for index in range(count):
        if watch is not None:
            watch()
        samples[index] = following
        rows[index] = heat.row(following)
        closer = rows[index] < gap
        gap[closer] = rows[index, closer]
        owner[closer] = index
        # A sample keeps its own cell, and is never taken twice, even where vertices coincide.
        gap[following] = -1.0
        owner[following] = index
        following = int(gap.argmax())
    # The factors and the rows beyond the first are the largest arrays, and what comes of them is to be sent away.
    del heat
    between = np.ascontiguousarray(rows[:, samples])
    if kept < count:
        rows = rows[:kept].copy()
    areas = np.bincount(owner, weights=surface.mass, minlength=count).astype(np.float64)
    return FarthestPoints(samples=samples, between=between, rows=rows, areas=areas)
