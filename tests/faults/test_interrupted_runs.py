"""Ctrl-C at every stage: the best so far is kept where there is one, and nothing is written where there is none."""

from __future__ import annotations

import json
import pkgutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from quick import QUICK, Run, left_in

from clalign.alignment.objective import Evaluation, Objective
from clalign.correspondence import Correspondence


@pytest.mark.parametrize(
    "place",
    [
        "clalign.mesh.mesh.load_mesh",
        "clalign.matching.pair.prepare_pair",
        "clalign.matching.pair.open_backend",
        "clalign.matching.stages.bind",
    ],
)
def test_before_the_first_map_nothing_is_kept(
    match: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    def interrupted(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(place, interrupted)
    shown = match(tmp_path / "out", "--no-cache")
    assert shown.status == 130
    assert shown.out == ""
    assert shown.err.splitlines()[-1].startswith("interrupted")
    assert "Traceback" not in shown.err
    assert left_in(tmp_path) == []


#: A search and every step that can follow it.
WHOLE = [
    *("--set", "search.method=tree", "--set", "spectrum.metric=auto", "--set", "spectrum.refinement=30"),
    *("--set", "readout.steps=1", "--set", "readout.subvertex=true", "--set", "search.alternatives=1", "--no-cache"),
]


def once(monkeypatch: pytest.MonkeyPatch, place: str, after: int = 0) -> None:
    """Let the function at `place` be interrupted at its call number `after`, and work before and after that."""
    module, _, name = place.rpartition(".")
    owner = pkgutil.resolve_name(module)
    plain, calls = getattr(owner, name), 0

    def interrupted(*arguments: Any, **named: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == after + 1:
            raise KeyboardInterrupt
        return plain(*arguments, **named)

    monkeypatch.setattr(owner, name, interrupted)


@pytest.mark.parametrize("place", ["clalign.matching.stages.find_isometry", "clalign.search.find.ranked"])
def test_during_the_search_nothing_is_kept(
    match: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    once(monkeypatch, place)
    shown = match(tmp_path / "out", *WHOLE)
    assert (shown.status, shown.out) == (130, "")
    assert shown.err.splitlines()[-1] == "interrupted: there was nothing to keep yet"
    assert left_in(tmp_path) == []


def test_a_search_that_has_ended_is_not_made_again(match: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The interrupt falls between the end of the search and what comes next."""
    searches, find = [], pkgutil.resolve_name("clalign.matching.stages.find_isometry")
    monkeypatch.setattr("clalign.matching.stages.find_isometry", lambda *a: searches.append(a) or find(*a))
    plain, stage = pkgutil.resolve_name("clalign.matching.loop.time.perf_counter"), []

    def ticking() -> float:
        if searches and not stage and pkgutil.resolve_name("inspect.stack")()[1].function == "stage":
            stage.append(1)
            raise KeyboardInterrupt
        return float(plain())

    monkeypatch.setattr("clalign.matching.loop.time.perf_counter", ticking)
    shown = match(tmp_path / "out", *WHOLE)
    assert shown.status == 0, shown.err
    assert len(searches) == 1
    assert Correspondence.load(tmp_path / "out").status == "interrupted"


@pytest.mark.parametrize(
    ("place", "after"),
    [
        ("clalign.matching.stages.refined_maps", 0),
        ("clalign.matching.stages.patchwise_maps", 0),
        ("clalign.matching.stages.refined_maps", 1),
        ("clalign.matching.stages.choose_metric", 0),
        ("clalign.matching.stages.least_squares_start", 0),
        ("clalign.matching.stages.bind", 0),
        ("clalign.alignment.alternation.hard_map", 0),
        ("clalign.alignment.alternation.read_out", 0),
        ("clalign.alignment.objective.Objective.functional_map", 0),
        ("clalign.matching.stages.two_way_step", 0),
        ("clalign.matching.stages.closest_points", 0),
        ("clalign.matching.result.local_distortion", 0),
    ],
)
def test_from_the_first_map_on_the_best_is_kept(
    match: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str, after: int
) -> None:
    once(monkeypatch, place, after)
    shown = match(tmp_path / "out", *WHOLE)
    assert shown.status == 0, shown.err
    assert "warning: interrupted: " in shown.err
    result = Correspondence.load(tmp_path / "out")
    assert result.warnings[0].startswith("interrupted: ")
    assert result.interrupted
    # The pair is one shape bent: vertex i is vertex i, and even the search's map is close to that.
    missed = result.source.vertices[result.target_of_source] - result.source.vertices
    assert np.linalg.norm(missed, axis=1).mean() < 0.1
    assert result.functional_map.shape[0] == result.target_basis.count
    assert np.isfinite(result.losses["total"])


def test_a_second_interrupt_gives_up(match: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    once(monkeypatch, "clalign.matching.stages.patchwise_maps")
    once(monkeypatch, "clalign.matching.stages.least_squares_start")
    shown = match(tmp_path / "out", *WHOLE)
    assert shown.status == 130
    assert left_in(tmp_path) == []


@pytest.mark.parametrize(
    "place",
    [
        "clalign.correspondence.write_map",
        "clalign.storage.folders._flush",
        "clalign.presentation.picture.match_image",
        "clalign.presentation.report.page.write_page",
    ],
)
def test_after_the_match_it_is_written_without_the_rest(
    run: Run, pair: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    once(monkeypatch, place)
    quick = [word for word in QUICK if word not in ("--no-picture", "--no-report")]
    shown = run("match", *pair, "--out", tmp_path / "out", "--device", "reference", "--no-cache", *quick)
    assert shown.status == 0, shown.err
    assert "has the maps, without picture, page" in shown.err
    assert (Correspondence.load(tmp_path / "out").target_of_source >= 0).all()
    assert not (tmp_path / "out" / "report.html").exists()
    assert [name for name in left_in(tmp_path) if name.startswith(".")] == []


@pytest.mark.parametrize("number", [3, 8, 20])
def test_the_alignment_keeps_the_best_so_far_and_says_so(
    match: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    """The interrupt comes at an evaluation of the objective; a first run shows what the later ones have lost."""
    plain, count = Objective.value_and_gradient, 0

    def evaluate(self: Objective, *arguments: Any) -> Evaluation:
        nonlocal count
        count += 1
        if count == number:
            raise KeyboardInterrupt
        return plain(self, *arguments)

    monkeypatch.setattr(Objective, "value_and_gradient", evaluate)
    extra = ("--no-cache", "--set", "alignment.outer_iterations=3", "--set", "alignment.iterations=40")
    shown = match(tmp_path / "out", *extra)
    assert shown.status == 0
    assert "warning: interrupted" in shown.err
    result = Correspondence.load(tmp_path / "out")
    assert any(warning.startswith("interrupted") for warning in result.warnings)
    facts = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    assert any(warning.startswith("interrupted") for warning in facts["warnings"])
    totals = [entry["total"] for entry in result.history]
    assert len(totals) < number
    # With a hard map of its own the kept point is not worse than where the search for it began.
    assert result.losses["total"] <= 1.001 * max(totals)
    assert (result.target_of_source >= 0).all()
    assert left_in(tmp_path) == ["out", *sorted(f"out/{path.name}" for path in (tmp_path / "out").iterdir())]
