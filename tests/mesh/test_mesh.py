"""Loading, scaling and numbering of meshes, and what must not depend on numbering, place or unit."""

from __future__ import annotations

import numpy as np
import pytest
import shapes
import trimesh

from clalign.errors import MeshError
from clalign.mesh import topology
from clalign.mesh.mesh import Mesh, as_mesh, mesh_from_arrays


def test_unit_area_with_the_file_positions_recoverable() -> None:
    vertices, faces = shapes.bumpy_sphere(3)
    moved = vertices * 250.0 + [1000.0, -20.0, 3.0]
    mesh = mesh_from_arrays(moved, faces)
    areas = topology.face_areas(mesh.vertices, mesh.faces)
    assert areas.sum() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(areas @ mesh.vertices[mesh.faces].mean(axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose(mesh.file_vertices(), moved, rtol=0, atol=1e-10)
    assert mesh.scale == pytest.approx(np.sqrt(topology.face_areas(moved, faces).sum()))
    assert (mesh.vertices.dtype, mesh.faces.dtype, mesh.file_index.dtype) == (np.float64, np.int32, np.int64)


@pytest.mark.parametrize("size", [1e-140, 1e-20, 1e-3, 1e20, 1e140])
def test_the_unit_of_length_changes_nothing(size: float) -> None:
    vertices, faces = shapes.bumpy_sphere(2)
    plain, scaled = mesh_from_arrays(vertices, faces), mesh_from_arrays(vertices * size, faces)
    np.testing.assert_allclose(scaled.vertices, plain.vertices, atol=1e-13)
    assert scaled.scale == pytest.approx(plain.scale * size)
    assert scaled.notes == plain.notes == ()


def test_rotation_and_translation_turn_the_result_only() -> None:
    vertices, faces = shapes.bumpy_sphere(2)
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    plain, moved = mesh_from_arrays(vertices, faces), mesh_from_arrays(vertices @ turn.T + [3.0, 4.0, 5.0], faces)
    np.testing.assert_allclose(moved.vertices, plain.vertices @ turn.T, atol=1e-12)
    np.testing.assert_array_equal(moved.faces, plain.faces)


def test_a_mirrored_body_is_turned_outward() -> None:
    vertices, faces = shapes.bumpy_sphere(2)
    mirrored = mesh_from_arrays(vertices * [-1.0, 1.0, 1.0], faces)
    assert topology.signed_volume(mirrored.vertices, mirrored.faces) > 0
    assert mirrored.notes == ("all faces point inward: turned outward",)


def test_renumbering_renumbers_the_result() -> None:
    vertices, faces = shapes.bumpy_sphere(2)
    shuffled, shuffled_faces, new_of_old = shapes.renumbered(vertices, faces, 11)
    plain, other = mesh_from_arrays(vertices, faces), mesh_from_arrays(shuffled, shuffled_faces)
    np.testing.assert_allclose(other.vertices[new_of_old], plain.vertices, atol=1e-12)
    assert other.scale == pytest.approx(plain.scale, rel=1e-12)


def test_dropped_vertices_keep_the_numbers_of_the_others() -> None:
    vertices, faces = shapes.bumpy_sphere(2)
    n = len(vertices)
    place = np.flatnonzero(np.arange(2 * n) % 2)
    spread = np.full((2 * n, 3), 7.0)
    spread[place] = vertices
    mesh = mesh_from_arrays(spread, place[faces])
    assert (mesh.n_vertices, mesh.file_count) == (n, 2 * n)
    np.testing.assert_array_equal(mesh.file_index, place)
    np.testing.assert_array_equal(mesh.vertex_of_file, np.where(np.arange(2 * n) % 2, np.arange(2 * n) // 2, -1))
    np.testing.assert_array_equal(mesh.file_faces, place[faces])
    assert mesh.notes == (
        f"{n} vertices are in no face (vertices 0, 2, 4, 6, 8, …): left out, without a match (-1 in the maps)",
    )


def test_values_and_maps_go_to_the_file_and_back() -> None:
    vertices, faces = shapes.bumpy_sphere(2)
    n = len(vertices)
    plain = mesh_from_arrays(vertices, faces)
    spread = mesh_from_arrays(np.concatenate([np.full((3, 3), 7.0), vertices]), faces + 3)
    np.testing.assert_array_equal(spread.file_index, np.arange(n) + 3)
    values = np.arange(2.0 * n).reshape(n, 2)
    on_file = spread.to_file(values, np.nan)
    assert np.isnan(on_file[:3]).all()
    np.testing.assert_array_equal(spread.from_file(on_file), values)
    np.testing.assert_allclose(spread.file_positions()[:3], np.tile(spread.offset, (3, 1)))
    np.testing.assert_allclose(spread.file_positions()[3:], vertices, atol=1e-12)

    matches = np.random.default_rng(3).permutation(n)
    forward = spread.map_to_file(plain, matches)
    np.testing.assert_array_equal(forward, [-1, -1, -1, *matches])
    backward = plain.map_to_file(spread, matches)
    np.testing.assert_array_equal(backward, matches + 3)
    np.testing.assert_array_equal(spread.map_from_file(plain, forward), matches)
    np.testing.assert_array_equal(plain.map_from_file(spread, backward), matches)
    # No match, and a vertex of the other file that is off its surface, are both no match here.
    backward[:2] = -1, 1
    np.testing.assert_array_equal(plain.map_from_file(spread, backward)[:3], [-1, -1, matches[2]])


def test_as_mesh_takes_every_form() -> None:
    vertices, faces = shapes.bumpy_sphere(2)
    mesh = mesh_from_arrays(vertices, faces)
    assert as_mesh(mesh) is mesh
    for thing in ((vertices, faces), [vertices, faces], trimesh.Trimesh(vertices, faces, process=False)):
        other = as_mesh(thing, "given")
        assert (other.name, other.path) == ("given", None)
        np.testing.assert_array_equal(other.vertices, mesh.vertices)
        np.testing.assert_array_equal(other.faces, mesh.faces)
    cloud = as_mesh(vertices, "given")
    np.testing.assert_array_equal(as_mesh(trimesh.PointCloud(vertices)).vertices, cloud.vertices)
    assert (cloud.n_vertices, cloud.n_faces) == (mesh.n_vertices, mesh.n_faces)
    for wrong in (None, 3, (vertices,), trimesh.Scene()):
        with pytest.raises(MeshError, match="expected a path"):
            as_mesh(wrong)


def test_a_mesh_is_a_value() -> None:
    mesh = mesh_from_arrays(*shapes.bumpy_sphere(2))
    assert isinstance(mesh, Mesh)
    with pytest.raises(AttributeError):
        mesh.scale = 2.0  # type: ignore[misc]


def test_the_arrays_of_the_caller_are_not_touched() -> None:
    vertices, faces = shapes.bumpy_sphere(2)
    faces = faces[:, ::-1].copy()
    before = vertices.copy(), faces.copy()
    mesh = mesh_from_arrays(vertices, faces)
    mesh.vertices[:] = 0
    mesh.faces[:] = 0
    np.testing.assert_array_equal(vertices, before[0])
    np.testing.assert_array_equal(faces, before[1])
