"""L-BFGS over a vector of variables, through nlopt, with its traps hidden."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import nlopt
import numpy as np
from numpy.typing import NDArray

LOG = logging.getLogger(__name__)

Status = Literal["converged", "noise floor", "budget", "interrupted", "failed"]
VECTOR_STORAGE = 50


@dataclass(frozen=True)
class Minimum:
    """The best point that was evaluated.

    Attributes
    ----------
    x : (n,) float64.
    value : objective there.
    evaluations : number of evaluations made.
    status : "converged" (tolerance reached), "noise floor" (no further descent possible at the objective's precision),
        "budget" (evaluations used up), "interrupted" (Ctrl-C), "failed" (no finite value was seen).
    """

    x: NDArray[np.float64]
    value: float
    evaluations: int
    status: Status


class _Recorder:
    """Calls the objective for nlopt and keeps the best point, which nlopt loses when it stops early."""

    def __init__(
        self, objective: Callable[[NDArray[np.float64]], tuple[float, NDArray[np.float64]]], start: NDArray[np.float64]
    ) -> None:
        self.objective = objective
        self.best = start.copy()
        self.value = np.inf
        self.evaluations = 0

    def __call__(self, x: NDArray[np.float64], gradient: NDArray[np.float64]) -> float:
        point = np.array(x, dtype=np.float64)
        value, slope = self.objective(point)
        self.evaluations += 1
        if gradient.size:
            gradient[:] = slope
        if value < self.value:
            self.value, self.best = float(value), point
        return float(value)


def minimise(
    objective: Callable[[NDArray[np.float64]], tuple[float, NDArray[np.float64]]],
    start: NDArray[np.float64],
    evaluations: int,
    relative_tolerance: float = 1e-5,
) -> Minimum:
    """Minimise a smooth function from `start` with limited-memory BFGS (nlopt ``LD_LBFGS``).

    Parameters
    ----------
    objective : x (n,) → value, gradient (n,).
    evaluations : budget; one line search may exceed it by a few.
    relative_tolerance : stop when a step lowers the value by less; values below 1e-5 make a single-precision
        objective end at its noise floor instead.

    Returns
    -------
    Minimum
        Ctrl-C keeps the best point so far. Any other exception of the objective is passed on.
    """
    recorder = _Recorder(objective, np.asarray(start, dtype=np.float64))
    if evaluations <= 0 or start.size == 0:
        value, _ = objective(recorder.best)
        return Minimum(recorder.best, float(value), 1, "budget")
    optimiser = nlopt.opt(nlopt.LD_LBFGS, start.size)
    optimiser.set_exceptions_enabled(False)
    optimiser.set_vector_storage(VECTOR_STORAGE)
    optimiser.set_min_objective(recorder)
    optimiser.set_maxeval(evaluations)
    optimiser.set_ftol_rel(relative_tolerance)
    try:
        optimiser.optimize(recorder.best)
        status = _status(optimiser.last_optimize_result(), recorder)
    except KeyboardInterrupt:
        status = "interrupted"
    LOG.debug("L-BFGS: %s after %d evaluations at %.6g", status, recorder.evaluations, recorder.value)
    return Minimum(recorder.best, recorder.value, recorder.evaluations, status)


def _status(code: int, recorder: _Recorder) -> Status:
    if not np.isfinite(recorder.value):
        return "failed"
    if code == nlopt.MAXEVAL_REACHED:
        return "budget"
    # After progress, nlopt's bare failure codes mean that no descent is left at the objective's precision.
    return "noise floor" if code < 0 else "converged"
