"""The alternation of the paper, made smooth: L-BFGS rounds with the hard map frozen inside a round."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.alignment.lbfgs import Status, minimise
from clalign.alignment.objective import AlignmentProblem, Evaluation, Round
from clalign.ctrl_c import plain_interrupts
from clalign.maps.functional_maps import PointMaps, argmax_map, both_directions, matched, nearest_rows
from clalign.maps.nearest import in_order
from clalign.options import Readout

LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class AlignedRotation:
    """The outcome of the optimisation.

    Attributes
    ----------
    rotation : (d, d) R, zero outside the funnel.
    maps : point maps read out from it.
    history : for every evaluation "round", "evaluation", "total" and each term.
    losses : terms at the result, with its own hard map.
    status : why it ended.
    """

    rotation: NDArray[np.float64]
    maps: PointMaps
    history: tuple[dict[str, float], ...]
    losses: dict[str, float]
    status: Status


def hard_map(
    problem: AlignmentProblem,
    rotation: NDArray[np.float64],
    readout: Readout,
    guess: NDArray[np.int64] | None = None,
) -> NDArray[np.int64]:
    """Return target_of_source (n_x,) of R: nearest neighbours ("aligned", "functional") or Eq. 28 ("argmax").

    A map that is nearly right, as `guess`, saves time and does not change the result.
    """
    source, target, backend = problem.source, problem.target, problem.backend
    if readout == "aligned":
        turned = _in_order(problem, rotation)
        return matched(backend, *turned, problem.orders, guess)
    functional = problem.functional_map(rotation)
    if readout == "functional":
        return nearest_rows(backend, source.basis, target.basis @ functional)
    return argmax_map(backend, functional, source.basis, target.basis, target.soft_weights)


def _in_order(problem: AlignmentProblem, rotation: NDArray[np.float64]) -> tuple[Any, Any]:
    """Return the embeddings of R with their rows in the orders of the problem."""
    source, target = problem.embeddings(rotation)
    return in_order(problem.backend, source, problem.orders[0]), in_order(problem.backend, target, problem.orders[1])


def read_out(
    problem: AlignmentProblem,
    rotation: NDArray[np.float64],
    readout: Readout,
    target_of_source: NDArray[np.int64] | None = None,
    guess: PointMaps | None = None,
) -> PointMaps:
    """Return both maps of R; `target_of_source` is taken as it is where it is known already, `guess` saves time.

    The reverse of Eq. 28, which the paper does not define, is the nearest neighbour in functional-map space.
    """
    source, target, backend = problem.source, problem.target, problem.backend
    forward, (guess_there, guess_back) = target_of_source, both_directions(guess)
    if forward is None:
        forward = hard_map(problem, rotation, readout, guess_there)
    if readout == "aligned":
        turned = _in_order(problem, rotation)
        return PointMaps(forward, matched(backend, *turned[::-1], problem.orders[::-1], guess_back))
    pulled = target.basis @ problem.functional_map(rotation)
    return PointMaps(forward, nearest_rows(backend, pulled, source.basis))


def optimise_rotation(
    problem: AlignmentProblem,
    start: NDArray[np.float64],
    readout: Readout,
    progress: Callable[[int, Evaluation], None] | None = None,
    guess: PointMaps | None = None,
) -> AlignedRotation:
    """Minimise the objective over the band entries of R in rounds.

    Inside a round the hard map, the denominator of l_align and λ are frozen, so that value and gradient agree and
    L-BFGS works; between rounds they are refreshed. λ falls by the factor `decay` a round: l_unsup is not least at the
    true map, since the soft map is soft, and a large λ drags a good map away from it. A round that does not lower the
    refreshed objective ends the run and is undone.

    Parameters
    ----------
    start : (d, d), restricted to the funnel.
    progress : called after every evaluation with the round.
    guess : maps near those of `start`, which save time and do not change the result.
    """
    options = problem.options
    rotation = start
    frozen = problem.start_round(start, hard_map(problem, start, readout, both_directions(guess)[0]), options.weight)
    history: list[dict[str, float]] = []
    status: Status = "budget"
    for number in range(options.rounds):
        try:
            ended = _round(problem, rotation, frozen, readout, _recorded(number, history, progress))
        except KeyboardInterrupt:
            # Between the evaluations of a round nothing better is at hand than the round before.
            status = "interrupted"
            break
        LOG.info("round %d: %.6g -> %.6g (%s)", number, ended.before, ended.after, ended.status)
        status = ended.status
        if not ended.after < ended.before:
            status = status if status in ("interrupted", "failed") else "converged"
            break
        rotation, frozen = ended.rotation, ended.frozen
        if status in ("interrupted", "failed"):
            break
        if number + 1 < options.rounds:
            frozen = replace(frozen, weight=frozen.weight * options.decay)

    @plain_interrupts()
    def finished() -> AlignedRotation:
        last = problem.value_and_gradient(problem.pack(rotation), frozen)
        maps = read_out(problem, rotation, readout, frozen.target_of_source, guess)
        return AlignedRotation(rotation, maps, tuple(history), {"total": last.total, **last.terms}, status)

    try:
        return finished()
    except KeyboardInterrupt:
        # It is short, and without it the rounds would be lost.
        return replace(finished(), status="interrupted")


@dataclass(frozen=True)
class _Ended:
    """What a round came to: R, what it froze for the next, and the objective before and after with its own hard map."""

    rotation: NDArray[np.float64]
    frozen: Round
    before: float
    after: float
    status: Status


@plain_interrupts()
def _round(
    problem: AlignmentProblem,
    rotation: NDArray[np.float64],
    frozen: Round,
    readout: Readout,
    record: Callable[[Evaluation], None],
) -> _Ended:
    start = problem.pack(rotation)
    before = problem.value_and_gradient(start, frozen)

    def objective(x: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        # L-BFGS begins at the point that is known already.
        evaluation = before if np.array_equal(x, start) else problem.value_and_gradient(x, frozen)
        record(evaluation)
        return evaluation.total, evaluation.gradient

    options = problem.options
    minimum = minimise(objective, start, options.iterations, options.tolerance)
    candidate = problem.unpack(minimum.x)
    map_there = hard_map(problem, candidate, readout, frozen.target_of_source)
    refreshed = problem.start_round(candidate, map_there, frozen.weight)
    after = problem.value_and_gradient(problem.pack(candidate), refreshed)
    return _Ended(candidate, refreshed, before.total, after.total, minimum.status)


def _recorded(
    number: int, history: list[dict[str, float]], progress: Callable[[int, Evaluation], None] | None
) -> Callable[[Evaluation], None]:
    def record(evaluation: Evaluation) -> None:
        history.append({"round": number, "evaluation": len(history), "total": evaluation.total, **evaluation.terms})
        if progress is not None:
            progress(number, evaluation)

    return record
