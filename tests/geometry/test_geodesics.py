"""Distances against great circles, samples against what farthest points must do, factors against the dense matrix."""

from __future__ import annotations

import dataclasses
import logging

import analytic
import numpy as np
import pytest
import shapes
from numpy.typing import NDArray

from clalign.errors import MeshError
from clalign.geometry import geodesics, heat
from clalign.geometry.geodesics import all_pairs, farthest_point_geodesics, low_rank
from clalign.geometry.heat import FastMarching, Geodesics, HeatMethod, diffusion_time, distance_solver
from clalign.geometry.operators import lumped_mass
from clalign.mesh.mesh import Mesh


@pytest.fixture(scope="module")
def bumpy() -> Mesh:
    return analytic.as_unit_mesh(analytic.bumpy(3))


@pytest.fixture(scope="module")
def dense(bumpy: Mesh) -> NDArray[np.float64]:
    return all_pairs(bumpy)


@pytest.fixture(scope="module")
def sampled(bumpy: Mesh) -> Geodesics:
    return farthest_point_geodesics(bumpy, 300, 200)


def test_distances_on_a_sphere_are_great_circles() -> None:
    mesh = analytic.as_unit_mesh(analytic.sphere(4))
    found = farthest_point_geodesics(mesh, 60, 20)
    unit = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    radius = 1 / np.sqrt(4 * np.pi)
    exact = radius * np.arccos(np.clip(unit[found.samples] @ unit.T, -1, 1))
    assert np.abs(found.rows - exact[:20]).mean() < 0.006 * np.pi * radius
    assert np.abs(found.distances - exact[:, found.samples]).max() < 0.02 * np.pi * radius


def test_samples_are_farthest_points(bumpy: Mesh, dense: NDArray[np.float64], sampled: Geodesics) -> None:
    """Every sample is the vertex farthest from those before, within the asymmetry of the heat method."""
    assert len(set(sampled.samples.tolist())) == 300
    for index in (1, 2, 10, 100, 299):
        covered = dense[sampled.samples[:index]].min(axis=0)
        assert covered[sampled.samples[index]] >= covered.max() - 0.02 * dense.max()


def test_distances_between_samples(bumpy: Mesh, dense: NDArray[np.float64], sampled: Geodesics) -> None:
    np.testing.assert_array_equal(sampled.distances, sampled.distances.T)
    np.testing.assert_array_equal(sampled.distances.diagonal(), 0.0)
    np.testing.assert_allclose(sampled.distances, dense[np.ix_(sampled.samples, sampled.samples)], atol=1e-6)
    assert sampled.rows.shape == (200, bumpy.n_vertices)
    assert sampled.rows.dtype == np.float32


def test_weights_are_the_areas_nearest_to_each_sample(
    bumpy: Mesh, dense: NDArray[np.float64], sampled: Geodesics
) -> None:
    mass = lumped_mass(bumpy.vertices, bumpy.faces)
    nearest = dense[sampled.samples].argmin(axis=0)
    expected = np.bincount(nearest, weights=mass, minlength=300)
    assert sampled.weights.sum() == pytest.approx(1.0, rel=1e-12)
    assert sampled.weights.min() > 0
    # Vertices half-way between two samples may go to either, as the rows are not symmetric to rounding.
    assert np.abs(sampled.weights - expected).sum() < 0.1


def test_weights_of_fewer_samples(sampled: Geodesics) -> None:
    for count in (1, 20, 300):
        weights = sampled.sample_weights(count)
        assert weights.shape == (count,)
        assert weights.sum() == pytest.approx(1.0, rel=1e-12)
        assert weights.min() > 0
    np.testing.assert_array_equal(sampled.sample_weights(300), sampled.weights)


def test_samples_do_not_depend_on_the_numbering(bumpy: Mesh) -> None:
    vertices, faces, new_of_old = shapes.renumbered(bumpy.vertices, bumpy.faces.astype(np.int64), 6)
    first = farthest_point_geodesics(bumpy, 50, 10)
    second = farthest_point_geodesics(analytic.as_unit_mesh((vertices, faces.astype(np.int32))), 50, 10)
    np.testing.assert_array_equal(second.samples, new_of_old[first.samples])
    np.testing.assert_allclose(second.distances, first.distances, atol=1e-6)


def test_all_vertices_can_be_samples() -> None:
    mesh = analytic.as_unit_mesh(analytic.bumpy(1))
    found = farthest_point_geodesics(mesh, 1000, 100)
    np.testing.assert_array_equal(np.sort(found.samples), np.arange(42))
    np.testing.assert_allclose(found.weights, lumped_mass(mesh.vertices, mesh.faces)[found.samples], rtol=1e-12)
    np.testing.assert_allclose(all_pairs(mesh)[np.ix_(found.samples, found.samples)], found.distances, atol=1e-6)


def errors(bumpy: Mesh, dense: NDArray[np.float64], sampled: Geodesics, count: int, rank: int | None = None) -> float:
    mass = lumped_mass(bumpy.vertices, bumpy.faces)
    factors = low_rank(dataclasses.replace(sampled, rows=sampled.rows[:count]), mass, rank)
    difference = factors.left @ factors.core @ factors.left.T - dense
    return float(np.sqrt((mass @ difference**2 @ mass) / (mass @ dense**2 @ mass)))


def test_low_rank_error_falls_with_the_samples(bumpy: Mesh, dense: NDArray[np.float64], sampled: Geodesics) -> None:
    """Published for a human of ten times as many vertices: 3.5, 1.4, 0.59 and 0.32 % at 20, 50, 100, 200 samples."""
    found = [errors(bumpy, dense, sampled, count) for count in (20, 50, 100, 200)]
    assert np.all(np.diff(found) < 0)
    np.testing.assert_array_less(found, [0.045, 0.018, 0.010, 0.007])


def test_keeping_all_pairs_is_worse_than_keeping_half(
    bumpy: Mesh, dense: NDArray[np.float64], sampled: Geodesics
) -> None:
    assert errors(bumpy, dense, sampled, 200, rank=200) > errors(bumpy, dense, sampled, 200)


def test_factors_are_orthonormal_and_keep_their_product(bumpy: Mesh, sampled: Geodesics) -> None:
    mass = lumped_mass(bumpy.vertices, bumpy.faces)
    factors = low_rank(sampled, mass)
    assert factors.left.shape == (bumpy.n_vertices, 100)
    np.testing.assert_allclose(factors.left.T @ (mass[:, None] * factors.left), np.eye(100), atol=1e-12)
    np.testing.assert_array_equal(factors.core, factors.core.T)
    values, vectors = np.linalg.eigh(sampled.distances[:200, :200])
    kept = np.argsort(-np.abs(values))[:100]
    columns = sampled.rows.T.astype(np.float64) @ vectors[:, kept]
    direct = (columns / values[kept]) @ columns.T
    np.testing.assert_allclose(factors.left @ factors.core @ factors.left.T, direct, atol=1e-9)


def test_cost_is_bounded_on_large_meshes(
    bumpy: Mesh, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    assert geodesics.affordable_samples(6_890, 1000, 100) == 1000
    assert geodesics.affordable_samples(20_000, 1000, 100) == 1000
    assert geodesics.affordable_samples(100_000, 1000, 100) == 200
    assert geodesics.affordable_samples(5_000_000, 1000, 100) == 100
    monkeypatch.setattr(geodesics, "ROW_VERTICES", 30 * bumpy.n_vertices)
    with caplog.at_level(logging.INFO, logger="clalign"):
        assert len(farthest_point_geodesics(bumpy, 300, 20).samples) == 30
    assert "30 geodesic samples instead of 300" in caplog.text


@pytest.mark.parametrize("wrong", [np.nan, "refused"])
def test_failures_of_the_heat_method_name_the_mesh(bumpy: Mesh, monkeypatch: pytest.MonkeyPatch, wrong: object) -> None:
    class Solver:
        def __init__(self, *_: object, t_coef: float) -> None:
            if wrong == "refused":
                raise RuntimeError("mesh is not manifold")

        def compute_distance(self, _: int) -> NDArray[np.float64]:
            return np.full(bumpy.n_vertices, np.nan)

    monkeypatch.setattr("potpourri3d.MeshHeatMethodDistanceSolver", Solver)
    message = "not manifold" if wrong == "refused" else "not finite"
    with pytest.raises(MeshError, match=f"mesh.*{message}"):
        farthest_point_geodesics(bumpy, 5, 2)


def tube(sections: int, around: int = 12) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """A thin cylinder of radius 0.08 whose sections lie 0.05 apart, closed at neither end."""
    angle = 2 * np.pi * np.arange(around) / around
    ring = 0.08 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    along = 0.05 * np.arange(sections)
    vertices = np.concatenate([np.tile(ring, (sections, 1)), np.repeat(along, around)[:, None]], axis=1)
    i, j = (each.ravel() for each in np.meshgrid(np.arange(sections - 1), np.arange(around), indexing="ij"))
    a, b = i * around + j, i * around + (j + 1) % around
    return vertices, np.concatenate([np.stack([a, b, b + around], 1), np.stack([a, b + around, a + around], 1)])


@pytest.mark.parametrize("sections", [200, 1500, 3000])
def test_distances_along_a_tube_grow_to_its_end(sections: int) -> None:
    """With a diffusion time of one squared edge they are constant beyond some 380 edges."""
    vertices, faces = tube(sections)
    row = distance_solver(vertices, faces.astype(np.int32), "tube").row(0)
    along = vertices[::12, 2]
    np.testing.assert_allclose(row[::12][5:], along[5:], rtol=0.03, atol=0.02 * along[-1])
    if sections > 400:
        assert HeatMethod(vertices, faces.astype(np.int32), "tube", 1.0).row(0).max() < 0.5 * along[-1]


def test_the_diffusion_time_is_that_of_the_paper_where_heat_reaches_everything(bumpy: Mesh) -> None:
    assert diffusion_time(bumpy.vertices, bumpy.faces) == 1.0
    assert diffusion_time(*tube(3000)) > 50


def test_fronts_are_marched_on_large_meshes_to_the_same_distances(
    bumpy: Mesh, dense: NDArray[np.float64], monkeypatch: pytest.MonkeyPatch
) -> None:
    surface = bumpy.vertices, bumpy.faces, bumpy.name
    assert isinstance(distance_solver(*surface), HeatMethod)
    monkeypatch.setattr(heat, "MARCHED", 5.0)
    solver = distance_solver(*surface)
    assert isinstance(solver, FastMarching)
    assert np.abs(solver.row(7) - dense[7]).mean() < 0.015 * dense.max()
