"""The shapes that other tests stand on are what they claim to be."""

from __future__ import annotations

import numpy as np
import shapes
from shapes import Pair


def euler(n_vertices: int, faces: shapes.Faces) -> int:
    """Euler characteristic of a closed oriented manifold; fails if the mesh is not one."""
    directed = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    keys = directed[:, 0] * n_vertices + directed[:, 1]
    reverse = directed[:, 1] * n_vertices + directed[:, 0]
    assert len(np.unique(keys)) == len(keys)
    assert set(keys) == set(reverse)
    assert len(np.unique(faces)) == n_vertices
    return n_vertices - len(keys) // 2 + len(faces)


def volume(vertices: shapes.Vertices, faces: shapes.Faces) -> float:
    return float(np.linalg.det(vertices[faces]).sum() / 6)


def test_icosphere_converges_to_the_sphere() -> None:
    vertices, faces = shapes.icosphere(3)
    assert vertices.shape == (642, 3)
    assert euler(642, faces) == 2
    assert 0.98 < volume(vertices, faces) / (4 * np.pi / 3) < 1


def test_bumpy_sphere_is_closed_and_outward() -> None:
    vertices, faces = shapes.bumpy_sphere(3)
    assert euler(len(vertices), faces) == 2
    assert volume(vertices, faces) > 0


def test_renumbered_keeps_every_face() -> None:
    vertices, faces = shapes.bumpy_sphere(1)
    shuffled, shuffled_faces, new_of_old = shapes.renumbered(vertices, faces, 5)
    assert np.array_equal(shuffled[new_of_old], vertices)
    assert abs(volume(shuffled, shuffled_faces) - volume(vertices, faces)) < 1e-12
    assert euler(len(shuffled), shuffled_faces) == 2


def test_human_pair_is_two_poses_of_one_body(human_pair: Pair) -> None:
    for vertices, faces in (human_pair.source, human_pair.target):
        assert len(vertices) == 1500
        assert euler(1500, faces) == 2
        assert volume(vertices, faces) > 0
    source_vertices, source_faces = human_pair.source
    target_vertices, _ = human_pair.target
    edges = source_faces[:, :2]
    before = np.linalg.norm(np.diff(source_vertices[edges], axis=1)[:, 0], axis=1)
    after = np.linalg.norm(np.diff(target_vertices[human_pair.truth[edges]], axis=1)[:, 0], axis=1)
    assert np.median(np.abs(after / before - 1)) < 0.05
    assert human_pair.mirrored is not None
    assert np.mean(human_pair.mirrored != human_pair.truth) > 0.9
