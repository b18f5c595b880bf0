"""Files of values on vertices."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from clalign.correspondence import Correspondence
from clalign.errors import InputError
from clalign.transfer.value_files import read_values, write_values


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
