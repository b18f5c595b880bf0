from __future__ import annotations

import numpy as np
import shapes

from clalign.benchmark.perturb import renumber
from clalign.evaluation.distances import with_distances_of
from clalign.geometry.shape import prepare_pair
from clalign.mesh.mesh import mesh_from_arrays
from clalign.options import Options

OPTIONS = Options().replace(
    {
        "spectrum.basis": 20,
        "spectrum.refinement": 20,
        "spectrum.scale_invariant": 20,
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
