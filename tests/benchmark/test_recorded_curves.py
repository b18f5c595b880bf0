from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import datasets
import numpy as np
import pytest

from clalign.benchmark import methods
from clalign.benchmark.pairs import LoadedPair
from clalign.cli.bench import accuracy
from clalign.cli.main import main


def test_command_draws_curves_of_a_benchmark(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ["paper", "default"]
    monkeypatch.setattr(accuracy, "named_methods", lambda _, changes: [datasets.NearestMethod(name) for name in names])
    datasets.write_poses(tmp_path / "faust", [f"tr_reg_{number:03d}" for number in range(3)])
    bench = ["bench", "faust", "--root", str(tmp_path / "faust"), "--out", str(tmp_path / "bench"), "--quiet"]
    assert main(bench) == 0
    figures = ["figures", str(tmp_path / "bench"), "--out", str(tmp_path / "out")]
    assert main([*figures, "--which", "5"]) == 0
    with (tmp_path / "out" / "figure-5.csv").open(encoding="utf-8") as stream:
        last = list(csv.DictReader(stream))[-1]
    assert set(last) >= {"as printed (Eq. 24) / diameter", "this program / sqrt_area"}
    assert main([*figures, "--which", "1"]) == 2
    assert "ask for --which 5" in capsys.readouterr().err


def test_the_last_settings_of_a_method_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder that was run again with other settings has rows of both: they are not averaged."""
    datasets.write_poses(tmp_path / "faust", [f"tr_reg_{number:03d}" for number in range(2)])

    def drawn(method: methods.Method) -> float:
        monkeypatch.setattr(accuracy, "named_methods", lambda _, changes: [method])
        bench = ["bench", "faust", "--root", str(tmp_path / "faust"), "--out", str(tmp_path / "bench"), "--quiet"]
        assert main(bench) == 0
        assert main(["figures", str(tmp_path / "bench"), "--out", str(tmp_path / "out"), "--which", "5"]) == 0
        with (tmp_path / "out" / "figure-5.csv").open(encoding="utf-8") as stream:
            return float(next(csv.DictReader(stream))["this program / sqrt_area"])

    exact = datasets.NearestMethod("default")
    assert drawn(exact) == 1.0
    assert drawn(AllToOne("default")) < 0.1


@dataclass(frozen=True)
class AllToOne:
    """Matches every vertex with the first one."""

    name: str
    settings: str = "all to one"

    def __call__(self, pair: LoadedPair) -> methods.Outcome:
        return methods.Outcome(np.zeros(pair.source.file_count, dtype=np.int64), 0.1)
