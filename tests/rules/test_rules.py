"""Rules are read where they should be, and steer what they say."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest
import shapes
from prepared import MIDDLE, PreparedPair
from rules_read import every_rule, rule_classes, watch

from clalign import rules
from clalign.engine import Backend
from clalign.geometry.shape import prepare, with_scale_invariant
from clalign.matching.loop import Clock, run_stages
from clalign.matching.result import _doubts, _with_landmarks
from clalign.matching.stages import start_rotation, use_landmarks
from clalign.matching.start import RIGID, starting_map
from clalign.matching.state import MatchState, required
from clalign.mesh.landmarks import landmarks_of
from clalign.mesh.mesh import mesh_from_arrays
from clalign.option_values import leaves
from clalign.options import Options
from clalign.refinement.anchors import anchored
from clalign.refinement.rivals import in_doubt
from clalign.rules import JudgementRules, Rules
from clalign.search.batch import SampledShape, SamplePair, up_sample
from clalign.search.find import Candidate, SearchResult
from clalign.search.score import given_factors
from clalign.search.tips import given_candidates, tip_candidates

CLASSES = rule_classes(rules)


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> Iterator[set[str]]:
    """Collect "Class.field" of every rule that is read."""
    yield watch(monkeypatch, CLASSES)
    monkeypatch.undo()


def test_a_match_reads_every_rule(middle: PreparedPair, kernels: Backend, read: set[str]) -> None:
    """A rule that nothing reads is a number that steers nothing."""
    changes = {"spectrum.metric": "auto", "spectrum.xi": 0.5, "alignment.outer_iterations": 1}
    options = MIDDLE.replace(changes | {"rules.rivals.doubtful": 1.1})
    source, target = (with_scale_invariant(shape, options.spectrum) for shape in middle[:2])
    other = options.replace({"readout.refine": "zoomout", "readout.steps": 1})
    read.clear()
    with np.errstate(all="ignore"):
        state = run_stages(MatchState(source, target, options, 0.5), kernels, Clock())
        *_, _ = start_rotation(dataclasses.replace(state, options=other, start=None), kernels, lambda *_: None)
        limbed = SampledShape.of(prepare(mesh_from_arrays(*shapes.limbed_sphere((1.4, 1.2, 1.6, 1.0, 1.8))), MIDDLE))
        tip_candidates(SamplePair(limbed, limbed, kernels), Rules().search)
        known = landmarks_of([[0, int(middle.truth.target_of_source[0])]], source.mesh, target.mesh)
        *_, state = use_landmarks(dataclasses.replace(state, landmarks=known), kernels, lambda *_: None)
        _with_landmarks(state, required(state.maps))
        x, y = anchored(source, target, required(state.found).chosen.functional, options.rules, kernels)
        beside = SamplePair.of(x, y, kernels)
        with_given = up_sample(beside, given_candidates(beside, options.rules.search), [options.rules.search.joined])
        given_factors(beside, with_given, options.rules.search)
        starting_map(RIGID, source.mesh, target.mesh, options.rules.start)
        found = required(state.found)
        in_doubt(dataclasses.replace(found, alternatives=(found.chosen,)), 1.0, options.rules)
    # Judged or named in the result, and read by collections, parts or registrations only.
    elsewhere = {"JudgementRules", "CollectionRules", "PartRules", "RegistrationRules", "RelationRules", "Rules"}
    expected = every_rule([each for each in CLASSES if each.__name__ not in elsewhere])
    assert expected - read == set()
    assert not {name for name in read if name.startswith("JudgementRules.")}


def doubts(margin: float, orientation: float, judgement: JudgementRules, wanted: str = "any") -> list[str]:
    candidate = Candidate(np.eye(3), 1.0, orientation, 0.0)
    options = dataclasses.replace(
        Options().replace({"search.orientation": wanted}), rules=dataclasses.replace(Rules(), judgement=judgement)
    )
    state = SimpleNamespace(found=SearchResult(candidate, (), margin), alternatives=(), options=options)
    return _doubts(state, options)  # type: ignore[arg-type]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_doubts_begin_at_the_rules(sign: float) -> None:
    default = JudgementRules()
    assert doubts(0.2, sign * 0.95, default) == []
    assert ["low confidence" in text for text in doubts(0.1, sign * 0.95, default)] == [True]
    assert ["orientation" in text for text in doubts(0.2, sign * 0.85, default)] == [True]
    assert len(doubts(0.1, sign * 0.85, default)) == 2
    assert doubts(0.1, sign * 0.85, JudgementRules(low_confidence=0.05, low_orientation=0.8)) == []


def test_a_map_of_the_wrong_orientation_is_in_doubt() -> None:
    for wanted, orientation in (("preserving", -0.95), ("reversing", 0.95)):
        (doubt,) = doubts(0.2, orientation, JudgementRules(), wanted)
        assert f"against --orientation {wanted}" in doubt
        assert doubts(0.2, -orientation, JudgementRules(), wanted) == []


def test_rules_go_with_the_options_into_the_result_and_back() -> None:
    changed = Options().replace({"rules.search.finalists": 7, "rules.refinement.settle": "150,250"})
    values = changed.as_dict()
    assert values["rules"]["search"]["finalists"] == 7
    assert Options.from_dict(values) == changed != Options()
    assert {name for name, _ in leaves(changed) if name.startswith("rules.")} == {
        f"rules.{name}" for name, _ in leaves(Rules())
    }


def test_a_rule_changes_the_search(middle: PreparedPair, kernels: Backend) -> None:
    """Maps that are closer than `distinct` are one map: with a tiny radius there are alternatives, with a huge none."""
    found = {}
    for distinct in (1e-6, 10.0):
        options = MIDDLE.replace({"rules.search.distinct": distinct, "readout.refine": "none"})
        state = MatchState(middle.source, middle.target, options.replace({"alignment.outer_iterations": 0}), 0.3)
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found[distinct] = run_stages(state, kernels, Clock()).found
    assert found[10.0] is not None
    assert found[1e-6] is not None
    assert len(found[10.0].alternatives) == 0
    assert len(found[1e-6].alternatives) > 0
    assert np.isinf(found[10.0].margin)
