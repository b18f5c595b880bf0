"""Warped bodies: the truth is right, limbs have the sizes asked for, and the surface stays smooth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapes

from clalign.benchmark.warp import WARPS, scaled_limbs
from clalign.benchmark.warped import warped
from clalign.errors import OptionError
from clalign.mesh.mesh import Mesh, mesh_from_arrays
from clalign.mesh.topology import edge_table

LENGTHS = (1.4, 1.2, 1.6, 1.0, 1.8)


@pytest.fixture(scope="module")
def body() -> Mesh:
    return mesh_from_arrays(*shapes.limbed_sphere(LENGTHS), "body")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bodies")
    vertices, faces = shapes.limbed_sphere(LENGTHS, 4)
    shapes.write_off(path / "a.off", vertices, faces)
    shapes.write_off(path / "b.off", shapes.bent(vertices, 0.3), faces)
    (path / "pairs.txt").write_text("a b\n")
    return path


def test_limbs_get_the_sizes_asked_for_the_farthest_first(body: Mesh) -> None:
    """Seen from the middle: the ends move out and in, the trunk stays."""
    factors = np.array([1.5, 0.7, 1.0, 1.2, 0.6])
    before, after = body.file_vertices(), scaled_limbs(body, factors)
    along = shapes.LIMBS / np.linalg.norm(shapes.LIMBS, axis=1, keepdims=True)
    ends = np.argmax(before @ along.T, axis=0)[np.argsort(LENGTHS)[::-1]]
    ratios = np.linalg.norm(after[ends], axis=1) / np.linalg.norm(before[ends], axis=1)
    assert list(np.argsort(ratios)) == list(np.argsort(factors))
    assert ratios[2] == pytest.approx(1.0)
    still = np.linalg.norm(before, axis=1) < 1.1
    assert still.sum() > 50
    assert np.median(np.linalg.norm(after[still] - before[still], axis=1)) < 0.02


@pytest.mark.parametrize("name", list(WARPS))
def test_a_warp_tears_nothing_and_is_no_isometry(body: Mesh, name: str) -> None:
    before, after = body.file_vertices(), WARPS[name].points(body, np.random.default_rng(1))
    edges = edge_table(body.faces, body.n_vertices).edges
    lengths = [np.linalg.norm(np.diff(points[edges], axis=1)[:, 0], axis=1) for points in (before, after)]
    stretch = lengths[1] / lengths[0]
    assert 0.25 < stretch.min() < 0.95 or name == "waves"
    assert stretch.max() < 3.0
    assert np.std(stretch) > 0.03


@pytest.mark.parametrize("warp", list(WARPS))
@pytest.mark.parametrize("share", [1.0, 0.5])
def test_the_truth_follows_the_warp(folder: Path, warp: str, share: float) -> None:
    """Only the source is warped, or both; taken back to where they were, matched vertices lie together."""
    if share < 1:
        pytest.importorskip("fast_simplification")
    (layout,) = warped(folder, [warp], share)
    assert layout.name == f"{folder.name}/pairs/{warp}"
    pair, again = layout.pairs[0].load(), layout.pairs[0].load()
    np.testing.assert_array_equal(pair.target.vertices, again.target.vertices)
    original = shapes.limbed_sphere(LENGTHS, 4)[0]
    gone = 1.0 - pair.truth.count / len(original)
    assert gone == 0.0 if share == 1 else 0.3 < gone < 0.7
    assert np.mean(pair.truth.source_points == pair.truth.target_points) < 0.01
    if not WARPS[warp].both:
        places = pair.target.file_vertices()[pair.truth.target_points]
        gaps = np.linalg.norm(places - shapes.bent(original, 0.3)[pair.truth.source_points], axis=1)
        assert np.mean(gaps) < (1e-6 if share == 1 else 0.05)
    assert np.linalg.norm(pair.source.file_vertices() - original, axis=1).max() > 0.1


def test_bad_calls(folder: Path) -> None:
    with pytest.raises(OptionError, match="unknown warp 'melted'"):
        warped(folder, ["melted"])
    with pytest.raises(OptionError, match="share of faces"):
        warped(folder, ["waves"], 0.0)
