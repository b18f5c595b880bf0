"""Coefficients of the forecast: fitted to measurements, and written by ``clalign bench forecast``."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from clalign import resources
from clalign.benchmark import calibration
from clalign.benchmark.calibration import Draw, Measured, fitted, measured, non_negative
from clalign.benchmark.generated import generated_pair
from clalign.cli.bench.speed import draw
from clalign.cli.main import main
from clalign.options import Options

STORED = [Measured(**{**one, "vertices": tuple(one["vertices"])}) for one in resources.calibration()["measured"]]


def test_measurements_that_obey_the_model_are_reproduced() -> None:
    obedient = []
    for one in STORED:
        predicted = resources.forecast(*one.vertices, Options().replace(one.changes), processors=1)
        work = {stage: seconds for stage, seconds in predicted.stages.items() if seconds > 0}
        matching = sum(seconds for stage, seconds in work.items() if stage not in resources.SERIAL)
        obedient.append(replace(one, memory=predicted.memory, device_memory=predicted.device_memory, work=work,
                                serial=0.2 * matching))  # fmt: skip
    # The bundled pair is not fitted to.
    obedient[-1] = replace(obedient[-1], memory=1, device_memory=1)
    found = fitted(obedient)
    assert found["parallel"] == pytest.approx(0.8)
    for name, expected in resources.calibration()["coefficients"].items():
        assert found["coefficients"][name] == pytest.approx(expected, rel=0.02, abs=1e-3 * max(expected.values())), name


def test_coefficients_are_not_negative_and_what_was_not_measured_does_not_count() -> None:
    rows = [({"fixed": 1.0, "n": n}, 8.0 - n) for n in (1.0, 2.0, 3.0)]
    found = non_negative([*rows, ({"fixed": 1.0, "n": 9.0}, 0.0), ({"fixed": 0.0, "n": 0.0}, 5.0)])
    assert found["n"] == 0.0
    assert 5.0 < found["fixed"] < 7.0
    assert non_negative([({"fixed": 1.0, "n": n}, 3.0 + 2 * n) for n in (1.0, 20.0)]) == {"fixed": 3.0, "n": 2.0}


def test_a_match_is_measured_with_what_is_drawn_of_it() -> None:
    problem = generated_pair(300)
    changes = {"engine.backend": "reference", "spectrum.scale_invariant": 40, "search.method": "random"}
    found = measured("generated", (problem.source, problem.target), changes, draw)
    assert found.vertices == (300, 300)
    assert list(found.work) == ["start", "prepare", "alignment", "result"]
    assert min(found.work.values()) > 0
    assert found.device_memory == 0
    assert found.memory > 50 * 2**20


def test_the_command_writes_what_it_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def measurements(draw: Draw, watch: Callable[[Measured], None]) -> list[Measured]:
        watch(STORED[0])
        return STORED

    monkeypatch.setattr(calibration, "measurements", measurements)
    out = tmp_path / "forecast.json"
    assert main(["bench", "forecast", "--out", str(out)]) == 0
    shown = capsys.readouterr()
    assert "generated, 1,000 vertices, default options: " in shown.err
    assert shown.out == f"wrote {out}\n"
    written = json.loads(out.read_text(encoding="utf-8"))
    assert written["measured"] == resources.calibration()["measured"]
    assert written["coefficients"] == resources.calibration()["coefficients"]
    assert main(["bench", "forecast", "--quiet", "--out", str(tmp_path / "none" / "forecast.json")]) != 0
    assert "cannot be written" in capsys.readouterr().err
