"""What a match warns of: kept in the result, raised at the user's own line."""

from __future__ import annotations

import dataclasses
import inspect
import warnings
from typing import Any

import numpy as np
import pytest
import shapes

import clalign
from clalign.alignment.objective import Evaluation, Objective
from clalign.correspondence import Correspondence
from clalign.engine import Reference
from clalign.errors import ClalignWarning, ConfidenceWarning
from clalign.geometry.shape import prepare_pair
from clalign.matching.pair import match_shapes
from clalign.mesh.mesh import mesh_from_arrays
from clalign.options import Options

QUICK = Options().replace(
    {
        "engine.backend": "reference",
        "search.method": "random",
        "spectrum.basis": 16,
        "spectrum.refinement": 16,
        "spectrum.scale_invariant": 24,
        "geodesics.search_samples": 60,
        "alignment.outer_iterations": 1,
        "alignment.iterations": 3,
        "readout.steps": 0,
    }
)
BODY = shapes.bumpy_sphere(2)
NOT_SEARCHED = "no search was made"


def by_match() -> tuple[Correspondence, int]:
    """Return a result and the number of the line that asked for it."""
    line = inspect.currentframe().f_lineno + 1  # type: ignore[union-attr]
    return clalign.match(BODY, BODY, QUICK), line


def by_match_shapes() -> tuple[Correspondence, int]:
    """Do the same from prepared shapes."""
    mesh = mesh_from_arrays(*BODY)
    pair = prepare_pair(mesh, mesh, QUICK)
    line = inspect.currentframe().f_lineno + 1  # type: ignore[union-attr]
    return match_shapes(*pair, Reference(), QUICK), line


@pytest.mark.parametrize("entry", [by_match, by_match_shapes])
def test_warnings_point_at_the_line_of_the_user(entry: Any) -> None:
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        result, line = entry()
    assert [(each.category, each.filename, each.lineno) for each in seen] == [(ConfidenceWarning, __file__, line)]
    assert str(seen[0].message).startswith(NOT_SEARCHED)
    assert result.warnings == (str(seen[0].message),)


def test_an_objective_without_a_finite_value_is_raised_and_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    evaluate = Objective.value_and_gradient

    def never_finite(self: Objective, *arguments: Any) -> Evaluation:
        return dataclasses.replace(evaluate(self, *arguments), total=np.nan)

    monkeypatch.setattr(Objective, "value_and_gradient", never_finite)
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        result, line = by_match()
    assert tuple(str(each.message) for each in seen) == result.warnings
    assert [(each.category, each.lineno) for each in seen] == [(ClalignWarning, line), (ConfidenceWarning, line)]
    assert "no finite value" in result.facts()["warnings"][0]


def test_notes_and_an_interrupt_are_kept_without_being_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    """The user has pressed Ctrl-C, and the notes say what was done to a mesh that could be used."""
    vertices, faces = BODY
    loose = np.concatenate([vertices, [[9.0, 9.0, 9.0]]]), faces
    interrupted = [True]
    distortion = clalign.matching.result.local_distortion

    def once(*arguments: Any) -> Any:
        if interrupted.pop() if interrupted else False:
            raise KeyboardInterrupt
        return distortion(*arguments)

    monkeypatch.setattr("clalign.matching.result.local_distortion", once)
    with pytest.warns(ConfidenceWarning) as seen:
        result = clalign.match(loose, BODY, QUICK)
    assert result.interrupted
    assert result.source.notes
    assert [str(each.message) for each in seen] == [text for text in result.warnings if NOT_SEARCHED in text]
    assert any(result.source.notes[0] in text for text in result.warnings)
    assert seen[0].filename == __file__


def test_without_a_search_there_is_no_confidence() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClalignWarning)
        result, _ = by_match()
    assert np.isnan(result.confidence)
    assert result.facts()["confidence"] is None


@pytest.mark.filterwarnings("ignore::clalign.ConfidenceWarning")
def test_sizes_that_cannot_be_had_are_in_the_warnings_of_the_result() -> None:
    options = QUICK.replace({"spectrum.basis": 200, "spectrum.refinement": 3})
    result = clalign.match(BODY, BODY, options)
    assert result.warnings[:2] == (
        "spectrum.refinement=3 is less than spectrum.basis=200; 200 eigenfunctions are computed",
        "spectrum.basis=200 is more than the 162 vertices of the smaller mesh; "
        "at most a third as many eigenfunctions as vertices are used",
    )
