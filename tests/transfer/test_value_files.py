"""Files of values on vertices."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from clalign.correspondence import Correspondence
from clalign.errors import InputError
from clalign.transfer.value_files import check_colours, read_values, write_values


@pytest.mark.parametrize("suffix", [".npy", ".txt", ".csv"])
def test_value_files_round_trip(small: Correspondence, tmp_path: Path, suffix: str) -> None:
    values = np.random.default_rng(3).normal(size=(643, 3))
    path = tmp_path / f"values{suffix}"
    write_values(path, values, small.source)
    assert np.array_equal(read_values(path), values)
    write_values(path, np.arange(643), small.source)
    assert np.array_equal(read_values(path, whole=True), np.arange(643))


def test_value_files_refuse_nonsense(small: Correspondence, tmp_path: Path) -> None:
    for name, content in (("a.txt", "1\n2 3\n"), ("b.txt", "one\n"), ("c.txt", ""), ("d.npy", "not numpy")):
        (tmp_path / name).write_text(content, encoding="utf-8")
        with pytest.raises(InputError, match=name):
            read_values(tmp_path / name)
    (tmp_path / "e.txt").write_text("1.5\n", encoding="utf-8")
    with pytest.raises(InputError, match="not whole"):
        read_values(tmp_path / "e.txt", whole=True)
    with pytest.raises(InputError, match="suffix"):
        write_values(tmp_path / "f.xyzzy", np.zeros(643), small.source)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.txt", "0,5\n1,25\n", "a.txt, line 1: '0,5' has a comma within a number: write decimals with a point"),
        ("a.csv", "0,5 1,5\n", "a.csv, line 1: '0,5 1,5' has a comma within a number"),
        ("a.txt", "# head\n0,5 1,5 2\n", "a.txt, line 2: '0,5 1,5 2' has a comma within a number"),
        (
            "a.csv",
            "1\n0,5\n",
            "line 2: '0,5' has 2 numbers, the first row has 1; perhaps it has a comma within a number",
        ),
        ("a.txt", "1 2\n3\n", "line 2: '3' has 1 numbers, the first row has 2$"),
        ("a.txt", "1 2\n3 x\n", "line 2: '3 x' holds something that is no number"),
    ],
)
def test_a_decimal_comma_is_called_that(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=message):
        read_values(tmp_path / name)


@pytest.mark.parametrize("separator", [" ", "\t", ",", ", ", ",\t"])
def test_columns_are_separated_by_blanks_or_commas(tmp_path: Path, separator: str) -> None:
    (tmp_path / "a.txt").write_text("\n".join(separator.join(row) for row in (("1", "2.5", "-3"), ("4", "nan", "6"))))
    np.testing.assert_array_equal(read_values(tmp_path / "a.txt"), [[1, 2.5, -3], [4, np.nan, 6]])


def test_colours_are_three_columns_in_their_range() -> None:
    path = Path("a.txt")
    for good in (np.zeros((4, 3)), np.full((4, 4), 255.0), np.array([[0.5, np.nan, 1.0]])):
        check_colours(path, good)
    for values, words in [
        (np.zeros(4), "colours are three columns, and it has 1; carry other numbers with the kind 'scalars'"),
        (np.zeros((4, 2)), "and it has 2"),
        (np.array([[-1.0, 0, 1]]), "0 to 1 or 0 to 255, and it has -1 to 1"),
        (np.array([[0, 0, 300.0]]), "and it has 0 to 300"),
    ]:
        with pytest.raises(InputError, match=words):
            check_colours(path, values)
