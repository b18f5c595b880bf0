"""Distances to anchors: where they are used, what they are, and that an isometry carries them along."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from prepared import MIDDLE, PreparedPair, true_functional_map

from clalign.engine import Backend
from clalign.matching.loop import Clock, run_stages
from clalign.matching.stages import STAGES
from clalign.matching.state import MatchState
from clalign.refinement.anchors import anchored, relative_distortion
from clalign.rules import AnchorRules, Rules

RULES = Rules()


def test_a_right_map_distorts_less_than_a_wrong_one(middle: PreparedPair, kernels: Backend) -> None:
    source, target, truth = middle
    right = true_functional_map(source.basis, target.basis, truth.source_of_target, 40)
    wrong = right * np.where(np.arange(40) % 3 == 1, -1.0, 1.0)[:, None]
    assert relative_distortion(source, target, right, RULES, kernels) < 0.05
    assert relative_distortion(source, target, wrong, RULES, kernels) > 0.05


def test_distances_to_anchors_are_carried_along(middle: PreparedPair, kernels: Backend) -> None:
    """At matched vertices they are about the same, and elsewhere they are not."""
    source, target, truth = middle
    right = true_functional_map(source.basis, target.basis, truth.source_of_target, 40)
    x, y = anchored(source, target, right, RULES, kernels)
    assert x.given is not None
    assert y.given is not None
    assert x.given.values.shape == (source.mesh.n_vertices, y.given.values.shape[1])
    assert RULES.anchors.least <= x.given.values.shape[1] <= RULES.anchors.most
    assert x.given.weight == RULES.anchors.weight
    matched = np.square(x.given.values - y.given.values[truth.target_of_source]).sum(axis=1).mean()
    shuffled = np.random.default_rng(0).permutation(truth.target_of_source)
    elsewhere = np.square(x.given.values - y.given.values[shuffled]).sum(axis=1).mean()
    assert matched < 0.05 * elsewhere
    few = replace(RULES, anchors=AnchorRules(least=61))
    assert anchored(source, target, right, few, kernels) == (source, target)
    assert anchored(x, y, right, RULES, kernels) == (x, y)


def test_only_what_is_no_isometry_gets_them(middle: PreparedPair, kernels: Backend) -> None:
    stages = [stage for stage in STAGES if stage.name in ("search", "choice")]
    for distorted, expected in ((RULES.anchors.distorted, False), (0.0, True)):
        options = MIDDLE.replace({"rules.anchors.distorted": distorted})
        with np.errstate(all="ignore"):
            state = run_stages(MatchState(*middle[:2], options, 0.5), kernels, Clock(), stages)
        assert state.anchored
        assert (state.source.given is not None) is expected
