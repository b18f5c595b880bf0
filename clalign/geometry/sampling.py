"""Samples that are spread over a shape, and orders of its vertices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from clalign.geometry.heat import Geodesics

LEAF = 16
"""Vertices that follow each other in no particular order: about as many points as a group of a backend has."""


@dataclass(frozen=True)
class Samples:
    """Vertices spread evenly over a shape.

    Attributes
    ----------
    vertices : (S,) int64.
    weights : (S,) float64, share of the area that is closest to each; sums to 1.
    """

    vertices: NDArray[np.int64]
    weights: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class VertexOrder:
    """An order of the vertices of a shape, as a permutation and its inverse.

    Attributes
    ----------
    vertices : (n,) int64, which vertex comes at each place.
    inverse : (n,) int64, the place of each vertex.
    """

    vertices: NDArray[np.int64]
    inverse: NDArray[np.int64]

    @staticmethod
    def of(permutation: NDArray[np.integer]) -> VertexOrder:
        """Return the order in which vertex ``permutation[i]`` comes at place i."""
        vertices = np.asarray(permutation, dtype=np.int64)
        inverse = np.empty_like(vertices)
        inverse[vertices] = np.arange(vertices.size)
        return VertexOrder(vertices, inverse)

    @staticmethod
    def spatial(points: NDArray[np.float64]) -> VertexOrder:
        """Return an order in which points (n, 3) near each other come near each other: that of the leaves of a tree."""
        return VertexOrder.of(cKDTree(points, leafsize=LEAF).indices)

    @staticmethod
    def identity(count: int) -> VertexOrder:
        """Return the order in which `count` vertices are numbered."""
        return VertexOrder.of(np.arange(count))


def spread_samples(points: NDArray[np.float64], mass: NDArray[np.float64], geodesics: Geodesics, count: int) -> Samples:
    """Return the first `count` farthest-point samples of a surface, and more where it has fewer.

    Large meshes have few geodesic samples; what is missing is chosen farthest from those before in space, which spreads
    them as evenly but for parts that touch.

    Parameters
    ----------
    points, mass : (n, 3) and (n,), of the vertices.
    count : samples; all vertices where there are fewer.
    """
    geodesic = geodesics.samples[:count]
    wanted = min(count, len(points))
    if geodesic.size < wanted:
        vertices = _farthest_in_space(points, geodesic, wanted)
        _, nearest = cKDTree(points[vertices]).query(points)
        weights = np.bincount(nearest, weights=mass, minlength=wanted).astype(np.float64)
    else:
        vertices, weights = geodesic, geodesics.sample_weights(geodesic.size)
    return Samples(vertices, weights)


def _farthest_in_space(points: NDArray[np.float64], chosen: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Extend `chosen` to `count` points, each farthest in space from those before."""
    gaps, _ = cKDTree(points[chosen]).query(points)
    squares = gaps**2
    # Vertices may coincide; none is taken twice.
    squares[chosen] = -1.0
    added = list(chosen)
    while len(added) < count:
        following = int(squares.argmax())
        added.append(following)
        np.minimum(squares, np.sum((points - points[following]) ** 2, axis=1), out=squares)
        squares[following] = -1.0
    return np.array(added, dtype=np.int64)
