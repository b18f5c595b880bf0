from __future__ import annotations

import sys

import assembled
import malformed
import numpy as np
import pytest
import shapes

from clalign.benchmark import perturb
from clalign.errors import InputError
from clalign.mesh.mesh import Mesh, mesh_from_arrays
from clalign.mesh.topology import vertex_normals


def mean_edge_length(mesh: Mesh) -> float:
    corners = mesh.file_vertices()[mesh.faces]
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean())


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    vertices, faces = shapes.bumpy_sphere(3)
    padded = np.concatenate([[[5.0, 5, 5]], vertices])
    return mesh_from_arrays(padded * 3.0 + 1.0, faces + 1, "bumpy")


def positions(mesh: Mesh) -> np.ndarray:
    """File positions by file number; those off the surface are not numbers."""
    table = np.full((mesh.file_count, 3), np.nan)
    table[mesh.file_index] = mesh.file_vertices()
    return table


def test_renumbering_moves_nothing(mesh: Mesh) -> None:
    moved = perturb.renumber(mesh, seed=1)
    new = moved.truth.target_points
    np.testing.assert_array_equal(np.sort(new), np.arange(mesh.file_count))
    np.testing.assert_allclose(positions(moved.mesh)[new], positions(mesh), equal_nan=True)
    assert np.mean(new == np.arange(mesh.file_count)) < 0.05
    assert (np.diff(moved.mesh.file_index) > 0).all()

    def triangles(shape: Mesh, number: np.ndarray) -> set[tuple[int, ...]]:
        corners = number[shape.file_index[shape.faces]]
        first = corners.argmin(axis=1)
        return {tuple(np.roll(face, -turn)) for face, turn in zip(corners, first, strict=True)}

    assert triangles(mesh, new) == triangles(moved.mesh, np.arange(mesh.file_count))


@pytest.mark.parametrize("direction", ["normal", "any"])
def test_noise_has_the_size_that_was_asked_for(mesh: Mesh, direction: str) -> None:
    moved = perturb.noise(mesh, 0.2, seed=2, direction=direction)  # type: ignore[arg-type]
    shift = moved.mesh.file_vertices()[moved.truth.target_points] - positions(mesh)[moved.truth.source_points]
    edge = mean_edge_length(mesh)
    assert np.sqrt(np.square(shift).sum(axis=1).mean()) == pytest.approx(0.2 * edge, rel=0.1)
    normals = vertex_normals(mesh.file_vertices(), mesh.faces)
    along = np.abs(np.sum(shift * normals, axis=1)) / np.linalg.norm(shift, axis=1)
    assert along.mean() == pytest.approx(1.0 if direction == "normal" else 0.5, abs=0.05)


def test_rotation_and_scale(mesh: Mesh) -> None:
    turned = perturb.rotate(mesh, seed=3)
    before, after = mesh.file_vertices(), turned.mesh.file_vertices()
    np.testing.assert_allclose(np.linalg.norm(after, axis=1), np.linalg.norm(before, axis=1))
    assert np.abs(after - before).max() > 0.5
    large = perturb.scale(mesh, 1000.0)
    np.testing.assert_allclose(large.mesh.file_vertices(), 1000.0 * before)
    assert large.mesh.scale == pytest.approx(1000.0 * mesh.scale)
    np.testing.assert_array_equal(large.truth.source_points, mesh.file_index)


def test_subdivision_keeps_the_surface(mesh: Mesh) -> None:
    fine = perturb.subdivide(mesh)
    assert fine.mesh.n_faces == 4 * mesh.n_faces
    assert fine.mesh.n_vertices - 3 * mesh.n_faces * 2 + fine.mesh.n_faces == 2
    assert fine.mesh.scale == pytest.approx(mesh.scale, rel=1e-12)
    np.testing.assert_allclose(
        positions(fine.mesh)[fine.truth.target_points], positions(mesh)[fine.truth.source_points], atol=1e-12
    )


def test_decimation_keeps_the_shape(mesh: Mesh) -> None:
    coarse = perturb.decimate(mesh, 0.5)
    assert coarse.mesh.n_faces == pytest.approx(0.5 * mesh.n_faces, rel=0.02)
    gap = positions(coarse.mesh)[coarse.truth.target_points] - positions(mesh)[coarse.truth.source_points]
    edge = mean_edge_length(mesh)
    assert np.linalg.norm(gap, axis=1).max() < edge
    assert coarse.mesh.scale == pytest.approx(mesh.scale, rel=0.02)


def test_the_other_side_of_a_thin_plate_is_not_the_nearest() -> None:
    """Two sheets 0.01 apart, sampled so that the nearest vertex is often on the wrong one."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(10.0), np.arange(10.0)))
    corner = np.arange(90)[np.arange(90) % 10 < 9]
    sheet = np.concatenate(
        [np.stack([corner, corner + 1, corner + 10], 1), np.stack([corner + 1, corner + 11, corner + 10], 1)]
    )
    upper, lower = np.stack([x, y, 0 * x], 1), np.stack([x + 0.4, y, 0 * x - 0.01], 1)
    vertices = np.concatenate([upper, lower])
    faces = np.concatenate([sheet, sheet[:, ::-1] + 100])
    queries = upper + np.array([0.4, 0.0, 0.0])
    normals = vertex_normals(vertices, faces), vertex_normals(queries, sheet)
    found = perturb.nearest_on_the_same_side(vertices, normals[0], queries, normals[1])
    assert (found < 100).all()


def test_decimation_names_what_is_missing(mesh: Mesh, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fast_simplification", None)
    with pytest.raises(InputError, match="pip install fast-simplification"):
        perturb.decimate(mesh)
    with pytest.raises(InputError, match="share"):
        perturb.decimate(mesh, 1.5)


def test_changes_of_a_file_with_seams_and_loose_pieces_know_where_each_vertex_went() -> None:
    file = assembled.assembled()
    whole = mesh_from_arrays(file.vertices, file.faces)
    moved = perturb.renumber(whole, seed=3)
    new = moved.truth.target_points
    np.testing.assert_allclose(moved.mesh.file_positions()[new], whole.file_positions(), atol=1e-12)
    np.testing.assert_array_equal(np.sort(moved.mesh.loose.file_index), np.sort(new[file.carried]))
    np.testing.assert_array_equal(*moved.mesh.vertex_of_file[new[file.seam]].T)
    assert (moved.mesh.vertex_of_file[new[file.left_out]] == -1).all()


def test_a_pinched_surface_keeps_its_copies_apart_when_it_is_changed() -> None:
    """The two copies of the vertex that was parted lie at one place; the truth names the same vertex of the file."""
    case = next(case for case in malformed.surfaces() if case.name == "three sheets")
    sheets = mesh_from_arrays(case.vertices, case.faces)
    moved = perturb.rotate(sheets)
    assert moved.truth.count == sheets.n_vertices
    np.testing.assert_array_equal(moved.truth.source_points, sheets.file_index)
    np.testing.assert_allclose(
        np.linalg.norm(moved.mesh.file_positions()[moved.truth.target_points], axis=1),
        np.linalg.norm(sheets.file_vertices(), axis=1),
        atol=1e-9,
    )
