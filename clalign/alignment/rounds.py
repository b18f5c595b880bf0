"""The alternation of the paper, made smooth: L-BFGS rounds with the hard map frozen inside a round."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clalign.alignment.maps import PointMaps, argmax_map, functional_point_maps, point_maps
from clalign.alignment.optimise import Status, minimise
from clalign.alignment.problem import AlignmentProblem, Evaluation
from clalign.alignment.views import AlignedSide
from clalign.engine.backend import Backend
from clalign.options import AlignmentOptions, Readout

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


def read_out(problem: AlignmentProblem, rotation: NDArray[np.float64], readout: Readout) -> PointMaps:
    """Return the point maps of R: "aligned", "functional" (nearest neighbours) or "argmax" (Eq. 28)."""
    source, target, backend = problem.source, problem.target, problem.backend
    if readout == "aligned":
        return aligned_maps(source, target, backend, rotation, problem.options)
    functional = problem.functional_map(rotation)
    maps = functional_point_maps(backend, functional, source.basis, target.basis)
    if readout == "functional":
        return maps
    chosen = argmax_map(backend, functional, source.basis, target.basis, target.soft_weights)
    return PointMaps(chosen, maps.source_of_target)


def aligned_maps(
    source: AlignedSide,
    target: AlignedSide,
    backend: Backend,
    rotation: NDArray[np.float64],
    options: AlignmentOptions,
) -> PointMaps:
    """Return nearest neighbours between Φ̃ R and Ψ̃ Rᵀ (one-sided: Φ̃ C̃ and Ψ̃)."""
    if options.sides == "one":
        return point_maps(backend, source.descriptors @ rotation, target.descriptors)
    return point_maps(backend, source.descriptors @ rotation, target.descriptors @ rotation.T)


def optimise_rotation(
    problem: AlignmentProblem,
    start: NDArray[np.float64],
    readout: Readout,
    progress: Callable[[int, Evaluation], None] | None = None,
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
    """
    options = problem.options
    rotation, maps = start, read_out(problem, start, readout)
    history: list[dict[str, float]] = []
    status: Status = "budget"
    weight = options.weight
    for number in range(options.rounds):
        try:
            ended = _round(problem, rotation, maps, weight, readout, _recorded(number, history, progress))
        except KeyboardInterrupt:
            # Between the evaluations of a round nothing better is at hand than the round before.
            status = "interrupted"
            break
        LOG.info("round %d: %.6g -> %.6g (%s)", number, ended.before, ended.after, ended.status)
        status = ended.status
        if not ended.after < ended.before:
            status = "interrupted" if status == "interrupted" else "converged"
            break
        rotation, maps = ended.rotation, ended.maps
        if status in ("interrupted", "failed"):
            break
        weight *= options.decay
    final = problem.start_round(rotation, maps.target_of_source, weight)
    last = problem.value_and_gradient(problem.pack(rotation), final)
    return AlignedRotation(rotation, maps, tuple(history), {"total": last.total, **last.terms}, status)


@dataclass(frozen=True)
class _Ended:
    """What a round came to: R and its maps, and the objective before and after it, each with its own hard map."""

    rotation: NDArray[np.float64]
    maps: PointMaps
    before: float
    after: float
    status: Status


def _round(
    problem: AlignmentProblem,
    rotation: NDArray[np.float64],
    maps: PointMaps,
    weight: float,
    readout: Readout,
    record: Callable[[Evaluation], None],
) -> _Ended:
    frozen = problem.start_round(rotation, maps.target_of_source, weight)
    before = problem.value_and_gradient(problem.pack(rotation), frozen)

    def objective(x: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        evaluation = problem.value_and_gradient(x, frozen)
        record(evaluation)
        return evaluation.total, evaluation.gradient

    options = problem.options
    minimum = minimise(objective, problem.pack(rotation), options.iterations, options.tolerance)
    candidate = problem.unpack(minimum.x)
    candidate_maps = read_out(problem, candidate, readout)
    refreshed = problem.start_round(candidate, candidate_maps.target_of_source, weight)
    after = problem.value_and_gradient(problem.pack(candidate), refreshed)
    return _Ended(candidate, candidate_maps, before.total, after.total, minimum.status)


def _recorded(
    number: int, history: list[dict[str, float]], progress: Callable[[int, Evaluation], None] | None
) -> Callable[[Evaluation], None]:
    def record(evaluation: Evaluation) -> None:
        history.append({"round": number, "evaluation": len(history), "total": evaluation.total, **evaluation.terms})
        if progress is not None:
            progress(number, evaluation)

    return record
