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

Status = Literal["converged", "noise floor", "budget", "failed"]


@dataclass(frozen=True)
class Minimum:
    """The best point that was evaluated.

    Attributes
    ----------
    x : (n,) float64.
    value : objective there.
    evaluations : number of evaluations made.
    status : "converged" (tolerance reached), "noise floor" (no further descent possible at the objective's precision),
        "budget" (evaluations used up), "failed" (no finite value was seen).
    """

    x: NDArray[np.float64]
    value: float
    evaluations: int
    status: Status


class _Recorder:
    """Calls the objective for nlopt and keeps the best point, which nlopt loses when it stops early.

    What the objective raises is kept in `error`, and nlopt is asked to stop: an exception that crosses it is either
    left pending, so that any later line of Python fails, or tells nothing of how far nlopt had come.
    """

    def __init__(
        self,
        objective: Callable[[NDArray[np.float64]], tuple[float, NDArray[np.float64]]],
        start: NDArray[np.float64],
        stop: Callable[[], None],
    ) -> None:
        self.objective = objective
        self.best = start.copy()
        self.value = np.inf
        self.evaluations = 0
        self.error: BaseException | None = None
        self._stop: Callable[[], None] | None = stop

    def __call__(self, x: NDArray[np.float64], gradient: NDArray[np.float64]) -> float:
        if self.error is not None:
            return float("inf")
        try:
            return self._evaluate(np.array(x, dtype=np.float64), gradient)
        except BaseException as error:
            self.error = error
            if self._stop is not None:
                self._stop()
            return float("inf")

    def release(self) -> None:
        """Let go of the objective and of the optimiser.

        nlopt keeps its callback, and the callback knows the optimiser: a circle through C, which the collector cannot
        see and which would keep every problem that was ever solved in memory.
        """
        self.objective = _released
        self._stop = None

    def _evaluate(self, point: NDArray[np.float64], gradient: NDArray[np.float64]) -> float:
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
    relative_tolerance: float,
    memory: int,
) -> Minimum:
    """Minimise a smooth function from `start` with limited-memory BFGS (nlopt ``LD_LBFGS``).

    Parameters
    ----------
    objective : x (n,) → value, gradient (n,).
    evaluations : budget; one line search may exceed it by a few.
    relative_tolerance : stop when a step lowers the value by less; values below 1e-5 make a single-precision
        objective end at its noise floor instead.
    memory : steps that the approximation of the Hessian remembers.

    Whatever the objective raises is passed on.
    """
    begin = np.asarray(start, dtype=np.float64)
    if evaluations <= 0 or begin.size == 0:
        value, _ = objective(begin)
        return Minimum(begin.copy(), float(value), 1, "budget" if np.isfinite(value) else "failed")
    optimiser = nlopt.opt(nlopt.LD_LBFGS, begin.size)
    recorder = _Recorder(objective, begin, optimiser.force_stop)
    optimiser.set_exceptions_enabled(False)
    optimiser.set_vector_storage(max(1, min(memory, evaluations)))
    optimiser.set_min_objective(recorder)
    optimiser.set_maxeval(evaluations)
    optimiser.set_ftol_rel(relative_tolerance)
    try:
        optimiser.optimize(recorder.best)
    finally:
        recorder.release()
    if recorder.error is not None:
        raise recorder.error
    status = _status(optimiser.last_optimize_result(), recorder)
    LOG.debug("L-BFGS: %s after %d evaluations at %.6g", status, recorder.evaluations, recorder.value)
    return Minimum(recorder.best, recorder.value, recorder.evaluations, status)


def _released(point: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    raise RuntimeError("the optimisation has ended")


def _status(code: int, recorder: _Recorder) -> Status:
    if not np.isfinite(recorder.value):
        return "failed"
    if code == nlopt.MAXEVAL_REACHED:
        return "budget"
    # After progress, nlopt's bare failure codes mean that no descent is left at the objective's precision.
    return "noise floor" if code < 0 else "converged"
