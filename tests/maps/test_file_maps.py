"""Maps between files: what was joined, parted or hangs loose has the right match, too."""

from __future__ import annotations

import malformed
import numpy as np
import pytest
import shapes
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from clalign.maps.file_maps import VertexStatus, carried, file_maps, vertex_status
from clalign.maps.point_maps import PointMaps
from clalign.mesh.mesh import Mesh, mesh_from_arrays

TURN = Rotation.from_euler("xyz", [0.4, 1.0, 2.0])


def moved(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return 3.0 * TURN.apply(points) + [7.0, 0.0, -2.0]


def identity(mesh: Mesh) -> PointMaps:
    return PointMaps(np.arange(mesh.n_vertices), np.arange(mesh.n_vertices))


def eyes() -> malformed.Arrays:
    """A body with two small spheres in it, one beside the other."""
    body, faces = shapes.bumpy_sphere(3)
    ball, ball_faces = shapes.icosphere(2)
    parts = [body, 0.12 * ball + [0.5, 0.2, 0.0], 0.12 * ball + [0.5, -0.2, 0.0]]
    starts = np.cumsum([0] + [len(part) for part in parts])
    every = [faces, ball_faces + starts[1], ball_faces + starts[2]]
    return np.concatenate(parts), np.concatenate(every)


def test_points_beside_a_surface_move_as_the_surface_does(rng: np.random.Generator) -> None:
    vertices, faces = shapes.bumpy_sphere(3)
    here, there = mesh_from_arrays(vertices, faces), mesh_from_arrays(moved(vertices), faces)
    points = rng.uniform(-1, 1, size=(40, 3))
    places = carried(here, there, np.arange(here.n_vertices), (points - here.offset) / here.scale)
    np.testing.assert_allclose(places * there.scale + there.offset, moved(points), atol=1e-9)


def test_points_beside_a_mirrored_surface_are_mirrored(rng: np.random.Generator) -> None:
    vertices, faces = shapes.bumpy_sphere(3)
    here = mesh_from_arrays(vertices, faces)
    there = mesh_from_arrays(vertices * [-1, 1, 1], faces[:, ::-1])
    points = rng.uniform(-1, 1, size=(40, 3))
    places = carried(here, there, np.arange(here.n_vertices), (points - here.offset) / here.scale)
    np.testing.assert_allclose(places * there.scale + there.offset, points * [-1, 1, 1], atol=1e-9)


def test_each_vertex_of_a_loose_piece_finds_its_own(rng: np.random.Generator) -> None:
    vertices, faces = eyes()
    new_of_old = rng.permutation(len(vertices))
    shuffled = np.empty_like(vertices)
    shuffled[new_of_old] = moved(vertices)
    source, target = mesh_from_arrays(vertices, faces), mesh_from_arrays(shuffled, new_of_old[faces])
    body = target.vertex_of_file[new_of_old[source.file_index]]
    found = file_maps(source, target, PointMaps(body, np.argsort(body)))
    np.testing.assert_array_equal(found.target_of_source, new_of_old)
    np.testing.assert_array_equal(found.source_of_target, np.argsort(new_of_old))
    status = vertex_status(source, found.target_of_source)
    np.testing.assert_array_equal(np.flatnonzero(status == VertexStatus.CARRIED), np.arange(642, len(vertices)))
    assert (status[:642] == VertexStatus.MATCHED).all()


def test_a_loose_piece_without_a_partner_goes_to_the_surface_near_it() -> None:
    vertices, faces = eyes()
    source, target = mesh_from_arrays(vertices, faces), mesh_from_arrays(vertices[:642], faces[: 2 * 640])
    found = file_maps(source, target, identity(target))
    matches = found.target_of_source[642:]
    assert (matches >= 0).all()
    off = np.linalg.norm(vertices[642:] - vertices[matches], axis=1)
    nearest = np.linalg.norm(vertices[642:, None] - vertices[None, :642], axis=2).min(axis=1)
    np.testing.assert_allclose(off, nearest, rtol=1e-9)


def test_pieces_too_small_to_say_where_they_belong_have_no_match() -> None:
    vertices, faces = shapes.bumpy_sphere(2)
    crumb = 0.05 * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]) + [0.2, 0.1, 0.0]
    mesh = mesh_from_arrays(np.concatenate([vertices, crumb]), np.concatenate([faces, [[162, 163, 164]]]))
    found = file_maps(mesh, mesh, identity(mesh))
    np.testing.assert_array_equal(found.target_of_source, [*range(162), -1, -1, -1])
    assert (vertex_status(mesh, found.target_of_source)[162:] == VertexStatus.UNMATCHED).all()


@pytest.mark.parametrize("kind", ["soup", "pinched vertex", "fin", "seam"])
def test_every_vertex_of_a_damaged_file_has_a_match_at_its_place(kind: str) -> None:
    if kind == "soup":
        body, faces = shapes.bumpy_sphere(2)
        vertices, faces = body[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)
    else:
        case = next(case for case in malformed.surfaces() if case.name == kind)
        vertices, faces = case.vertices, case.faces
    mesh = mesh_from_arrays(vertices, faces)
    found = file_maps(mesh, mesh, identity(mesh)).target_of_source
    # The tip of the fin is a piece of three vertices.
    matched = found >= 0 if kind == "fin" else np.ones(len(vertices), dtype=bool)
    assert matched.sum() >= len(vertices) - 1
    np.testing.assert_allclose(vertices[found[matched]], vertices[matched], atol=1e-12)
