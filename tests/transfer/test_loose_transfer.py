"""Carrying things through a match of files with seams, pinched vertices and loose pieces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from assembled import assembled, matched, truth
from scipy.spatial.transform import Rotation

from clalign.correspondence import Correspondence
from clalign.transfer.texture import Texture, carry_texture, read_texture, write_textured_obj
from clalign.transfer.transfer import carry_deformation, carry_labels, carry_landmarks, carry_values

SOURCE, TARGET = assembled(), assembled(0.3, seed=4)
TRUTH = truth(SOURCE, TARGET)
BACK = truth(TARGET, SOURCE)


@pytest.fixture(scope="module")
def result() -> Correspondence:
    return matched(SOURCE, TARGET)


def test_values_come_to_every_vertex_through_its_own_match(result: Correspondence) -> None:
    number = np.arange(len(SOURCE.vertices), dtype=np.float64)
    carried = carry_values(result, number)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(carried)), np.sort(TARGET.left_out))
    has = ~np.isnan(carried)
    np.testing.assert_array_equal(carried[has], result.source_of_target[has])
    np.testing.assert_array_equal(carried[TARGET.loose], BACK[TARGET.loose])
    np.testing.assert_array_equal(*carried[TARGET.seam].T)
    # Two columns, the other way.
    columns = np.stack([np.arange(len(TARGET.vertices)), -np.arange(len(TARGET.vertices))], axis=1)
    back = carry_values(result, columns, origin="target")
    np.testing.assert_array_equal(back[SOURCE.carried, 0], result.target_of_source[SOURCE.carried])
    np.testing.assert_array_equal(back[SOURCE.carried, 1], -result.target_of_source[SOURCE.carried])


def test_smooth_values_take_loose_pieces_along(result: Correspondence) -> None:
    height = SOURCE.vertices[:, 2]
    carried = carry_values(result, height, route="functional")
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(carried)), np.sort(TARGET.left_out))
    np.testing.assert_array_equal(carried[TARGET.loose], height[BACK[TARGET.loose]])


def test_labels_and_landmarks_reach_loose_pieces(result: Correspondence) -> None:
    labels = np.zeros(len(SOURCE.vertices), dtype=np.int64)
    labels[SOURCE.loose], labels[SOURCE.touching] = 1, 2
    carried = carry_labels(result, labels)
    np.testing.assert_array_equal(carried[TARGET.loose], 1)
    assert (carried[TARGET.touching] == 2).mean() > 0.95
    np.testing.assert_array_equal(carried[TARGET.left_out], -1)
    assert carried[TARGET.shared] == 0
    landmarks = np.array([SOURCE.shared, SOURCE.loose[7], SOURCE.left_out[0], *SOURCE.seam[3]])
    found = carry_landmarks(result, landmarks)
    np.testing.assert_array_equal(found[:3], [TARGET.shared, TRUTH[SOURCE.loose[7]], -1])
    assert found[3] == found[4]
    assert found[3] in TARGET.seam


def test_loose_pieces_move_with_a_deformation_of_the_surface(result: Correspondence) -> None:
    change = 1.7 * Rotation.from_euler("xyz", [20, -35, 50], degrees=True).as_matrix()
    deformed = SOURCE.vertices @ change.T
    # Where loose vertices of the origin go makes no difference: they may be missing.
    deformed[SOURCE.carried] = np.nan
    moved = carry_deformation(result, deformed)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(moved).any(axis=1)), np.sort(TARGET.left_out))
    has = np.setdiff1d(np.arange(len(moved)), TARGET.left_out)
    expected = TARGET.vertices[has] @ change.T
    error = moved[has] - expected
    np.testing.assert_allclose(error - error[0], 0.0, atol=1e-9)


def test_a_texture_whose_seam_cuts_the_file_stays_whole(result: Correspondence, tmp_path: Path) -> None:
    """Each side of the cut has coordinates of its own, as exporters write them; triangles take those of their side."""
    mesh = result.source
    side = SOURCE.vertices[SOURCE.faces].mean(axis=1)[:, 2] > 0
    flat = SOURCE.vertices[:, :2] / 8 + 0.25
    coordinates = np.concatenate([flat, flat + 0.5])
    corners = np.where(side[:, None], SOURCE.faces + len(flat), SOURCE.faces)
    texture = Texture(coordinates, corners, SOURCE.faces)
    write_textured_obj(tmp_path / "source.obj", SOURCE.vertices, texture)
    carried = carry_texture(result, read_texture(tmp_path / "source.obj"))
    assert len(carried.faces) == result.target.n_faces
    places = carried.coordinates[carried.corners]
    upper = (places > 0.5).all(axis=(1, 2))
    lower = (places < 0.5).all(axis=(1, 2))
    np.testing.assert_array_equal(upper, ~lower)
    assert upper.sum() == side[: mesh.n_faces].sum()
    wanted = flat[result.source_of_target[carried.faces]] + 0.5 * upper[:, None, None]
    np.testing.assert_allclose(places, wanted, atol=1e-6)
