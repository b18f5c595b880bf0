"""Pairs made in code: closed bodies, meshed differently, with a truth that is near."""

from __future__ import annotations

import numpy as np
import pytest

from clalign.benchmark.generated import generated_pair
from clalign.errors import OptionError
from clalign.mesh.mesh import mesh_from_arrays


@pytest.mark.parametrize("count", [100, 1501])
def test_both_meshes_are_closed_spheres_of_the_size_asked_for(count: int) -> None:
    pair = generated_pair(count)
    for mesh in (pair.source, pair.target):
        assert mesh.n_vertices == mesh.file_count == count
        assert mesh.n_faces == 2 * count - 4
        assert mesh.notes == ()
        sides = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        assert set(np.unique(sides, axis=0, return_counts=True)[1]) == {2}
        corners = mesh.vertices[mesh.faces]
        assert np.linalg.det(corners).sum() > 0


def test_the_meshes_differ_but_the_surfaces_hardly_do() -> None:
    pair = generated_pair(2000)
    source, target, truth = pair.source, pair.target, pair.truth.target_points
    assert 0.4 < len(np.unique(truth)) / 2000 < 0.95
    edges = truth[source.faces[:, :2]]
    straight = np.linalg.norm(np.diff(source.vertices[source.faces[:, :2]], axis=1), axis=2).mean()
    carried = np.linalg.norm(np.diff(target.vertices[edges], axis=1), axis=2).mean()
    assert carried == pytest.approx(straight, rel=0.3)
    assert not np.array_equal(np.sort(source.faces.ravel()), np.sort(target.faces.ravel()))


def test_a_seed_names_a_body() -> None:
    first, again, other = (generated_pair(300, seed) for seed in (1, 1, 2))
    assert np.array_equal(first.source.vertices, again.source.vertices)
    assert np.array_equal(first.target.faces, again.target.faces)
    assert np.abs(first.source.vertices - other.source.vertices).max() > 0.05


def test_the_mesh_is_usable_as_it_is() -> None:
    mesh = generated_pair(400).target
    read = mesh_from_arrays(mesh.vertices, mesh.faces)
    assert np.allclose(read.vertices, mesh.vertices, atol=1e-12)


def test_too_few_vertices() -> None:
    with pytest.raises(OptionError, match="at least 100"):
        generated_pair(50)
