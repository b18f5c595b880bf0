"""Banded matrices: packing, and products that skip what is zero."""

from __future__ import annotations

import numpy as np
import pytest

from clalign.engine.backend import Band
from clalign.engine.kernels import Kernels
from clalign.engine.kernels_products import panel_ranges
from clalign.engine.reference import Reference
from clalign.errors import InputError


def funnel(size: int, slope: float = 2.5, offset: int = 2) -> Band:
    rows = np.arange(size)
    width = np.ceil((rows + 1) / slope).astype(int) + offset
    low, high = rows - width, rows + width + 1
    return Band.from_limits(np.maximum.accumulate(np.clip(low, 0, None)), np.clip(high, None, size))


@pytest.mark.parametrize("size", [1, 17, 97, 257])
def test_packing_matches_twin_and_is_adjoint(check, reference: Reference, rng, size):
    band = funnel(size)
    values, matrix = rng.normal(size=band.count), rng.normal(size=(size, size))
    expanded = check("band_expand", values, band)[0]
    gathered = check("band_gather", matrix, band)[0]
    np.testing.assert_allclose(np.sum(expanded * matrix), values @ gathered, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("size", [1, 17, 97, 257])
@pytest.mark.parametrize("transpose", [False, True])
def test_product_matches_twin(check, reference: Reference, rng, size, transpose):
    band = funnel(size)
    matrix = reference.band_expand(rng.normal(size=band.count), band)
    check("banded_product", rng.normal(size=(43, size)), matrix, band, transpose_r=transpose)


@pytest.mark.parametrize("transpose", [False, True])
def test_ranges_cover_the_band_and_little_else(transpose):
    band = funnel(200)
    inside = Reference().band_expand(np.ones(band.count), band)
    if transpose:
        inside = inside.T
    for panel, (first, last) in enumerate(panel_ranges(band, transpose, 16)):
        rows = np.flatnonzero(inside[:, panel * 16 : (panel + 1) * 16].any(axis=1))
        assert (first, last) == (rows[0], rows[-1] + 1)


def test_a_narrow_band_reads_only_its_tiles(kernels: Kernels):
    """NaN far from the band must not reach the product: those tiles are skipped, not multiplied by zero."""
    size = 320
    rows = np.arange(size)
    band = Band.from_limits(np.maximum(rows - 2, 0), np.minimum(rows + 3, size))
    matrix = Reference().band_expand(np.ones(band.count), band)
    poisoned = np.where(np.abs(rows[:, None] - rows) > 40, np.nan, matrix)
    result = kernels.numpy(kernels.banded_product(kernels.array(np.eye(size)), kernels.array(poisoned), band))
    np.testing.assert_array_equal(result, matrix)


@pytest.mark.parametrize(
    ("lower", "upper", "message"),
    [
        ([0, 0], [1], "two limits a row"),
        ([0, 2], [1, 3], r"row 1 of the band holds columns 2\.\.2 of 2"),
        ([1, 0], [2, 2], "must not decrease"),
    ],
)
def test_bad_limits_are_refused(lower, upper, message):
    with pytest.raises(InputError, match=message):
        Band.from_limits(lower, upper)
