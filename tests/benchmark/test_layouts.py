from __future__ import annotations

from pathlib import Path

import datasets
import numpy as np
import pytest

from clalign.benchmark.layouts import Layout, animals, faust, humans, read_pairs_file
from clalign.benchmark.pairs import Pair
from clalign.errors import ClalignError, ResultError
from clalign.evaluation.errors import evaluate


def names(layout: Layout) -> list[str]:
    return [pair.name for pair in layout.pairs]


def errors_of_nearest(pair: Pair) -> tuple[float, float | None]:
    """Match by the nearest vertex in space, which is right for these small bends up to an edge."""
    problem = pair.load()
    outcome = datasets.NearestMethod()(problem)
    result = evaluate(
        outcome.target_of_source, problem.truth, source=problem.source, target=problem.target, mirrored=problem.mirrored
    )
    return result.mean, result.mirrored_mean


def write_mirror(folder: Path, mirror: np.ndarray) -> None:
    datasets.write_numbers(folder / "mirror.txt", mirror)


def test_humans_of_one_connectivity_are_shuffled(tmp_path: Path) -> None:
    folder = tmp_path / "mid"
    write_mirror(folder, datasets.write_poses(folder, ["ap0", "ap1", "bp0"]))
    (folder / "pairs_same.txt").write_text("ap0 ap1\n", encoding="ascii")
    (folder / "pairs_across.txt").write_text("# two people\nap0 bp0\n\n", encoding="ascii")
    same, across = humans(tmp_path)
    assert (same.name, names(same), same.problems) == ("mid/pairs_same", ["ap0 ap1"], ())
    assert (across.name, names(across)) == ("mid/pairs_across", ["ap0 bp0"])
    pair = same.pairs[0]
    assert pair.shuffle_seed is not None
    problem = pair.load()
    assert np.mean(problem.truth.target_points == np.arange(problem.truth.count)) < 0.05
    np.testing.assert_allclose(
        problem.target.file_vertices()[problem.truth.target_points[:5]],
        pair_vertices(pair.target_path)[:5],
        atol=1e-9,
    )
    mean, mirrored = errors_of_nearest(pair)
    assert mean < 0.03 < 0.1 < (mirrored or 0)


def pair_vertices(path: Path) -> np.ndarray:
    lines = path.read_text(encoding="ascii").splitlines()
    start = lines.index("end_header") + 1
    return np.array([[float(word) for word in line.split()] for line in lines[start : start + 162]])


def test_shuffling_is_the_same_every_time(tmp_path: Path) -> None:
    datasets.write_poses(tmp_path, ["ap0", "ap1"])
    first, again = (humans(tmp_path)[0].pairs[0].load() for _ in range(2))
    np.testing.assert_array_equal(first.truth.target_points, again.truth.target_points)
    np.testing.assert_array_equal(first.target.faces, again.target.faces)


def test_remeshed_humans_use_their_truth_files(tmp_path: Path) -> None:
    folder = tmp_path / "remeshed"
    write_mirror(folder, datasets.write_remeshed(folder, ["ap0", "ap2", "bp0"], ".truth.txt", base=0))
    (folder / "pairs_same.txt").write_text("ap0 ap2\nap0 bp0\n", encoding="ascii")
    (layout,) = humans(folder, "pairs_same.txt")
    assert [pair.shuffle_seed for pair in layout.pairs] == [None, None]
    for pair in layout.pairs:
        mean, mirrored = errors_of_nearest(pair)
        assert mean < 0.05 < 0.1 < (mirrored or 0)


def test_a_pairs_file_from_elsewhere(tmp_path: Path) -> None:
    datasets.write_poses(tmp_path / "mid", ["ap0", "ap1", "ap10"])
    listing = tmp_path / "mine.txt"
    listing.write_text("ap10.ply, ap1.ply\n", encoding="ascii")
    (layout,) = humans(tmp_path / "mid", listing)
    assert names(layout) == ["ap10 ap1"]
    (inner,) = humans(tmp_path / "mid")
    assert names(inner) == ["ap0 ap1", "ap0 ap10"]


def test_missing_files_are_named_and_the_rest_is_kept(tmp_path: Path) -> None:
    folder = tmp_path / "remeshed"
    datasets.write_remeshed(folder, ["ap0", "ap2", "ap4"], ".truth.txt", base=0)
    (folder / "pairs_same.txt").write_text("ap0 ap2\nap0 ap9\nap2 ap9\nap0 ap4\n", encoding="ascii")
    (folder / "ap4.truth.txt").unlink()
    (layout,) = humans(folder)
    assert names(layout) == ["ap0 ap2"]
    assert len(layout.problems) == 2
    assert "no mesh ap9, so 2 pairs left out (ap0 ap9, ap2 ap9)" in layout.problems[0]
    assert "no file ap4.truth.txt, so 1 pair left out (ap0 ap4)" in layout.problems[1]


def test_a_wrong_file_is_named_when_the_pair_is_loaded(tmp_path: Path) -> None:
    datasets.write_poses(tmp_path, ["ap0", "ap1"])
    (tmp_path / "ap1.ply").write_text("ply\nformat ascii 1.0\nend_header\n", encoding="ascii")
    with pytest.raises(ClalignError, match=r"ap1\.ply"):
        humans(tmp_path)[0].pairs[0].load()


def test_meshes_of_other_counts_cannot_be_the_identity(tmp_path: Path) -> None:
    datasets.write_poses(tmp_path, ["ap0"])
    import shapes

    datasets.write_ply(tmp_path / "bp0.ply", *shapes.icosphere(1))
    with pytest.raises(ResultError, match="ap0 has 162 vertices and bp0 has 42"):
        humans(tmp_path)[0].pairs[0].load()


def test_animals_are_all_pairs_of_each_folder(tmp_path: Path) -> None:
    datasets.write_poses(tmp_path / "cow", ["cow01", "cow02", "cow03"])
    datasets.write_poses(tmp_path / "bear", ["bear1", "bear2"])
    (tmp_path / "LICENSE").write_text("MIT", encoding="ascii")
    bear, cow = animals(tmp_path)
    assert (bear.name, names(bear)) == ("bear", ["bear1 bear2"])
    assert (cow.name, names(cow)) == ("cow", ["cow01 cow02", "cow01 cow03", "cow02 cow03"])
    assert len({pair.shuffle_seed for pair in cow.pairs}) == 3
    assert errors_of_nearest(cow.pairs[2])[0] < 0.03
    assert animals(tmp_path / "cow")[0].pairs == cow.pairs


@pytest.fixture
def registrations(tmp_path: Path) -> Path:
    """Subjects 0 and 3 with three poses each, one of them not the first."""
    datasets.write_poses(tmp_path / "faust", [f"tr_reg_{number:03d}" for number in (0, 1, 2, 30, 33, 35)])
    return tmp_path / "faust"


def test_faust_intra_is_the_first_pose_against_the_others(registrations: Path) -> None:
    (layout,) = faust(registrations)
    assert names(layout) == [f"tr_reg_{a:03d} tr_reg_{b:03d}" for a, b in ((0, 1), (0, 2), (30, 33), (30, 35))]
    assert all(pair.shuffle_seed is not None for pair in layout.pairs)
    assert "94 of FAUST's 100 meshes are absent (tr_reg_003 … tr_reg_099)" in layout.problems[0]
    assert any("no mesh tr_reg_003, so 1 pair left out" in problem for problem in layout.problems)
    assert errors_of_nearest(layout.pairs[0])[0] < 0.03


def test_a_whole_faust_has_ninety_intra_and_fortyfive_inter_pairs(tmp_path: Path) -> None:
    for number in range(100):
        (tmp_path / f"tr_reg_{number:03d}.ply").touch()
    (intra,) = faust(tmp_path)
    assert (len(intra.pairs), intra.problems) == (90, ())
    assert all(pair.name[7:9] == pair.name[18:20] and pair.name[9] == "0" for pair in intra.pairs)
    (inter,) = faust(tmp_path, "inter")
    assert (len(inter.pairs), inter.problems) == (45, ())
    assert all(pair.name[7:9] != pair.name[18:20] for pair in inter.pairs)


def test_faust_pairs_file_with_numbers_or_names(registrations: Path, tmp_path: Path) -> None:
    listing = tmp_path / "pairs.txt"
    listing.write_text("0 33\ntr_reg_001 tr_reg_035.ply\n", encoding="ascii")
    (layout,) = faust(registrations, listing)
    assert names(layout) == ["tr_reg_000 tr_reg_033", "tr_reg_001 tr_reg_035"]


@pytest.mark.parametrize("inner", ["", "off"])
def test_remeshed_faust_uses_vts_counted_from_one(tmp_path: Path, inner: str) -> None:
    root = tmp_path / "FAUST_r"
    datasets.write_remeshed(root / inner, [f"tr_reg_{number:03d}" for number in (0, 1, 2)], ".vts", base=1)
    (layout,) = faust(root)
    assert names(layout) == ["tr_reg_000 tr_reg_001", "tr_reg_000 tr_reg_002"]
    assert [pair.shuffle_seed for pair in layout.pairs] == [None, None]
    assert errors_of_nearest(layout.pairs[0])[0] < 0.05


def test_remeshed_faust_is_not_read_as_the_identity(tmp_path: Path) -> None:
    datasets.write_remeshed(tmp_path, ["tr_reg_000", "tr_reg_001"], ".vts", base=1)
    with pytest.raises(ResultError, match=r"corres/\*\.vts, which 'clalign bench faust --root' reads"):
        humans(tmp_path)


def test_registrations_are_found_below_the_folder_that_is_downloaded(tmp_path: Path) -> None:
    datasets.write_poses(tmp_path / "training" / "registrations", ["tr_reg_000", "tr_reg_001"])
    (layout,) = faust(tmp_path)
    assert names(layout) == ["tr_reg_000 tr_reg_001"]


@pytest.mark.parametrize("suffix", [".off", ".ply"])
def test_classes_of_one_connectivity(tmp_path: Path, suffix: str) -> None:
    datasets.write_poses(tmp_path, ["cat0", "cat2", "cat10", "dog1", "dog5", "horse0"], suffix)
    (layout,) = faust(tmp_path)
    assert names(layout) == ["cat0 cat2", "cat0 cat10", "dog1 dog5"]
    assert layout.problems == ()
    assert errors_of_nearest(layout.pairs[0])[0] < 0.03
    with pytest.raises(ResultError, match="no truth between them"):
        faust(tmp_path, "inter")


def test_layouts_that_are_not_there(tmp_path: Path) -> None:
    with pytest.raises(ResultError, match="not a folder"):
        humans(tmp_path / "gone")
    for reader in (humans, animals, faust):
        with pytest.raises(ResultError, match=r"no (mesh|folder|tr_reg)"):
            reader(tmp_path)
    datasets.write_poses(tmp_path, ["ap0", "ap1"])
    with pytest.raises(ResultError, match=r"no pairs file gone\.txt"):
        humans(tmp_path, "gone.txt")


@pytest.mark.parametrize(
    ("text", "message"), [("a b c\n", "line 1: expected"), ("# none\n", "no pair"), ("a\n", "line 1")]
)
def test_bad_pairs_files(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "pairs.txt"
    path.write_text(text, encoding="ascii")
    with pytest.raises(ResultError, match=message):
        read_pairs_file(path)


def test_limited(tmp_path: Path) -> None:
    datasets.write_poses(tmp_path, ["ap0", "ap1", "ap2"])
    (layout,) = humans(tmp_path)
    assert names(layout.limited(1)) == ["ap0 ap1"]
    assert layout.limited(None) == layout
