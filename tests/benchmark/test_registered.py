"""The table and the curves of registered pairs."""

from __future__ import annotations

import numpy as np
import pytest

from clalign.benchmark.registered import RegisteredPair, registered_curves, registered_table
from clalign.cli.main import main
from clalign.registration.quality import Quality


def _pair(name: str, faces: int, turned: int, error: float) -> RegisteredPair:
    quality = Quality(turned / faces, 1 / faces, 0.01, 0.3, 0.02, 0.0, 1.1, 0.05)
    return RegisteredPair(name, faces, quality, np.full(50, 2 * error), np.full(50, error), 1.5)


def test_the_table_sums_faces_and_means_errors() -> None:
    pairs = [_pair("a b", 1000, 0, 0.01), _pair("a c", 3000, 2, 0.03)]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in registered_table(pairs).splitlines()]
    assert [row[:3] for row in rows[2:]] == [["a b", "0", "1"], ["a c", "2", "1"], ["**all**", "2", "2"]]
    assert rows[-1][5:9] == ["4.000", "4.000", "2.000", "2.000"]
    assert len({len(row) for row in rows}) == 1
    curves = registered_curves(pairs)
    # Thresholds are thousandths: at 0.015 half of the registered points are within, and none of the map's.
    assert curves["registered vertices"][15] == pytest.approx(0.5)
    assert curves["vertices of the map"][15] == 0.0


def test_a_benchmark_without_pairs_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "register"]) == 2
    assert "no pairs: name folders with --humans PATH" in capsys.readouterr().err
