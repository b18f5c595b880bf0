"""The table of confidences: which maps are right, which pairs have several answers, which wrong ones are silent."""

from __future__ import annotations

import numpy as np
import pytest

from clalign.benchmark.confidence import BODIES, SYMMETRIC, SymmetricPair, confidence_table, verdicts
from clalign.benchmark.records import Record


def record(suite: str, pair: str, q90: float, confidence: float | None, flipped: bool = False) -> Record:
    return Record(suite, pair, "default", "", "ok", q90=q90, confidence=confidence, flipped=flipped, orientation=0.9)


RECORDS = [
    record("people", "a b", 0.05, 0.8),
    record("people", "a c", 0.05, 0.2),
    record("people", "a d", 0.6, 0.1),
    record("people", "a e", 0.05, 0.8, flipped=True),
    record("people", "a f", 0.05, None),
    record(SYMMETRIC, "wheel", 0.5, 0.0),
    record(SYMMETRIC, "cross", 0.05, 1.0),
]


def test_pairs_are_counted_by_their_confidence() -> None:
    rows = [line.strip("| ").split(" | ") for line in confidence_table(RECORDS).splitlines()[2:]]
    assert rows == [
        ["0 to 0.15", "2", "0", "1", "1", "0%"],
        ["0.15 to 0.3", "1", "1", "0", "0", "100%"],
        ["0.3 to 0.5", "0", "0", "0", "0", "–"],
        ["0.5 to 0.7", "0", "0", "0", "0", "–"],
        ["0.7 to 0.9", "2", "1", "1", "0", "50%"],
        ["0.9 to 1", "1", "0", "0", "1", "–"],
    ]


def test_wrong_and_ambiguous_pairs_that_are_not_doubted_are_named() -> None:
    first, *others = verdicts(RECORDS)
    assert first == "1 of 2 right pairs have a confidence above 0.5"
    assert [each.partition(":")[0] for each in others] == ["people, a e", "symmetric, cross"]
    assert "wrong with confidence 0.80" in others[0]
    assert "ambiguous with confidence 1.00" in others[1]


@pytest.mark.parametrize("body", BODIES)
def test_the_bodies_have_turns_to_themselves(body: str) -> None:
    """A half-turn of the ellipsoid, a third of the propeller's: every image of a point is on the surface again."""
    angle = np.pi if body == "ellipsoid" else 2 * np.pi / 3
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    directions = np.random.default_rng(0).normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    np.testing.assert_allclose(BODIES[body](directions @ turn.T), BODIES[body](directions) @ turn.T, atol=1e-12)


def test_a_symmetric_pair_is_meshed_twice_or_renumbered() -> None:
    for exact in (True, False):
        pair = SymmetricPair("propeller", exact).load()
        assert pair.name == ("propeller exact" if exact else "propeller remeshed")
        apart = pair.target.vertices[pair.truth.target_points] - pair.source.vertices
        assert bool(np.linalg.norm(apart, axis=1).max() < 1e-12) is exact
        assert np.linalg.norm(apart, axis=1).mean() < 0.05
        corners = pair.target.vertices[pair.target.faces]
        assert np.linalg.det(corners).sum() > 0
