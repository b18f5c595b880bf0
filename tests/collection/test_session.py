"""What a worker keeps between pairs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapes
from collections_small import OPTIONS

from clalign.collection.members import read_members
from clalign.collection.work import HELD_SHAPES, Session, Settings
from clalign.geometry import shape as preparation


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    vertices, faces = shapes.bumpy_sphere(2)
    (tmp_path / "meshes").mkdir()
    shapes.write_off(tmp_path / "meshes" / "clean.off", vertices, faces)
    noise = 0.05 * np.random.default_rng(0).standard_normal(vertices.shape)
    shapes.write_off(tmp_path / "meshes" / "noisy.off", vertices + noise, faces)
    return Settings(str(tmp_path / "out"), OPTIONS, str(tmp_path / "cache"), 10**9, "maps", 30)


def test_a_clean_shape_is_smoothed_for_noisy_partners_once(
    settings: Settings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clean, noisy = read_members(tmp_path / "meshes")
    first = Session(settings).pair(clean, noisy)
    assert first[0].smoothing == first[1].smoothing > 0

    def forbidden(*_: object) -> None:
        raise AssertionError("eigenfunctions are computed again")

    monkeypatch.setattr(preparation, "solve", forbidden)
    again = Session(settings)
    for made, found in zip(first, again.pair(clean, noisy), strict=True):
        np.testing.assert_array_equal(made.scale_invariant.functions, found.scale_invariant.functions)
    assert again.shape(clean).smoothing == 0.0
    assert again.loaded == 2 <= HELD_SHAPES
