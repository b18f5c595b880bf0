"""Texture coordinates of OBJ files, and their way through a match."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from clalign.correspondence import Correspondence
from clalign.errors import InputError
from clalign.transfer.texture import Texture, carry_texture, read_texture


def _cylinder_texture(vertices: np.ndarray, faces: np.ndarray) -> Texture:
    """Angle and height as texture coordinates, with a seam where the angle jumps."""
    angle = np.arctan2(vertices[:, 1], vertices[:, 0]) / (2 * np.pi) + 0.5
    corner_angle = angle[faces]
    wraps = np.ptp(corner_angle, axis=1) > 0.5
    corner_angle = np.where(wraps[:, None] & (corner_angle < 0.5), corner_angle + 1, corner_angle)
    places = np.stack([corner_angle, vertices[:, 2][faces]], axis=2).reshape(-1, 2)
    coordinates, corners = np.unique(places, axis=0, return_inverse=True)
    return Texture(coordinates, corners.reshape(-1, 3), faces)


def test_texture_with_a_seam_is_carried_untorn(small: Correspondence) -> None:
    source, target = small.source, small.target
    texture = _cylinder_texture(source.file_positions(), source.file_faces)
    carried = carry_texture(small, texture)
    assert np.array_equal(carried.faces, target.file_faces)

    def spans(one: Texture) -> np.ndarray:
        return np.sort(np.ptp(one.coordinates[one.corners], axis=1).max(axis=1))

    # Both meshes have the same triangles under the true map; faces at the poles of the angle may choose otherwise.
    assert np.quantile(np.abs(spans(texture) - spans(carried)), 0.98) < 1e-12
    assert spans(carried).max() <= spans(texture).max() + 1e-12


def test_texture_file_round_trip(tmp_path: Path) -> None:
    path = tmp_path / "quad.obj"
    path.write_text(
        "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
        "usemtl a\nf 1/1/1 2/2/1 3/3/1 4/4/1\nf -4/-4 -3/-3 -2/-2\n",
        encoding="utf-8",
    )
    texture = read_texture(path)
    assert texture.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 2]]
    assert texture.corners.tolist() == texture.faces.tolist()
    assert texture.materials == ("mtllib a.mtl", "usemtl a")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("v 0 0 0\nvt 0 0\nf 1/1 1/1 2/1\n", "line 3"),
        ("v 0 0 0\nvt 0 x\n", "line 2"),
        ("v 0 0 0\nf 1 1 1\n", "line 2"),
        ("v 0 0 0\n", "no faces with texture"),
    ],
)
def test_bad_texture_files_are_refused_with_their_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.obj"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read_texture(path)
    with pytest.raises(InputError, match="cannot be read"):
        read_texture(tmp_path / "none.obj")
