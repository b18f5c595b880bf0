"""Surfaces through points: of the right kind, on the points, and without regard to how they lie or are numbered."""

from __future__ import annotations

import logging
from pathlib import Path

import malformed
import numpy as np
import pytest
import shapes
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from clalign.errors import MeshError
from clalign.mesh.checks import diagnose
from clalign.mesh.cloud import surface_of_points
from clalign.mesh.mesh import as_mesh, load_mesh, mesh_from_arrays
from clalign.mesh.topology import face_areas, signed_volume

Points = NDArray[np.float64]


def ball(rng: np.random.Generator, count: int = 2000) -> Points:
    points = rng.standard_normal((count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def torus(rng: np.random.Generator, count: int = 4000) -> Points:
    u, v = rng.uniform(0, 2 * np.pi, (2, count))
    reach = 1 + 0.4 * np.cos(v)
    return np.stack([reach * np.cos(u), reach * np.sin(u), 0.4 * np.sin(v)], axis=1)


@pytest.mark.parametrize(("cloud", "genus", "area", "volume"), [
    (ball, 0, 4 * np.pi, 4 * np.pi / 3),
    (torus, 1, 4 * np.pi**2 * 0.4, 2 * np.pi**2 * 0.4**2),
])  # fmt: skip
def test_closed_bodies(cloud: object, genus: int, area: float, volume: float, rng: np.random.Generator) -> None:
    assert callable(cloud)
    points = cloud(rng)
    found = diagnose(points, ())
    assert (found.genus, found.boundary_loops, found.components) == (genus, 0, 1)
    assert found.surface is not None
    assert face_areas(points, found.surface.file_index[found.surface.faces]).sum() == pytest.approx(area, rel=0.03)
    assert signed_volume(points, found.surface.file_index[found.surface.faces]) == pytest.approx(volume, rel=0.03)
    assert (found.surface.vertex_of_file() >= 0).all()


def test_the_surface_does_not_depend_on_place_and_number(rng: np.random.Generator) -> None:
    points = shapes.bumpy_sphere(4)[0] + 1e-4 * rng.standard_normal((2562, 3))
    order = rng.permutation(len(points))
    moved = 7.0 * Rotation.from_euler("xyz", [0.4, 1.0, 2.0]).apply(points[order]) + [3.0, -8.0, 2.0]
    given = {tuple(sorted(face)) for face in surface_of_points(points).tolist()}
    other = {tuple(sorted(face)) for face in order[surface_of_points(moved)].tolist()}
    assert len(given & other) > 0.995 * len(given | other)


def test_an_open_sheet_has_a_boundary_and_the_front_of_its_normals(rng: np.random.Generator) -> None:
    flat = rng.uniform(-1, 1, (3000, 2))
    sheet = np.column_stack([flat, 0.2 * np.sin(2 * flat[:, 0])])
    for sign in (1.0, -1.0):
        found = diagnose(sheet, (), normals=np.tile([0.0, 0.0, sign], (len(sheet), 1)))
        assert found.surface is not None
        assert found.boundary_loops >= 1
        corners = found.surface.vertices[found.surface.faces]
        upward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
        assert np.sign(upward.sum()) == sign
        assert (found.surface.vertex_of_file() >= 0).mean() > 0.97


@pytest.mark.parametrize("wave", ["saddle", "ripples", "bump"])
def test_curved_sheets_are_open(wave: str, rng: np.random.Generator) -> None:
    x, y = rng.uniform(-1, 1, (2, 3000))
    height = {
        "saddle": 0.3 * np.sin(2 * x) * np.cos(y),
        "ripples": 0.2 * np.sin(5 * x),
        "bump": 0.6 * np.exp(-6 * (x**2 + y**2)),
    }[wave]
    found = diagnose(np.column_stack([x, y, height]), (), normals=np.tile([0.0, 0.0, 1.0], (3000, 1)))
    assert found.surface is not None
    corners = found.surface.vertices[found.surface.faces]
    projected = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    assert projected.sum() == pytest.approx(4.0, rel=0.06)
    assert (projected > 0).mean() > 0.99


def test_repeated_points_are_one(rng: np.random.Generator) -> None:
    points = ball(rng, 700)
    found = diagnose(np.concatenate([points] * 6), ())
    assert (found.genus, found.boundary_loops) == (0, 0)
    assert found.surface is not None
    assert (found.surface.vertex_of_file() >= 0).all()


def test_holes_of_the_cloud_stay_holes(rng: np.random.Generator) -> None:
    points = ball(rng, 6000)
    found = diagnose(points[points[:, 2] < 0.93], ())
    assert (found.boundary_loops, found.genus) == (1, 0)


def test_points_beside_the_surface_have_the_match_of_the_nearest_and_far_ones_have_none(
    rng: np.random.Generator,
) -> None:
    points = np.concatenate([ball(rng), [[0.0, 0, 0.99], [0.0, 0, 0], [np.nan, 0, 0], [0, 0.97, 0]]])
    mesh = mesh_from_arrays(points)
    on_surface = mesh.vertex_of_file >= 0
    np.testing.assert_array_equal(on_surface[2000:], [True, False, False, True])
    gap = np.linalg.norm(mesh.file_positions()[on_surface] - points[on_surface], axis=1)
    assert gap.max() < 0.1
    assert any("points have no faces" in note for note in mesh.notes)


def test_files_and_arrays_of_points(rng: np.random.Generator, tmp_path: Path) -> None:
    points = ball(rng, 500)
    path = tmp_path / "ball.xyz"
    np.savetxt(path, points)
    np.testing.assert_allclose(load_mesh(path).file_positions(), as_mesh(points).file_positions(), atol=1e-9)
    with pytest.raises(MeshError, match="500 vertices but no faces"):
        load_mesh(path, strict=True)


@pytest.mark.parametrize("points", [np.zeros((40, 3)), np.linspace(0, 1, 40)[:, None] * np.ones(3)])
def test_points_on_no_surface_are_refused(points: Points, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.ERROR)
    with pytest.raises(MeshError, match=r"no faces|zero area|in no face|only \d+ vertices"):
        mesh_from_arrays(points)


def test_points_in_a_plane_are_a_sheet() -> None:
    vertices, _ = malformed.grid(12, 15)
    mesh = mesh_from_arrays(vertices)
    assert mesh.n_vertices >= 0.95 * len(vertices)
