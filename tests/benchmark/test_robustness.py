from __future__ import annotations

from pathlib import Path

import datasets
import numpy as np
import pytest

from clalign.benchmark.robustness import CHANGES, robustness
from clalign.errors import OptionError, ResultError
from clalign.evaluation.errors import evaluate


@pytest.fixture
def eggs(tmp_path: Path) -> Path:
    mirror = datasets.write_poses(tmp_path / "eggs", ["ap0", "ap1"])
    datasets.write_numbers(tmp_path / "eggs" / "mirror.txt", mirror)
    return tmp_path / "eggs"


@pytest.mark.parametrize("change", list(CHANGES))
def test_the_truth_of_every_change(eggs: Path, change: str) -> None:
    """The true map made from the truth has no error, is no flip, and lies where the change left the vertices."""
    (layout,) = robustness(eggs, [change])
    assert [pair.name for pair in layout.pairs] == [f"ap0 {change}", f"ap1 {change}"]
    pair = layout.pairs[1].load()
    index = np.full(pair.source.file_count, -1)
    index[pair.truth.source_points] = pair.truth.target_points
    result = evaluate(index, pair.truth, source=pair.source, target=pair.target, mirrored=pair.mirrored, points=1000)
    assert result.mean < 0.01
    assert result.flipped is False
    assert (result.mirrored_mean or 0) > 0.1
    assert result.points.size > (20 if change == "half" else 160)
    assert np.mean(pair.truth.source_points == pair.truth.target_points) < 0.1
    if change not in ("rotated", "times-1000", "times-0.001"):
        places = pair.target.file_vertices()[pair.truth.target_points]
        shift = places - pair.source.file_vertices()[pair.truth.source_points]
        edge = np.sqrt(4 / np.sqrt(3) / pair.source.n_faces) * pair.source.scale
        assert np.linalg.norm(shift, axis=1).mean() < 0.5 * edge


def test_without_a_mirror_file_nothing_is_left_out(eggs: Path) -> None:
    (eggs / "mirror.txt").unlink()
    pair = robustness(eggs, ["rotated"])[0].pairs[0].load()
    assert pair.mirrored is None
    assert pair.truth.count == 162


def test_bad_calls(eggs: Path, tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="unknown change 'melted'"):
        robustness(eggs, ["melted"])
    with pytest.raises(ResultError, match="no mesh file"):
        robustness(tmp_path)
