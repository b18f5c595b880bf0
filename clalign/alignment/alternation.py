"""The alternation of the paper, made smooth: outer iterations of L-BFGS with the hard map fixed inside each.

Inside an outer iteration the hard map, the denominator of l_align and λ are fixed, so that value and gradient agree and
L-BFGS works; between them they are renewed. λ falls by a factor each time: l_unsup is not least at the true map, since
the soft map is soft, and a large λ drags a good map away from it. An iteration that does not lower the renewed
objective ends the run and is undone.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from clalign.alignment.lbfgs import Status, minimise
from clalign.alignment.losses import FixedCorrespondence
from clalign.alignment.objective import Evaluation, Objective
from clalign.alignment.readout import hard_map, read_out
from clalign.maps.point_maps import PointMaps
from clalign.options import Readout

LOG = logging.getLogger(__name__)

Watch = Callable[[int, Evaluation], None]
AlignmentStatus = Status | Literal["not run"]


@dataclass(frozen=True)
class AlignmentState:
    """What an outer iteration begins with.

    Attributes
    ----------
    rotation : (d, d) R, zero outside the funnel.
    fixed : the correspondence of R, and λ.
    history : for every evaluation "outer_iteration", "evaluation", "total" and each term.
    status : why the last iteration ended; "not run" before there was one.
    ended : there is no other iteration.
    candidate : (d, d) the best point of an iteration that an exception has ended; None otherwise.
    """

    rotation: NDArray[np.float64]
    fixed: FixedCorrespondence
    history: tuple[dict[str, float], ...] = ()
    status: AlignmentStatus = "not run"
    ended: bool = False
    candidate: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class AlignedRotation:
    """The outcome of the optimisation.

    Attributes
    ----------
    rotation : (d, d) R, zero outside the funnel.
    maps : point maps read out from it.
    history : see `AlignmentState`.
    losses : terms at the result, with its own hard map.
    status : why it ended.
    """

    rotation: NDArray[np.float64]
    maps: PointMaps
    history: tuple[dict[str, float], ...]
    losses: dict[str, float]
    status: AlignmentStatus


def outer_iterations(
    objective: Objective,
    start: NDArray[np.float64],
    readout: Readout,
    watch: Watch | None = None,
    guess: PointMaps | None = None,
) -> Iterator[AlignmentState]:
    """Minimise the objective over the band entries of R; yields the start and the state after every outer iteration.

    An exception inside an iteration is raised after the best point so far has been yielded as `candidate`.

    Parameters
    ----------
    start : (d, d), restricted to the funnel.
    watch : called after every evaluation with the number of the iteration.
    guess : maps near those of `start`, which save time and do not change the result.
    """
    options = objective.options
    known = None if guess is None else guess.target_of_source
    state = AlignmentState(start, objective.fix(start, hard_map(objective, start, readout, known), options.weight))
    yield state
    for number in range(options.outer_iterations):
        for reached in _outer_iteration(objective, state, readout, number, watch):
            yield reached
        state = reached
        if state.ended:
            return
        if number + 1 < options.outer_iterations:
            state = replace(state, fixed=replace(state.fixed, weight=state.fixed.weight * options.decay))


def _outer_iteration(
    objective: Objective, state: AlignmentState, readout: Readout, number: int, watch: Watch | None
) -> Iterator[AlignmentState]:
    start, fixed, history = objective.pack(state.rotation), state.fixed, list(state.history)
    before = objective.value_and_gradient(start, fixed)
    least, best = before.total, start

    def evaluate(x: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        nonlocal least, best
        # L-BFGS begins at the point that is known already.
        found = before if np.array_equal(x, start) else objective.value_and_gradient(x, fixed)
        history.append({"outer_iteration": number, "evaluation": len(history), "total": found.total, **found.terms})
        if found.total < least:
            least, best = found.total, x
        if watch is not None:
            watch(number, found)
        return found.total, found.gradient

    options = objective.options
    try:
        minimum = minimise(evaluate, start, options.iterations, options.tolerance, objective.rules.memory)
    except BaseException:
        yield replace(state, history=tuple(history), candidate=objective.unpack(best))
        raise
    state = replace(state, history=tuple(history))
    yield _compared(objective, state, objective.unpack(minimum.x), before.total, readout, minimum.status)


def _compared(
    objective: Objective,
    state: AlignmentState,
    rotation: NDArray[np.float64],
    before: float,
    readout: Readout,
    status: Status,
) -> AlignmentState:
    """Return the state at `rotation` with its own hard map if that lowers the objective, else the same one, ended."""
    guess, weight = state.fixed.target_of_source, state.fixed.weight
    renewed = objective.fix(rotation, hard_map(objective, rotation, readout, guess), weight)
    after = objective.value_and_gradient(objective.pack(rotation), renewed).total
    LOG.info("outer iteration: %.6g -> %.6g (%s)", before, after, status)
    if not after < before:
        return replace(state, status="failed" if status == "failed" else "converged", ended=True, candidate=None)
    return AlignmentState(rotation, renewed, state.history, status, status == "failed")


def finished(
    objective: Objective, state: AlignmentState, readout: Readout, guess: PointMaps | None = None
) -> AlignedRotation:
    """Return the outcome of a state: its losses and its maps; `guess` saves time."""
    if state.candidate is not None and state.history:
        number = state.history[-1]["outer_iteration"]
        before = next(entry["total"] for entry in state.history if entry["outer_iteration"] == number)
        state = _compared(objective, state, state.candidate, before, readout, "budget")
    last = objective.value_and_gradient(objective.pack(state.rotation), state.fixed)
    maps = read_out(objective, state.rotation, readout, state.fixed.target_of_source, guess)
    return AlignedRotation(state.rotation, maps, state.history, {"total": last.total, **last.terms}, state.status)
