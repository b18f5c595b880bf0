"""Touching parts: handles where ends meet, and nothing else changed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapes
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from clalign.benchmark.touching import fused
from clalign.benchmark.warped import warped
from clalign.mesh.mesh import Mesh, mesh_from_arrays
from clalign.mesh.topology import edge_table


def horseshoe() -> tuple[np.ndarray, np.ndarray]:
    """A long ellipsoid bent so far that its ends nearly meet."""
    directions, faces = shapes.icosphere(3)
    x, y, z = (directions * [6.0, 1.0, 1.0]).T
    angle, radius = x / 2.2, 2.2 + y
    return np.stack([radius * np.sin(angle), radius * np.cos(angle), z], axis=1), faces


def lengths_from(mesh: Mesh, vertex: int) -> np.ndarray:
    edges = edge_table(mesh.faces, mesh.n_vertices).edges
    weights = np.linalg.norm(np.diff(mesh.vertices[edges], axis=1)[:, 0], axis=1)
    graph = sparse.coo_array((weights, edges.T), shape=(mesh.n_vertices, mesh.n_vertices)).tocsr()
    return dijkstra(graph, directed=False, indices=vertex)


@pytest.fixture(scope="module")
def bodies() -> tuple[Mesh, Mesh]:
    body = mesh_from_arrays(*horseshoe(), "horseshoe")
    return body, fused(body)


def test_ends_that_are_near_are_joined_by_handles(bodies: tuple[Mesh, Mesh]) -> None:
    """Two faces fewer and six more for each; every edge has two faces that agree, and the way round is cut short."""
    before, after = bodies
    handles = (after.n_faces - before.n_faces) // 4
    assert 1 <= handles <= 3
    assert after.n_faces - before.n_faces == 4 * handles
    counts = edge_table(after.faces, after.n_vertices)
    assert after.n_vertices - len(counts.edges) + after.n_faces == 2 - 2 * handles
    assert len(counts.edges) * 2 == after.n_faces * 3
    assert not after.notes
    np.testing.assert_allclose(after.file_positions(), before.file_positions(), atol=1e-9)
    ends = int(before.vertices[:, 0].argmin()), int(before.vertices[:, 0].argmax())
    tips = np.argsort(-lengths_from(before, ends[0]))[0]
    other = np.argsort(-lengths_from(before, int(tips)))[0]
    assert lengths_from(after, int(tips))[other] < 0.6 * lengths_from(before, int(tips))[other]


def test_a_body_without_parts_far_apart_stays_as_it_is() -> None:
    ball = mesh_from_arrays(*shapes.icosphere(2), "ball")
    np.testing.assert_array_equal(fused(ball).faces, ball.faces)


def test_pairs_keep_their_truth_and_are_shuffled(tmp_path: Path) -> None:
    vertices, faces = horseshoe()
    for name in "ab":
        shapes.write_off(tmp_path / f"{name}.off", vertices, faces)
    (tmp_path / "pairs.txt").write_text("a b\n")
    (layout,) = warped(tmp_path, ["touching"])
    assert layout.name.endswith("/touching")
    (pair,) = layout.pairs
    loaded = pair.load()
    assert loaded.target.n_faces > loaded.source.n_faces
    assert loaded.target.name.endswith("(touching)")
    moved = loaded.target.file_positions()[loaded.truth.target_points]
    np.testing.assert_allclose(moved, loaded.source.file_positions()[loaded.truth.source_points], atol=1e-4)
    assert not np.array_equal(loaded.truth.target_points, loaded.truth.source_points)
