from __future__ import annotations

import numpy as np
import pytest
import shapes

from clalign.errors import ResultError
from clalign.evaluation.isometric import total_maps, with_distances_of
from clalign.evaluation.perturb import renumber
from clalign.evaluation.truth import Truth
from clalign.geometry.shape import prepare_pair
from clalign.mesh.mesh import mesh_from_arrays
from clalign.options import Options

OPTIONS = Options().replace(
    {
        "spectrum.basis": 20,
        "spectrum.refinement": 20,
        "spectrum.descriptors": 20,
        "geodesics.search_samples": 80,
        "geodesics.factor_samples": 60,
    }
)


def test_distances_between_true_points_become_equal() -> None:
    """The target is bent far out of isometry; its carried distances are the source's, and its factors orthonormal."""
    vertices, faces = shapes.bumpy_sphere(3)
    source_mesh = mesh_from_arrays(vertices, faces, "source")
    moved = renumber(mesh_from_arrays(vertices * [2.0, 1.0, 0.6], faces, "target"), seed=1)
    source, target = prepare_pair(source_mesh, moved.mesh, OPTIONS)
    carried = with_distances_of(target, source, moved.truth)
    new = moved.truth.target_points
    expected = source.factors.left @ source.factors.core @ source.factors.left.T
    before = (target.factors.left @ target.factors.core @ target.factors.left.T)[np.ix_(new, new)]
    after = (carried.factors.left @ carried.factors.core @ carried.factors.left.T)[np.ix_(new, new)]
    assert np.abs(before - expected).max() > 0.1
    np.testing.assert_allclose(after, expected, atol=1e-8)
    gram = carried.factors.left.T @ (target.mass[:, None] * carried.factors.left)
    np.testing.assert_allclose(gram, np.eye(len(gram)), atol=1e-10)
    np.testing.assert_array_equal(carried.geodesics.rows[:, new], source.geodesics.rows)
    np.testing.assert_array_equal(carried.geodesics.samples, new[source.geodesics.samples])
    assert carried.basis is target.basis


def test_gaps_of_the_truth_are_filled_from_beside() -> None:
    mesh = mesh_from_arrays(*shapes.icosphere(3), "sphere")
    every_other = np.arange(0, mesh.n_vertices, 2)
    backward, forward = total_maps(mesh, mesh, Truth(every_other, every_other))
    np.testing.assert_array_equal(backward[every_other], every_other)
    shift = np.linalg.norm(mesh.vertices[backward] - mesh.vertices, axis=1)
    edge = np.linalg.norm(mesh.vertices[mesh.faces[:, 0]] - mesh.vertices[mesh.faces[:, 1]], axis=1).max()
    assert shift.max() < 2 * edge
    np.testing.assert_array_equal(forward, backward)
    with pytest.raises(ResultError, match="no point on both"):
        total_maps(mesh, mesh, Truth(np.array([], dtype=int), np.array([], dtype=int)))
