"""Outer iterations of L-BFGS between renewed hard maps."""

from __future__ import annotations

from collections.abc import Callable
from itertools import groupby
from typing import Any

import numpy as np
import pytest
from prepared import Bound

from clalign.alignment.alternation import AlignedRotation, AlignmentState, finished, outer_iterations
from clalign.alignment.objective import Evaluation, Objective
from clalign.alignment.readout import read_out

ROUNDS = {"alignment.outer_iterations": 4, "alignment.iterations": 12, "alignment.decay": 1.0}


def objective(problem: Objective, rotation: Any, readout: Any = "aligned") -> float:
    """Return the objective of R with its own hard map, at the first round's weight."""
    fixed = problem.fix(rotation, read_out(problem, rotation, readout).target_of_source, problem.options.weight)
    return problem.value_and_gradient(problem.pack(rotation), fixed).total


def optimised_rotation(problem: Objective, start: Any, readout: Any) -> AlignedRotation:
    """Run all outer iterations."""
    *_, state = outer_iterations(problem, start, readout)
    return finished(problem, state, readout)


@pytest.mark.parametrize(
    "changes",
    [{}, {"alignment.cycle": True}, {"alignment.sides": "one"}, {"alignment.denominator": "fixed"}],
    ids=["plain", "cycle", "one-sided", "fixed"],
)
def test_no_round_ends_above_its_start(
    bind_small: Callable[..., Bound], rng: np.random.Generator, changes: dict[str, Any]
) -> None:
    problem, rotation, _ = bind_small({**ROUNDS, **changes})
    start = problem.unpack(problem.pack(rotation) + 0.03 * rng.normal(size=problem.band.count))
    found = optimised_rotation(problem, start, "aligned")
    assert found.losses["total"] < objective(problem, start)
    assert objective(problem, found.rotation) == pytest.approx(found.losses["total"], rel=1e-9)
    totals = {
        number: [entry["total"] for entry in entries]
        for number, entries in groupby(found.history, key=lambda entry: entry["outer_iteration"])
    }
    assert list(totals) == list(range(len(totals)))
    assert all(min(values) <= values[0] for values in totals.values())
    # Each round starts where the one before it ended, and that is lower.
    firsts = [values[0] for values in totals.values()]
    assert firsts == sorted(firsts, reverse=True)
    assert [entry["evaluation"] for entry in found.history] == list(range(len(found.history)))


@pytest.mark.parametrize("sides", ["both", "one"])
def test_embeddings_on_the_backend_are_those_of_the_host(bind_small: Callable[..., Bound], sides: str) -> None:
    problem, rotation, _ = bind_small({"alignment.sides": sides})
    inside = problem.unpack(problem.pack(rotation))
    source, target = problem.source.scale_invariant, problem.target.scale_invariant
    on_host = source @ inside, target if sides == "one" else target @ inside.T
    for made, expected in zip(problem.embeddings(inside), on_host, strict=True):
        np.testing.assert_allclose(problem.backend.numpy(made), expected, rtol=0, atol=1e-5 * np.abs(expected).max())


def test_no_point_of_a_round_is_evaluated_twice(
    bind_small: Callable[..., Bound], monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, rotation, _ = bind_small({**ROUNDS, "alignment.outer_iterations": 1})
    plain, seen = problem.value_and_gradient, []

    def counted(x: Any, fixed: Any) -> Evaluation:
        seen.append((x.copy(), fixed))
        return plain(x, fixed)

    monkeypatch.setattr(problem, "value_and_gradient", counted)
    found = optimised_rotation(problem, rotation, "aligned")
    at_start = [x for x, fixed in seen if fixed is seen[0][1] and np.array_equal(x, seen[0][0])]
    assert len(at_start) == 1
    # The start is in the history all the same; the refreshed end of the round and the result are not.
    assert len(seen) == len(found.history) + 2


def test_the_map_is_that_of_the_rotation(bind_small: Callable[..., Bound]) -> None:
    problem, rotation, _ = bind_small(ROUNDS)
    for readout in ("aligned", "argmax"):
        found = optimised_rotation(problem, rotation, readout)
        expected = read_out(problem, found.rotation, readout)
        np.testing.assert_array_equal(found.maps.target_of_source, expected.target_of_source)
        np.testing.assert_array_equal(found.maps.source_of_target, expected.source_of_target)


def test_a_round_that_gains_nothing_is_undone(
    bind_small: Callable[..., Bound], rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each refreshed hard map makes the objective worse by more than a round can gain."""
    problem, rotation, _ = bind_small(ROUNDS)
    plain_start, plain_value = problem.fix, problem.value_and_gradient
    refreshed: list[Any] = []

    def fix(*arguments: Any) -> Any:
        refreshed.append(plain_start(*arguments))
        return refreshed[-1]

    def penalised(x: Any, fixed: Any) -> Evaluation:
        evaluation = plain_value(x, fixed)
        penalty = 100.0 * next(number for number, made in enumerate(refreshed) if made.gram_cross is fixed.gram_cross)
        return Evaluation(evaluation.total + penalty, evaluation.terms, evaluation.gradient)

    monkeypatch.setattr(problem, "fix", fix)
    monkeypatch.setattr(problem, "value_and_gradient", penalised)
    start = problem.unpack(problem.pack(rotation) + 0.03 * rng.normal(size=problem.band.count))
    found = optimised_rotation(problem, start, "aligned")
    np.testing.assert_array_equal(found.rotation, start)
    assert found.status == "converged"
    assert {entry["outer_iteration"] for entry in found.history} == {0}
    # The round itself did go down.
    assert found.history[-1]["total"] < found.history[0]["total"]


def test_weight_falls_from_round_to_round(bind_small: Callable[..., Bound], rng: np.random.Generator) -> None:
    problem, rotation, _ = bind_small({**ROUNDS, "alignment.decay": 0.1, "alignment.unitarity": 0.0})
    start = problem.unpack(problem.pack(rotation) + 0.03 * rng.normal(size=problem.band.count))
    found = optimised_rotation(problem, start, "aligned")
    weights = {}
    for entry in found.history:
        weights[entry["outer_iteration"]] = (entry["total"] - entry["align"]) / entry["unsup"]
    assert len(weights) > 1
    for number, weight in weights.items():
        assert weight == pytest.approx(200.0 * 0.1**number, rel=1e-6)


@pytest.mark.parametrize(
    "changes", [{"alignment.outer_iterations": 0}, {"alignment.iterations": 0}], ids=["rounds", "iterations"]
)
def test_without_optimisation_the_start_stays(bind_small: Callable[..., Bound], changes: dict[str, Any]) -> None:
    problem, rotation, _ = bind_small({**ROUNDS, **changes})
    found = optimised_rotation(problem, rotation, "aligned")
    np.testing.assert_array_equal(found.rotation, rotation)
    assert found.losses["total"] == pytest.approx(objective(problem, rotation), rel=1e-12)


@pytest.mark.parametrize("error", [KeyboardInterrupt(), RuntimeError("the device is gone")], ids=["Ctrl-C", "error"])
@pytest.mark.parametrize("after", [9, 14, 15])
def test_the_best_point_is_handed_over_before_an_exception(
    bind_small: Callable[..., Bound], rng: np.random.Generator, error: BaseException, after: int
) -> None:
    problem, rotation, _ = bind_small(ROUNDS)
    start = problem.unpack(problem.pack(rotation) + 0.03 * rng.normal(size=problem.band.count))
    totals: list[float] = []

    def stop(number: int, evaluation: Evaluation) -> None:
        totals.append(evaluation.total)
        if len(totals) == after:
            raise error

    states: list[AlignmentState] = []
    with pytest.raises(type(error)):
        states.extend(outer_iterations(problem, start, "aligned", stop))
    np.testing.assert_array_equal(states[0].rotation, start)
    assert states[-1].candidate is not None
    assert [entry["total"] for entry in states[-1].history] == totals
    last = [
        entry["total"]
        for entry in states[-1].history
        if entry["outer_iteration"] == states[-1].history[-1]["outer_iteration"]
    ]
    best = problem.value_and_gradient(problem.pack(states[-1].candidate), states[-1].fixed).total
    assert best == pytest.approx(min(last), rel=1e-12)
    # The 14th evaluation overshoots: the best point is not the last one, but where the outer iteration started.
    assert (last[-1] > min(last)) == (after == 14)
    kept = finished(problem, states[-1], "aligned")
    assert kept.losses["total"] < totals[0]
    assert np.array_equal(kept.rotation, states[-1].rotation) == (after == 14)


def test_an_objective_that_is_never_finite_keeps_the_start(
    bind_small: Callable[..., Bound], monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, rotation, _ = bind_small(ROUNDS)
    plain = problem.value_and_gradient

    def broken(x: Any, fixed: Any) -> Evaluation:
        evaluation = plain(x, fixed)
        return Evaluation(float("nan"), evaluation.terms, np.full_like(evaluation.gradient, np.nan))

    monkeypatch.setattr(problem, "value_and_gradient", broken)
    found = optimised_rotation(problem, rotation, "aligned")
    np.testing.assert_array_equal(found.rotation, rotation)
    assert found.status == "failed"


def test_the_loss_of_the_result_has_the_weight_of_the_last_round(bind_small: Callable[..., Bound]) -> None:
    """As the last points of the history, which a page draws beside it."""
    problem, rotation, _ = bind_small({**ROUNDS, "alignment.outer_iterations": 1, "alignment.weight": 70.0})
    found = optimised_rotation(problem, rotation, "aligned")
    losses = found.losses
    total = losses["align"] + 70.0 * losses["unsup"] + problem.options.unitarity * losses["unitarity"]
    assert losses["total"] == pytest.approx(total, rel=1e-9)
