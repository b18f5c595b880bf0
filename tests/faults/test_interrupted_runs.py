"""Ctrl-C at every stage: the best so far is kept where there is one, and nothing is written where there is none."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from quick import Run, left_in

from clalign.alignment.problem import AlignmentProblem, Evaluation
from clalign.correspondence import Correspondence


@pytest.mark.parametrize(
    "place",
    [
        "clalign.geometry.mesh.load_mesh",
        "clalign.matching.prepare_pair",
        "clalign.matching.open_backend",
        "clalign.alignment.pipeline.bind",
        "clalign.correspondence.write_map",
        "clalign.storage._flush",
    ],
)
def test_before_and_after_the_alignment_nothing_is_kept(
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


@pytest.mark.parametrize("number", [3, 8, 20])
def test_the_alignment_keeps_the_best_so_far_and_says_so(
    match: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    """The interrupt comes at an evaluation of the objective; a first run shows what the later ones have lost."""
    plain, count = AlignmentProblem.value_and_gradient, 0

    def evaluate(self: AlignmentProblem, *arguments: Any) -> Evaluation:
        nonlocal count
        count += 1
        if count == number:
            raise KeyboardInterrupt
        return plain(self, *arguments)

    monkeypatch.setattr(AlignmentProblem, "value_and_gradient", evaluate)
    extra = ("--no-cache", "--set", "alignment.rounds=3", "--set", "alignment.iterations=40")
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
