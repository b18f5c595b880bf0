"""L-BFGS through nlopt: minima, and every way to end."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable

import numpy as np
import pytest
import scipy.optimize
from interrupted import masked_interrupt
from numpy.typing import NDArray

from clalign.alignment.lbfgs import minimise

Vector = NDArray[np.float64]
Objective = Callable[[Vector], tuple[float, Vector]]


def quadratic(size: int, rng: np.random.Generator) -> tuple[Objective, Vector]:
    """Return a convex quadratic of condition 100 and where it is least."""
    frame = np.linalg.qr(rng.normal(size=(size, size)))[0]
    matrix = frame @ np.diag(np.geomspace(1.0, 100.0, size)) @ frame.T
    centre = rng.normal(size=size)

    def objective(x: Vector) -> tuple[float, Vector]:
        slope = matrix @ (x - centre)
        return 0.5 * float(slope @ (x - centre)), slope

    return objective, centre


def rosenbrock(x: Vector) -> tuple[float, Vector]:
    return float(scipy.optimize.rosen(x)), scipy.optimize.rosen_der(x)


def test_quadratic(rng: np.random.Generator) -> None:
    objective, centre = quadratic(30, rng)
    found = minimise(objective, np.zeros(30), 500, relative_tolerance=1e-12, memory=50)
    np.testing.assert_allclose(found.x, centre, atol=1e-4)
    assert found.status == "converged"
    assert 1 < found.evaluations < 500


def test_rosenbrock() -> None:
    found = minimise(rosenbrock, np.full(10, -1.0), 2000, relative_tolerance=1e-14, memory=50)
    # There is a second, local minimum near (-1, 1, ..., 1); both have no slope.
    assert np.abs(rosenbrock(found.x)[1]).max() < 1e-3
    assert found.value < 4.0
    two = minimise(rosenbrock, np.array([-1.2, 1.0]), 2000, relative_tolerance=1e-14, memory=50)
    np.testing.assert_allclose(two.x, 1.0, atol=1e-4)


def test_agrees_with_scipy(rng: np.random.Generator) -> None:
    """A convex function with one minimum: two implementations of L-BFGS find the same."""
    matrix = rng.normal(size=(40, 25))
    shift = rng.normal(size=40)

    def objective(x: Vector) -> tuple[float, Vector]:
        residual = matrix @ x - shift
        return float(np.sum(np.log(np.cosh(residual)) + 0.5 * residual**2)), matrix.T @ (np.tanh(residual) + residual)

    ours = minimise(objective, np.zeros(25), 1000, relative_tolerance=1e-14, memory=50)
    theirs = scipy.optimize.minimize(objective, np.zeros(25), jac=True, method="L-BFGS-B", options={"ftol": 1e-14})
    assert ours.value == pytest.approx(theirs.fun, rel=1e-9)
    np.testing.assert_allclose(ours.x, theirs.x, atol=1e-4)


@pytest.mark.parametrize("tolerance", [1e-5, 1e-12])
def test_single_precision_ends_near_the_minimum(rng: np.random.Generator, tolerance: float) -> None:
    """A value that is rounded to float32 has no slope to follow at its noise floor; that is no failure."""
    exact, _ = quadratic(30, rng)

    def rounded(x: Vector) -> tuple[float, Vector]:
        value, slope = exact(x.astype(np.float32).astype(np.float64))
        return float(np.float32(value + 10.0)), slope.astype(np.float32).astype(np.float64)

    found = minimise(rounded, np.zeros(30), 2000, relative_tolerance=tolerance, memory=50)
    assert found.status in ("converged", "noise floor")
    assert exact(found.x)[0] < 1e-3
    assert found.evaluations < 2000


@pytest.mark.parametrize("budget", [3, 7, 20, 30])
def test_the_best_point_is_kept_when_the_budget_ends(budget: int) -> None:
    """A line search that has begun is ended, so the budget may be exceeded by a few evaluations."""
    seen: list[tuple[float, Vector]] = []

    def watched(x: Vector) -> tuple[float, Vector]:
        value, slope = rosenbrock(x)
        seen.append((value, x.copy()))
        return value, slope

    found = minimise(watched, np.array([-1.2, 1.0, -0.5, 2.0]), budget, relative_tolerance=1e-14, memory=50)
    assert found.status == "budget"
    assert budget <= found.evaluations == len(seen) <= budget + 5
    value, point = min(seen, key=lambda entry: entry[0])
    assert found.value == value
    np.testing.assert_array_equal(found.x, point)


@pytest.mark.parametrize(("size", "evaluations"), [(4, 0), (0, 10)])
def test_nothing_to_do(size: int, evaluations: int) -> None:
    found = minimise(
        lambda x: (float(np.sum(x**2)), 2 * x), np.ones(size), evaluations, relative_tolerance=1e-5, memory=50
    )
    np.testing.assert_array_equal(found.x, np.ones(size))
    assert (found.value, found.evaluations, found.status) == (float(size), 1, "budget")


def test_an_objective_without_finite_values_fails() -> None:
    found = minimise(
        lambda x: (float("nan"), np.full_like(x, np.nan)), np.ones(3), 50, relative_tolerance=1e-5, memory=50
    )
    assert found.status == "failed"
    np.testing.assert_array_equal(found.x, np.ones(3))


def test_a_region_without_values_does_not_lose_the_best_point() -> None:
    """NaN beyond a wall: what was found before it is kept."""

    def walled(x: Vector) -> tuple[float, Vector]:
        if x[0] < 0.5:
            return float("nan"), np.full_like(x, np.nan)
        return float(x @ x), 2 * x

    found = minimise(walled, np.full(2, 3.0), 50, relative_tolerance=1e-5, memory=50)
    assert np.isfinite(found.value)
    assert found.value <= 18.0
    assert found.value == pytest.approx(float(found.x @ found.x))


@pytest.mark.parametrize("error", [KeyboardInterrupt(), masked_interrupt()], ids=["plain", "masked"])
@pytest.mark.parametrize("number", [4, 21])
def test_an_interrupt_is_passed_on_at_once(number: int, error: BaseException) -> None:
    """Whatever nlopt makes of an exception in its callback, the caller sees the one that was raised, and only it."""
    values: list[float] = []

    def interrupted(x: Vector) -> tuple[float, Vector]:
        if len(values) == number:
            raise error
        values.append(rosenbrock(x)[0])
        return rosenbrock(x)

    with pytest.raises(type(error)) as raised:
        minimise(interrupted, np.array([-1.2, 1.0, -0.5, 2.0]), 500, relative_tolerance=1e-14, memory=50)
    assert raised.value is error
    assert len(values) == number


def test_errors_of_the_objective_are_passed_on() -> None:
    def broken(x: Vector) -> tuple[float, Vector]:
        raise RuntimeError("the device is gone")

    with pytest.raises(RuntimeError, match="the device is gone"):
        minimise(broken, np.ones(3), 50, relative_tolerance=1e-5, memory=50)


def test_the_start_is_not_written_to(rng: np.random.Generator) -> None:
    objective, _ = quadratic(5, rng)
    start = np.zeros(5)
    minimise(objective, start, 50, relative_tolerance=1e-5, memory=50)
    np.testing.assert_array_equal(start, 0.0)


def test_the_objective_can_be_collected_afterwards() -> None:
    """nlopt keeps its callback for ever; what the callback held must not stay with it."""

    class Problem:
        def value(self, x: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
            return float(x @ x), 2.0 * x

    problem = Problem()
    alive = weakref.ref(problem)
    assert minimise(problem.value, np.ones(3), 20, relative_tolerance=1e-5, memory=50).value < 1e-12
    del problem
    gc.collect()
    assert alive() is None
