"""Values, labels, landmarks and deformations through a match."""

from __future__ import annotations

import numpy as np
import pytest
import shapes
from fabricated import fabricate
from scipy.spatial.transform import Rotation

from clalign.correspondence import Correspondence
from clalign.errors import InputError
from clalign.mesh.mesh import mesh_from_arrays
from clalign.transfer.transfer import carry_deformation, carry_labels, carry_landmarks, carry_values


def test_values_go_to_the_matches_in_file_numbering(small: Correspondence) -> None:
    values = np.random.default_rng(0).normal(size=(643, 2))
    on_target = carry_values(small, values)
    assert np.isnan(on_target[0]).all()
    assert np.array_equal(on_target[1:], values[small.source_of_target[1:]])
    back = carry_values(small, on_target, origin="target")
    assert np.array_equal(back[1:], values[1:])
    assert carry_values(small, values[:, 0]).shape == (643,)


def test_functional_route_keeps_what_the_basis_holds(small: Correspondence) -> None:
    smooth = np.full(643, np.nan)
    smooth[1:] = small.source_basis.functions[:, :6] @ np.arange(1.0, 7.0)
    through_points = carry_values(small, smooth)[1:]
    through_c = carry_values(small, smooth, route="functional")[1:]
    distance = np.linalg.norm(through_points - through_c) / np.linalg.norm(through_points)
    assert distance < 0.1
    with pytest.raises(InputError, match="from the source"):
        carry_values(small, smooth, origin="target", route="functional")


def test_labels_are_never_mixed(small: Correspondence) -> None:
    labels = np.arange(643) * 7
    carried = carry_labels(small, labels)
    assert carried[0] == -1
    assert np.array_equal(carried[1:], labels[small.source_of_target[1:]])
    assert carry_labels(small, labels.astype(float)).dtype == np.int64
    with pytest.raises(InputError, match="whole"):
        carry_labels(small, labels + 0.5)


def test_landmarks(small: Correspondence) -> None:
    assert carry_landmarks(small, [0, 3, 9]).tolist() == [-1, *small.target_of_source[[3, 9]]]
    assert carry_landmarks(small, [4], origin="target").tolist() == [small.source_of_target[4]]
    with pytest.raises(InputError, match="landmark 1 is vertex 643"):
        carry_landmarks(small, [1, 643])


@pytest.mark.parametrize("rows", [0, 642, 644])
def test_wrong_number_of_rows_is_named(small: Correspondence, rows: int) -> None:
    with pytest.raises(InputError, match=f"there are {rows} rows, but first has 643 vertices"):
        carry_values(small, np.zeros(rows))
    with pytest.raises(InputError, match="source"):
        carry_values(small, np.zeros(643), origin="sideways")  # type: ignore[arg-type]


def test_stretching_is_carried_closely(small: Correspondence) -> None:
    change = np.diag([1.3, 1.0, 0.8]) @ Rotation.from_euler("xyz", [20, -35, 50], degrees=True).as_matrix()
    result = carry_deformation(small, small.source.file_positions() @ change.T + (3.0, -1.0, 2.0))
    assert np.isnan(result[0]).all()
    expected = small.target.file_vertices() @ change.T
    error = (result[1:] - result[1:].mean(axis=0)) - (expected - expected.mean(axis=0))
    # Around a vertex the gradient is known in the tangent plane only, so a stretch is followed up to the curvature.
    assert np.linalg.norm(error) < 0.05 * np.linalg.norm(expected - expected.mean(axis=0))


def test_rigid_and_uniform_deformations_are_carried_exactly(small: Correspondence) -> None:
    change = 1.7 * Rotation.from_euler("xyz", [20, -35, 50], degrees=True).as_matrix()
    result = carry_deformation(small, small.source.file_positions() @ change.T)[1:]
    expected = small.target.file_vertices() @ change.T
    error = (result - result.mean(axis=0)) - (expected - expected.mean(axis=0))
    assert np.abs(error).max() < 1e-9 * small.target.scale


def test_bending_is_carried_to_another_mesh_of_the_shape() -> None:
    vertices, faces = shapes.bumpy_sphere(3)
    other, other_faces, other_of_old = shapes.renumbered(vertices * 2.0 + 5.0, faces, 7)
    source, target = mesh_from_arrays(vertices, faces), mesh_from_arrays(other, other_faces)
    result = fabricate(source, target, other_of_old, np.argsort(other_of_old))
    moved = carry_deformation(result, shapes.bent(vertices, 0.8))
    expected = 2.0 * shapes.bent(vertices, 0.8)[np.argsort(other_of_old)]
    moved, expected = moved - moved.mean(axis=0), expected - expected.mean(axis=0)
    rest = other - other.mean(axis=0)
    assert np.linalg.norm(moved - expected) < 0.03 * np.linalg.norm(rest - expected)


def test_deformation_needs_finite_positions(small: Correspondence) -> None:
    moved = small.source.file_positions()
    moved[9, 1] = np.nan
    with pytest.raises(InputError, match="finite"):
        carry_deformation(small, moved)


def test_a_missing_value_stays_where_it_is_on_the_functional_route(small: Correspondence) -> None:
    """The rest comes out as if the value had been there: a smooth function is filled in between its neighbours."""
    smooth = np.full((643, 2), np.nan)
    smooth[1:] = small.source_basis.functions[:, :4] @ np.arange(8.0).reshape(4, 2)
    whole = carry_values(small, smooth, route="functional")
    gone = np.array([7, 300, 301])
    holed = smooth.copy()
    holed[gone, 0] = [np.nan, np.inf, np.nan]
    carried = carry_values(small, holed, route="functional")
    at_the_gap = np.isin(small.source_of_target, gone)
    assert at_the_gap.any()
    assert np.isnan(carried[at_the_gap, 0]).all()
    rest = ~at_the_gap
    rest[0] = False
    np.testing.assert_allclose(carried[rest], whole[rest], atol=0.02 * np.nanstd(smooth))
    np.testing.assert_array_equal(carried[1:, 1], whole[1:, 1])
    assert np.isnan(carry_values(small, np.full(643, np.nan), route="functional")).all()
