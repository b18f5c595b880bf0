"""Points in faces: exact on flat surfaces in any dimension, and never worse than any other point nearby."""

from __future__ import annotations

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from clalign.refinement.precise import SurfacePoints, closest_points

DIMENSION = 7


def embedded(points: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Place points of the plane or of space in more dimensions, distances kept."""
    frame = np.linalg.qr(rng.normal(size=(DIMENSION, points.shape[1])))[0]
    return points @ frame.T + rng.normal(size=DIMENSION)


@pytest.fixture
def grid() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices (49, 2) and triangles of a flat square."""
    x, y = np.meshgrid(np.arange(7.0), np.arange(7.0))
    first = (np.arange(6)[:, None] * 7 + np.arange(6)).ravel()
    faces = np.concatenate([np.stack([first, first + 1, first + 8], 1), np.stack([first, first + 8, first + 7], 1)])
    return np.stack([x.ravel(), y.ravel()], axis=1), faces


def places(found: SurfacePoints, corners: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    return np.einsum("nc,ncd->nd", found.barycentric, corners[faces[found.faces]])


def test_points_of_a_flat_surface_are_found_exactly(
    grid: tuple[NDArray[np.float64], NDArray[np.int64]], rng: np.random.Generator
) -> None:
    vertices, faces = grid
    surface = embedded(vertices, rng)
    weights = rng.dirichlet(np.ones(3), 300)
    chosen = rng.integers(0, len(faces), 300)
    queries = np.einsum("nc,ncd->nd", weights, surface[faces[chosen]])
    # A little off the plane, the closest point is the same.
    normal = np.linalg.svd(surface - surface.mean(axis=0))[2][-1]
    nearest = cKDTree(surface).query(queries)[1]
    found = closest_points(queries + 0.3 * normal, surface, faces.astype(np.int32), nearest)
    np.testing.assert_allclose(places(found, surface, faces), queries, atol=1e-9)
    np.testing.assert_allclose(found.barycentric.sum(axis=1), 1.0)
    assert found.barycentric.min() >= 0.0


def test_beyond_the_border_the_closest_point_lies_on_it(
    grid: tuple[NDArray[np.float64], NDArray[np.int64]], rng: np.random.Generator
) -> None:
    vertices, faces = grid
    queries = np.array([[-1.0, 2.3], [3.4, 9.0], [-2.0, -5.0]])
    nearest = cKDTree(vertices).query(queries)[1]
    found = closest_points(queries, vertices, faces.astype(np.int32), nearest)
    np.testing.assert_allclose(places(found, vertices, faces), [[0.0, 2.3], [3.4, 6.0], [0.0, 0.0]], atol=1e-12)


def test_no_point_of_the_faces_around_is_closer(rng: np.random.Generator) -> None:
    vertices, faces = shapes.bumpy_sphere(2)
    surface = embedded(vertices, rng)
    queries = surface[rng.integers(0, len(surface), 60)] + 0.1 * rng.normal(size=(60, DIMENSION))
    nearest = cKDTree(surface).query(queries)[1]
    found = closest_points(queries, surface, faces.astype(np.int32), nearest)
    distances = np.linalg.norm(places(found, surface, faces) - queries, axis=1)
    for query, vertex, distance in zip(queries, nearest, distances, strict=True):
        around = faces[(faces == vertex).any(axis=1)]
        tried = np.einsum("sc,fcd->sfd", rng.dirichlet(np.ones(3), 400), surface[around]).reshape(-1, DIMENSION)
        assert distance <= np.linalg.norm(tried - query, axis=1).min() + 1e-12
        assert distance <= np.linalg.norm(surface[vertex] - query) + 1e-12
