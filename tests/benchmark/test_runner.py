from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import datasets
import numpy as np
import pytest
from datasets import NearestMethod

from clalign.alignment import alternation
from clalign.benchmark.layouts import Layout, animals
from clalign.benchmark.methods import AlignMethod
from clalign.benchmark.records import RECORDS_FILE, Record, read_curves, read_records
from clalign.benchmark.runner import Measurement, run
from clalign.errors import OptionError, ResultError
from clalign.evaluation.errors import THRESHOLDS
from clalign.options import Options


@pytest.fixture
def layouts(tmp_path: Path) -> tuple[Layout, ...]:
    datasets.write_poses(tmp_path / "egg", ["egg1", "egg2", "egg3"])
    return animals(tmp_path / "egg")


def test_a_row_a_pair_and_method(layouts: tuple[Layout, ...], tmp_path: Path) -> None:
    seen: list[tuple[int, int, str]] = []
    methods = [NearestMethod("a"), NearestMethod("b")]
    finished = run(
        layouts, methods, tmp_path / "out", progress=lambda done, total, row: seen.append((done, total, row.pair))
    )
    assert [(row.pair, row.method) for row in finished.records[:3]] == [
        ("egg1 egg2", "a"),
        ("egg1 egg2", "b"),
        ("egg1 egg3", "a"),
    ]
    assert [entry[:2] for entry in seen] == [(number, 6) for number in range(1, 7)]
    row = finished.records[0]
    assert row.status == "ok"
    assert row.mean is not None
    assert row.mean < 0.03
    assert (row.confidence, row.orientation, row.seconds, row.stages) == (0.75, 1.0, 0.5, "search=0.250")
    assert row.flipped is None


def test_what_is_written_is_what_is_returned(layouts: tuple[Layout, ...], tmp_path: Path) -> None:
    finished = run(layouts, [NearestMethod()], tmp_path / "out")
    stored = read_records(tmp_path / "out")
    assert [row.key for row in stored] == [row.key for row in finished.records]
    for ours, theirs in zip(finished.records, stored, strict=True):
        for field in dataclasses.fields(Record):
            value, read = getattr(ours, field.name), getattr(theirs, field.name)
            assert read == (pytest.approx(value, rel=1e-5) if isinstance(value, float) else value)
    curves = read_curves(tmp_path / "out", "sqrt_area")
    curve = curves[finished.records[0].key]
    assert curve.shape == THRESHOLDS.shape
    assert curve[0] == pytest.approx(finished.records[0].exact, abs=1e-4)
    assert (np.diff(curve) >= 0).all()


def test_a_second_run_computes_nothing(layouts: tuple[Layout, ...], tmp_path: Path) -> None:
    log = tmp_path / "log.txt"
    method = NearestMethod(log=str(log))
    first = run(layouts, [method], tmp_path / "out")
    again = run(layouts, [method], tmp_path / "out")
    assert len(log.read_text(encoding="ascii").splitlines()) == 3
    assert [row.key for row in again.records] == [row.key for row in first.records]
    run(layouts, [method], tmp_path / "out", resume=False)
    assert len(log.read_text(encoding="ascii").splitlines()) == 6


@pytest.mark.parametrize("change", ["settings", "points"])
def test_other_settings_are_computed_anew(layouts: tuple[Layout, ...], tmp_path: Path, change: str) -> None:
    log = tmp_path / "log.txt"
    run(layouts, [NearestMethod(log=str(log))], tmp_path / "out")
    settings, points = ("2", None) if change == "settings" else ("1", 10)
    other = NearestMethod(log=str(log), settings=settings)
    finished = run(layouts, [other], tmp_path / "out", measurement=Measurement(points=points))
    assert len(log.read_text(encoding="ascii").splitlines()) == 6
    assert {row.points for row in finished.records} == {points or 162}


def test_an_interrupted_run_goes_on(layouts: tuple[Layout, ...], tmp_path: Path) -> None:
    log = tmp_path / "log.txt"
    method = NearestMethod(log=str(log))

    def stop(done: int, total: int, record: Record) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(layouts, [method], tmp_path / "out", progress=stop)
    file = tmp_path / "out" / RECORDS_FILE
    # A kill in the middle of writing leaves half a row.
    file.write_text(file.read_text(encoding="utf-8") + "egg,egg2 egg3,near", encoding="utf-8")
    finished = run(layouts, [method], tmp_path / "out")
    assert log.read_text(encoding="ascii").splitlines() == ["egg1 egg2", "egg1 egg3", "egg2 egg3"]
    assert [row.status for row in finished.records] == ["ok"] * 3
    assert len(read_records(tmp_path / "out")) == 3


@pytest.mark.filterwarnings("ignore::clalign.errors.ConfidenceWarning")
def test_a_match_that_was_cut_short_is_no_row(
    layouts: tuple[Layout, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`match` returns after Ctrl-C; a benchmark must end there and not measure what came of it."""
    plain, calls = alternation.read_out, 0

    def interrupted(*arguments: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == 2:
            raise KeyboardInterrupt
        return plain(*arguments)

    monkeypatch.setattr(alternation, "read_out", interrupted)
    quick = {
        "search.method": "random",
        "alignment.outer_iterations": 0,
        "spectrum.scale_invariant": 24,
        "spectrum.basis": 16,
    }
    options = Options().replace({**quick, "spectrum.refinement": 16, "engine.backend": "reference"})
    with pytest.raises(KeyboardInterrupt):
        run(layouts, [AlignMethod("own", options)], tmp_path / "out")
    assert [row.pair for row in read_records(tmp_path / "out")] == ["egg1 egg2"]


def test_a_failing_pair_is_recorded_and_tried_again(layouts: tuple[Layout, ...], tmp_path: Path) -> None:
    finished = run(layouts, [NearestMethod(fails_on="egg2")], tmp_path / "out")
    assert [row.status for row in finished.records] == ["failed", "ok", "ok"]
    assert finished.records[0].message == "egg2 is not to my taste"
    healed = run(layouts, [NearestMethod()], tmp_path / "out")
    assert [row.status for row in healed.records] == ["ok"] * 3
    assert len(read_records(tmp_path / "out")) == 4


def test_a_broken_mesh_costs_its_pairs_only(layouts: tuple[Layout, ...], tmp_path: Path) -> None:
    (tmp_path / "egg" / "egg3.ply").write_text("no mesh", encoding="ascii")
    finished = run(layouts, [NearestMethod()], tmp_path / "out")
    assert [row.status for row in finished.records] == ["ok", "failed", "failed"]
    assert "egg3.ply" in finished.records[1].message


def test_worker_processes_give_the_same_rows(layouts: tuple[Layout, ...], tmp_path: Path) -> None:
    alone = run(layouts, [NearestMethod()], tmp_path / "one")
    together = run(layouts, [NearestMethod()], tmp_path / "two", jobs=2)
    assert together == alone


def test_a_worker_that_dies_does_not_end_the_run(layouts: tuple[Layout, ...], tmp_path: Path) -> None:
    both = [NearestMethod(dies_on="egg2")]
    finished = run(layouts, both, tmp_path / "out", jobs=2)
    assert len(finished.records) == 3
    first, *others = finished.records
    assert first.failed
    assert "ended without an answer" in first.message
    # Whatever the other worker was at is lost, too.
    assert not all(other.failed for other in others)


def test_bad_calls(layouts: tuple[Layout, ...], tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="jobs"):
        run(layouts, [NearestMethod()], tmp_path / "out", jobs=0)
    with pytest.raises(OptionError, match="one name"):
        run(layouts, [NearestMethod(), NearestMethod()], tmp_path / "out")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / RECORDS_FILE).write_text("pair,error\na b,0.1\n", encoding="utf-8")
    with pytest.raises(ResultError, match="not written by this version"):
        run(layouts, [NearestMethod()], tmp_path / "out")
