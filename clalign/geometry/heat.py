"""The heat method, and the farthest-point samples that are drawn with it.

It is imported by the interpreter of `heat_process` too, which starts the sooner the less is imported here.
"""

from __future__ import annotations

import os
import pickle
import sys
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


class HeatMethod:
    """Distances from single vertices by the heat method, factorised once; `name` is for messages.

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
        The heat method fails on the mesh.
    """
    n = len(surface.vertices)
    heat = HeatMethod(surface.vertices, surface.faces, surface.name)
    samples = np.zeros(count, dtype=np.int64)
    rows = np.zeros((count, n), dtype=np.float32)
    gap = np.full(n, np.inf, dtype=np.float32)
    owner = np.zeros(n, dtype=np.int64)
    centre = surface.mass @ surface.vertices / surface.mass.sum()
    central = np.square(surface.vertices - centre).sum(axis=1).argmin()
    following = int(heat.row(int(central)).argmax())
    for index in range(count):
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
