"""Orders and guesses: they save time, and change nothing that is found."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clalign.engine import Backend, Reference
from clalign.geometry.sampling import VertexOrder
from clalign.maps import nearest
from clalign.maps.inverted_file import nearest_in_cells
from clalign.maps.nearest import nearest_rows, permuted, point_maps
from clalign.maps.point_maps import PointMaps

Sides = tuple[NDArray[np.float64], NDArray[np.float64]]


@pytest.fixture(params=["reference", "device"])
def any_backend(request: pytest.FixtureRequest, kernels: Backend) -> Backend:
    return Reference() if request.param == "reference" else kernels


@pytest.fixture
def embedded(rng: np.random.Generator) -> Sides:
    """Of 700 and 433 points near each other in 90 dimensions."""
    target = rng.normal(size=(433, 90))
    return target[rng.integers(0, 433, size=700)] + 0.2 * rng.normal(size=(700, 90)), target


def test_orders_and_guesses_change_no_map(any_backend: Backend, embedded: Sides, rng: np.random.Generator) -> None:
    x, y = (any_backend.array(side) for side in embedded)
    expected = PointMaps(nearest_rows(*embedded), nearest_rows(*embedded[::-1]))
    orders = VertexOrder.of(rng.permutation(700)), VertexOrder.of(rng.permutation(433))
    wrong = PointMaps(rng.integers(0, 433, size=700), rng.integers(0, 700, size=433))
    for given in (None, orders):
        for guess in (None, expected, wrong):
            rows = (x, y) if given is None else (permuted(x, given[0], any_backend), permuted(y, given[1], any_backend))
            found = point_maps(*rows, given, guess, any_backend)
            np.testing.assert_array_equal(found.target_of_source, expected.target_of_source)
            np.testing.assert_array_equal(found.source_of_target, expected.source_of_target)


def test_guesses_that_are_looked_for_change_nothing(
    any_backend: Backend, embedded: Sides, monkeypatch: pytest.MonkeyPatch
) -> None:
    queries, points = (any_backend.array(side) for side in embedded)
    expected = nearest_rows(*embedded)
    monkeypatch.setattr(nearest, "WORTH_A_GUESS", 100)
    np.testing.assert_array_equal(nearest_rows(queries, points, backend=any_backend), expected)


def test_very_many_pairs_are_compared_among_cells_and_few_rows_with_all(
    embedded: Sides, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    exhaustive, searched = nearest_rows(*embedded), []

    def noted(*arguments: Any) -> NDArray[np.int64]:
        searched.append(arguments)
        return nearest_in_cells(*arguments)

    monkeypatch.setattr(nearest, "nearest_in_cells", noted)
    monkeypatch.setattr(nearest, "EXHAUSTIVE", 1000)
    np.testing.assert_array_equal(nearest_rows(*embedded), exhaustive)
    assert not searched
    monkeypatch.setattr(nearest, "FEW", 100)
    orders = VertexOrder.of(rng.permutation(700)), VertexOrder.of(rng.permutation(433))
    rows = (permuted(side, order) for side, order in zip(embedded, orders, strict=True))
    found = point_maps(*rows, orders)
    assert len(searched) == 2
    np.testing.assert_array_equal(found.target_of_source, exhaustive)
