"""The funnel of Eq. 25 and the vector of variables."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clalign.alignment.band import band_mask, funnel_band, funnel_widths
from clalign.engine.band import Band
from clalign.options import AlignmentOptions


def test_widths_by_hand() -> None:
    # ceil(1 / 2.5) + 2 = 3, ceil(3 / 2.5) + 2 = 4, ceil(5 / 2.5) + 2 = 4, ceil(6 / 2.5) + 2 = 5, ceil(352 / 2.5) + 2
    widths = funnel_widths(352, 2.5, 2)
    assert widths[[0, 1, 2, 4, 5, 351]].tolist() == [3, 3, 4, 4, 5, 143]


def test_half_and_full_width_by_hand() -> None:
    half = funnel_band(10, AlignmentOptions(band="half"))
    assert half.lower.tolist() == [0, 0, 0, 0, 0, 0, 1, 1, 2, 3]
    assert half.upper.tolist() == [4, 5, 7, 8, 9, 10, 10, 10, 10, 10]
    full = funnel_band(10, AlignmentOptions(band="full"))
    assert full.lower.tolist() == [0, 0, 0, 1, 2, 3, 4, 4, 5, 6]
    assert full.upper.tolist() == [2, 3, 5, 6, 7, 8, 9, 10, 10, 10]


def test_diagonal_and_dense() -> None:
    np.testing.assert_array_equal(band_mask(funnel_band(7, AlignmentOptions(band="diagonal"))), np.eye(7, dtype=bool))
    assert band_mask(funnel_band(7, AlignmentOptions(band="none"))).all()
    assert funnel_band(7, AlignmentOptions(band="none")).count == 49


def test_a_wider_reading_holds_the_narrower() -> None:
    masks = [band_mask(funnel_band(60, AlignmentOptions(band=band))) for band in ("diagonal", "full", "half", "none")]
    counts = [int(mask.sum()) for mask in masks]
    assert counts == sorted(set(counts))
    for narrow, wide in itertools.pairwise(masks):
        assert not (narrow & ~wide).any()


@settings(max_examples=60, deadline=None)
@given(
    count=st.integers(1, 40),
    slope=st.floats(0.05, 20),
    offset=st.integers(0, 6),
    band=st.sampled_from(["half", "full", "diagonal", "none"]),
)
def test_every_funnel_is_a_valid_band(count: int, slope: float, offset: int, band: Any) -> None:
    """Kernels skip tiles by the limits and rely on them: none decreases, every row holds its diagonal entry."""
    made = funnel_band(count, AlignmentOptions(band=band, band_slope=slope, band_offset=offset))
    checked = Band.from_limits(made.lower, made.upper)
    np.testing.assert_array_equal(made.offsets, checked.offsets)
    assert band_mask(made).diagonal().all()
    assert made.count == band_mask(made).sum()


@pytest.mark.parametrize("band", ["half", "full"])
@pytest.mark.parametrize("changes", [{"band_slope": 1e-20}, {"band_slope": 5e-324}, {"band_offset": 10**300}])
def test_funnel_wider_than_the_matrix_is_the_whole_matrix(band: Any, changes: dict[str, Any]) -> None:
    """Widths that no integer holds, infinite ones included: limits outside the matrix are writes outside a buffer."""
    made = funnel_band(9, AlignmentOptions(band=band, **changes))
    assert made.lower.tolist() == [0] * 9
    assert made.upper.tolist() == [9] * 9
    assert made.offsets.tolist() == list(range(0, 82, 9))


@pytest.mark.parametrize("band", ["half", "full", "diagonal", "none"])
def test_packing_is_the_adjoint_of_unpacking(
    bind_small: Callable[..., Any], rng: np.random.Generator, band: str
) -> None:
    problem = bind_small({"alignment.band": band}).problem
    matrix = rng.normal(size=(problem.band.size, problem.band.size))
    x = rng.normal(size=problem.band.count)
    np.testing.assert_array_equal(problem.pack(problem.unpack(x)), x)
    np.testing.assert_array_equal(problem.unpack(problem.pack(matrix)), matrix * band_mask(problem.band))
    assert problem.pack(matrix) @ x == pytest.approx(np.sum(matrix * problem.unpack(x)), rel=1e-12)
