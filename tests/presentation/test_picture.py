from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapes
from scipy.spatial.transform import Rotation

from clalign.correspondence import Correspondence
from clalign.mesh.front import front_view
from clalign.mesh.mesh import mesh_from_arrays
from clalign.presentation.camera import facing_rotation
from clalign.presentation.notebook import notebook_html
from clalign.presentation.picture import match_image, save_match_picture


def _figure(up: int, across: int) -> np.ndarray:
    """Points of something that is tall, half as wide and thin, along given coordinate axes."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.1, 0.1, size=(2000, 3))
    points[:, up] *= 10
    points[:, across] *= 5
    return points


@pytest.mark.parametrize(("up", "across"), [(1, 0), (2, 0), (1, 2)])
def test_front_view_shows_the_broad_side_upright(up: int, across: int) -> None:
    view = front_view(_figure(up, across))
    assert np.allclose(view @ view.T, np.eye(3))
    assert np.linalg.det(view) == pytest.approx(1.0)
    width, height, depth = np.ptp(_figure(up, across) @ view.T, axis=0)
    assert height > width > depth
    assert view[1, up] == 1.0


def test_front_view_follows_the_named_axis() -> None:
    view = front_view(_figure(1, 0), "x")
    assert view[1].tolist() == [1.0, 0.0, 0.0]


def test_front_view_of_a_tilted_shape_uses_its_own_axes() -> None:
    turn = Rotation.from_euler("xyz", [35, 40, 30], degrees=True).as_matrix()
    seen = _figure(1, 0) @ turn.T
    width, height, depth = np.ptp(seen @ front_view(seen).T, axis=0)
    assert height == pytest.approx(2.0, rel=0.05)
    assert width == pytest.approx(1.0, rel=0.05)
    assert depth == pytest.approx(0.2, rel=0.3)


def test_turn_to_undoes_large_turns_and_leaves_small_ones() -> None:
    points = _figure(1, 0)
    large = Rotation.from_euler("xyz", [90, 0, 20], degrees=True).as_matrix()
    assert np.allclose(facing_rotation(points @ large.T, points), large.T, atol=1e-9)
    small = Rotation.from_euler("y", 20, degrees=True).as_matrix()
    assert np.array_equal(facing_rotation(points @ small.T, points), np.eye(3))
    assert np.linalg.det(facing_rotation(points * (-1, 1, 1), points)) == pytest.approx(1.0)


def test_picture_has_both_shapes_alike_and_apart(small: Correspondence, tmp_path: Path) -> None:
    image = match_image(small, height=240)
    assert image.shape[0] == 240
    empty = np.flatnonzero((image == 255).all(axis=(0, 2)))
    gap = empty[(empty > image.shape[1] * 0.3) & (empty < image.shape[1] * 0.7)]
    assert gap.size
    left, right = image[:, : gap[0]].reshape(-1, 3), image[:, gap[-1] :].reshape(-1, 3)
    for channel in range(3):
        shares = [
            np.histogram(half[:, channel], bins=6, range=(0, 250))[0] / (half < 250).sum() for half in (left, right)
        ]
        assert np.abs(shares[0] - shares[1]).max() < 0.12
    save_match_picture(small, tmp_path / "match.png", height=120)
    assert (tmp_path / "match.png").read_bytes().startswith(b"\x89PNG")


def test_words_stand_below_the_shapes(small: Correspondence) -> None:
    image = match_image(small, height=600)
    middle = image.shape[1] // 2
    widths = []
    for half in (image[570:, :middle], image[570:, middle:]):
        ink = (half < 200).all(axis=2)
        rows, columns = np.flatnonzero(ink.any(axis=1)), np.flatnonzero(ink.any(axis=0))
        assert 8 <= np.ptp(rows) <= 24
        assert (columns[0] + columns[-1]) / 2 == pytest.approx(middle / 2, abs=2)
        widths.append(np.ptp(columns))
    assert min(widths) > 30
    assert widths[0] != widths[1]
    low = match_image(small, height=100)
    assert (low[95:] == 255).all()


def test_a_turned_source_is_drawn_as_its_target(fabricated: object) -> None:
    vertices, faces = shapes.bumpy_sphere(2)
    turn = Rotation.from_euler("xyz", [100, 30, 80], degrees=True).as_matrix()
    meshes = [mesh_from_arrays(points, faces) for points in (vertices @ turn.T, vertices)]
    identity = np.arange(len(vertices))
    result = fabricated(*meshes, identity, identity)  # type: ignore[operator]
    image = match_image(result, height=160).astype(int)
    half = image.shape[1] // 2
    assert np.abs(image[:, :half] - image[:, half : 2 * half]).mean() < 2


def test_notebook_html_escapes_and_shows(small: Correspondence) -> None:
    text = notebook_html(small)
    assert "data:image/png;base64," in text
    assert "0.62 of 1" in text
    assert "<b>" not in text
    assert "&lt;b&gt;" in text
