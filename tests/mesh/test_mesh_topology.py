"""Edges, areas, normals and components against shapes whose values are known."""

from __future__ import annotations

import malformed
import numpy as np
import pytest
import shapes

from clalign.mesh import topology


def test_edges_of_a_sphere() -> None:
    vertices, faces = shapes.icosphere(2)
    edges = topology.edge_table(faces, len(vertices)).edges
    naive = {tuple(sorted(pair)) for a, b, c in faces.tolist() for pair in ((a, b), (b, c), (c, a))}
    assert [tuple(edge) for edge in edges.tolist()] == sorted(naive)
    assert len(vertices) - len(edges) + len(faces) == 2


def test_boundary_of_a_rectangle() -> None:
    vertices, faces = malformed.grid(3, 5)
    x, y = vertices[:, 0], vertices[:, 1]
    rim = (x == 0) | (x == 5) | (y == 0) | (y == 3)
    np.testing.assert_array_equal(topology.boundary_vertices(faces, len(vertices)), rim)
    edges = topology.boundary_edges(faces, len(vertices))
    assert len(edges) == 16
    assert not topology.boundary_vertices(shapes.icosphere(1)[1], 42).any()
    assert topology.edge_loops(edges)[0] == 1
    # Directed as in the faces, the rim runs once around the rectangle: the shoelace formula gives its area.
    tail, head = vertices[edges[:, 0]], vertices[edges[:, 1]]
    assert 0.5 * (tail[:, 0] * head[:, 1] - tail[:, 1] * head[:, 0]).sum() == pytest.approx(15.0)


def test_areas_volume_and_normals_of_a_sphere() -> None:
    vertices, faces = shapes.icosphere(4)
    assert topology.face_areas(vertices, faces).sum() == pytest.approx(4 * np.pi, rel=2e-3)
    assert topology.vertex_areas(vertices, faces).sum() == pytest.approx(topology.face_areas(vertices, faces).sum())
    assert topology.signed_volume(vertices, faces) == pytest.approx(4 / 3 * np.pi, rel=4e-3)
    assert topology.signed_volume(vertices, faces[:, ::-1]) == pytest.approx(-4 / 3 * np.pi, rel=4e-3)
    normals = topology.vertex_normals(vertices, faces)
    assert (normals * vertices).sum(axis=1).min() > 0.9999


def test_components_and_fans() -> None:
    vertices, faces = shapes.icosphere(1)
    n = len(vertices)
    count, label = topology.connected_components(np.concatenate([faces, faces + n]), 2 * n + 1)
    assert count == 3
    assert len(set(label[:n])) == len(set(label[n : 2 * n])) == 1
    table = topology.edge_table(faces, n)
    np.testing.assert_array_equal(topology.fan_counts(faces, table, n), 1)
    pinched = next(case for case in malformed.surfaces() if case.name == "pinched vertex")
    table = topology.edge_table(pinched.faces, len(pinched.vertices))
    fans = topology.fan_counts(pinched.faces, table, len(pinched.vertices))
    assert np.bincount(fans).tolist() == [0, len(fans) - 1, 1]


def test_positions_are_merged_by_first_appearance() -> None:
    points = np.array([[1.0, 2, 3], [0, 0, 0], [1, 2, 3], [-0.0, 0, 0], [5, 5, 5], [0, 0, 1e-300]])
    first, merged = topology.merge_positions(points)
    assert first.tolist() == [0, 1, 4, 5]
    assert merged.tolist() == [0, 1, 0, 1, 2, 3]


def test_random_flips_of_faces_are_undone(rng: np.random.Generator) -> None:
    _, faces = shapes.icosphere(3)
    wrong = rng.random(len(faces)) < 0.3
    mixed = topology.flipped(faces, wrong)
    table = topology.edge_table(mixed, int(faces.max()) + 1)
    flip, twisted = topology.coherent_orientation(mixed, table, *topology.paired_half_edges(table))
    np.testing.assert_array_equal(flip, wrong)
    assert not twisted.any()


def test_outward_sign_is_unsure_of_a_bowl() -> None:
    vertices, faces = shapes.icosphere(3)
    height = vertices[faces].mean(axis=1)[:, 2]
    bowl, nearly_closed = faces[height < 0], faces[height < 0.95]
    assert topology.outward_sign(vertices, bowl) == 0
    assert topology.outward_sign(vertices, nearly_closed) == 1
    assert topology.outward_sign(vertices + 100.0, nearly_closed[:, ::-1]) == -1
