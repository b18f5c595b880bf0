from __future__ import annotations

from pathlib import Path

import datasets
import numpy as np
import pytest
import shapes

from clalign.errors import ResultError
from clalign.evaluation.truth import Truth, read_index, read_index_truth, read_mirror, read_pair_truth, true_maps
from clalign.mesh.mesh import mesh_from_arrays


def test_the_same_map_is_read_from_both_bases(tmp_path: Path) -> None:
    index = np.array([2, 0, 1, 3])
    zero = read_index_truth(datasets.write_numbers(tmp_path / "zero.txt", index), base=0, target_count=4)
    one = read_index_truth(datasets.write_numbers(tmp_path / "one.txt", index + 1), base=1, target_count=4)
    np.testing.assert_array_equal(zero.target_points, one.target_points)
    np.testing.assert_array_equal(zero.target_points, index)
    np.testing.assert_array_equal(zero.source_points, np.arange(4))


def test_a_wrong_base_is_recognised(tmp_path: Path) -> None:
    one_based = datasets.write_numbers(tmp_path / "one.txt", [1, 3, 2, 4])
    with pytest.raises(
        ResultError,
        match=r"one\.txt, line 4: vertex 4 is outside.*looks 1-based: say --truth-base 1, or --base 1 for a map",
    ):
        read_index(one_based, base=0, count=4)
    zero_based = datasets.write_numbers(tmp_path / "zero.txt", [1, 3, 0, 2])
    with pytest.raises(ResultError, match=r"zero\.txt, line 3: vertex 0 in a 1-based file"):
        read_index(zero_based, base=1, count=4)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("0\n1\nx\n", "line 3: 'x' is not one whole number"),
        ("0\n1.5\n", "line 2"),
        ("0 1\n2 3\n", "line 1"),
        ("0\n\n2\n", "line 2"),
        ("0\n-2\n", "line 2: vertex -2 is below zero"),
        ("0\nnan\n", "line 2"),
    ],
)
def test_a_bad_line_is_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "map.txt"
    path.write_text(text, encoding="ascii")
    with pytest.raises(ResultError, match=message):
        read_index(path)


def test_numbers_as_matlab_writes_them(tmp_path: Path) -> None:
    path = tmp_path / "map.txt"
    path.write_text("1.0\n2.000000e+00\n3\n", encoding="ascii")
    np.testing.assert_array_equal(read_index(path, base=1), [0, 1, 2])


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ResultError, match=r"gone\.txt"):
        read_index(tmp_path / "gone.txt")


def test_an_index_file_of_the_wrong_length(tmp_path: Path) -> None:
    path = datasets.write_numbers(tmp_path / "map.txt", [0, 1, 2])
    with pytest.raises(ResultError, match=r"3 lines.*4 vertices"):
        read_index_truth(path, source_count=4, target_count=4)


def test_points_without_truth_are_left_out(tmp_path: Path) -> None:
    truth = read_index_truth(datasets.write_numbers(tmp_path / "map.txt", [5, -1, 7]))
    np.testing.assert_array_equal(truth.source_points, [0, 2])
    np.testing.assert_array_equal(truth.target_points, [5, 7])


def test_vts_counts_from_one_and_truth_files_from_zero(tmp_path: Path) -> None:
    points_x, points_y = np.array([3, 0, 2]), np.array([1, 4, 4])
    for suffix, base in ((".vts", 1), (".truth.txt", 0)):
        x = datasets.write_numbers(tmp_path / f"X{suffix}", points_x + base)
        y = datasets.write_numbers(tmp_path / f"Y{suffix}", points_y + base)
        truth = read_pair_truth(x, y, source_count=4, target_count=5)
        np.testing.assert_array_equal(truth.source_points, points_x)
        np.testing.assert_array_equal(truth.target_points, points_y)


def test_files_of_different_length(tmp_path: Path) -> None:
    x = datasets.write_numbers(tmp_path / "X.vts", [1, 2, 3])
    y = datasets.write_numbers(tmp_path / "Y.vts", [1, 2])
    with pytest.raises(ResultError, match=r"X\.vts has 3 lines and .*Y\.vts has 2"):
        read_pair_truth(x, y)


def test_mirrored_exchanges_the_targets_of_mirror_lines() -> None:
    truth = Truth(np.array([10, 11, 12]), np.array([20, 21, 22]))
    mirrored = truth.mirrored(np.array([1, 0, 2]))
    np.testing.assert_array_equal(mirrored.source_points, [10, 11, 12])
    np.testing.assert_array_equal(mirrored.target_points, [21, 20, 22])


def test_a_mirror_that_does_not_fit(tmp_path: Path) -> None:
    truth = Truth.identity(3)
    with pytest.raises(ResultError, match="2 lines and the truth 3"):
        truth.mirrored([1, 0])
    with pytest.raises(ResultError, match="line 2 says 3"):
        truth.mirrored([1, 3, 0])
    with pytest.raises(ResultError, match=r"mirror\.txt, line 1: point 7"):
        read_mirror(datasets.write_numbers(tmp_path / "mirror.txt", [7, 0]))


def test_renumbered_follows_the_vertices() -> None:
    truth = Truth(np.array([0, 1]), np.array([2, 0]))
    moved = truth.renumbered(np.array([2, 1, 0]))
    np.testing.assert_array_equal(moved.source_points, [0, 1])
    np.testing.assert_array_equal(moved.target_points, [0, 2])


def test_bad_truths() -> None:
    with pytest.raises(ResultError, match="3 source points and 2 target points"):
        Truth(np.arange(3), np.arange(2))
    with pytest.raises(ResultError, match="line 2 of the truth names target vertex -4"):
        Truth(np.arange(2), np.array([0, -4]))
    with pytest.raises(ResultError, match="whole numbers"):
        Truth(np.array([0.5]), np.array([1.0]))
    with pytest.raises(ResultError, match="line 3 of the truth names source vertex 2"):
        Truth.identity(3).check_against(2, 3)


def test_truth_cannot_be_changed() -> None:
    truth = Truth.identity(3)
    with pytest.raises(ValueError, match="read-only"):
        truth.source_points[0] = 1


def test_gaps_of_the_truth_are_filled_from_beside() -> None:
    mesh = mesh_from_arrays(*shapes.icosphere(3), "sphere")
    every_other = np.arange(0, mesh.n_vertices, 2)
    maps = true_maps(mesh, mesh, Truth(every_other, every_other))
    backward = maps.source_of_target
    np.testing.assert_array_equal(backward[every_other], every_other)
    shift = np.linalg.norm(mesh.vertices[backward] - mesh.vertices, axis=1)
    edge = np.linalg.norm(mesh.vertices[mesh.faces[:, 0]] - mesh.vertices[mesh.faces[:, 1]], axis=1).max()
    assert shift.max() < 2 * edge
    np.testing.assert_array_equal(maps.target_of_source, backward)
    with pytest.raises(ResultError, match="no point on both"):
        true_maps(mesh, mesh, Truth(np.array([], dtype=int), np.array([], dtype=int)))
