"""Banded matrices: packing, and products that skip what is zero."""

from __future__ import annotations

import numpy as np
import pytest

from clalign.engine.band import Band
from clalign.engine.kernels import Kernels
from clalign.engine.launching import panel_ranges, row_ranges
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
@pytest.mark.parametrize("left", [False, True])
@pytest.mark.parametrize("right", [False, True])
@pytest.mark.parametrize("kept", [False, True])
def test_product_matches_twin(check, reference: Reference, rng, size, left, right, kept):
    band = funnel(size)
    full = Band.from_limits(np.zeros(size), np.full(size, size))
    bands = {
        "left": band if left else full,
        "right": band.transposed if right else full,
        "kept": band if kept else None,
    }
    a, b = (reference.band_expand(rng.normal(size=bands[side].count), bands[side]) for side in ("left", "right"))
    check("banded_product", a, b, **bands, scale=-1.5, inside=bands["kept"])


@pytest.mark.parametrize("transpose", [False, True])
def test_product_with_few_rows_matches_twin(check, reference: Reference, rng, transpose):
    band = funnel(257).transposed if transpose else funnel(257)
    matrix = reference.band_expand(rng.normal(size=band.count), band)
    check("banded_product", rng.normal(size=(43, 257)), matrix, right=band)


def test_product_accumulates_into_out(kernels: Kernels, reference: Reference, rng):
    band = funnel(97)
    inside = reference.band_expand(np.ones(band.count), band).astype(bool)
    a, b, c = (rng.normal(size=(97, 97)) for _ in range(3))
    b[~inside] = 0.0
    out = kernels.array(c)
    kernels.banded_product(
        kernels.array(a), kernels.array(b), right=band, kept=band, scale=2.0, accumulate=True, out=out
    )
    np.testing.assert_allclose(kernels.numpy(out)[inside], (c + 2 * a @ b)[inside], rtol=0, atol=1e-4)


@pytest.mark.parametrize("shape", [(1, 1), (17, 5), (97, 130), (16, 33)])
def test_transpose_matches_twin(check, rng, shape):
    check("transpose", rng.normal(size=shape))


@pytest.mark.parametrize("size", [1, 2, 97, 200])
def test_the_transposed_band_holds_the_transpose(size):
    band = funnel(size)
    inside = Reference().band_expand(np.ones(band.count), band)
    np.testing.assert_array_equal(Reference().band_expand(np.ones(band.count), band.transposed), inside.T)
    twice = band.transposed.transposed
    np.testing.assert_array_equal(twice.lower, band.lower)
    np.testing.assert_array_equal(twice.upper, band.upper)


def test_a_band_with_an_empty_column_has_no_transpose():
    with pytest.raises(InputError, match="row 1 of the band"):
        _ = Band.from_limits([0, 0, 2], [1, 1, 3]).transposed


@pytest.mark.parametrize("width", [6, 8, 16, 32])
def test_ranges_cover_the_band_and_little_else(width):
    band = funnel(200)
    inside = Reference().band_expand(np.ones(band.count), band).astype(bool)
    for panel, (first, last) in enumerate(panel_ranges(band, width)):
        rows = np.flatnonzero(inside[:, panel * width : (panel + 1) * width].any(axis=1))
        assert (first, last) == (rows[0], rows[-1] + 1)
    for group, (first, last) in enumerate(row_ranges(band, width)):
        columns = np.flatnonzero(inside[group * width : (group + 1) * width].any(axis=0))
        assert (first, last) == (columns[0], columns[-1] + 1)


def reach(kernels: Kernels) -> int:
    """How far from a narrow band its tiles reach: those of a work-group of a GPU have 128 rows and 64 columns."""
    return 40 if kernels.device.constants.name == "cpu" else 128 + 64 + 3


@pytest.mark.parametrize("kernels", ["cpu", "gpu"], indirect=True)
def test_a_narrow_band_reads_only_its_tiles(kernels: Kernels):
    """NaN far from the band must not reach the product: those tiles are skipped, not multiplied by zero."""
    size = 320
    rows = np.arange(size)
    band = Band.from_limits(np.maximum(rows - 2, 0), np.minimum(rows + 3, size))
    matrix = Reference().band_expand(np.ones(band.count), band)
    poisoned = np.where(np.abs(rows[:, None] - rows) > reach(kernels), np.nan, matrix)
    result = kernels.numpy(kernels.banded_product(kernels.array(np.eye(size)), kernels.array(poisoned), right=band))
    np.testing.assert_array_equal(result, matrix)
    left = kernels.numpy(kernels.banded_product(kernels.array(poisoned), kernels.array(np.eye(size)), left=band))
    np.testing.assert_array_equal(left, matrix)


@pytest.mark.parametrize("kernels", ["cpu", "gpu"], indirect=True)
def test_what_is_not_kept_is_not_computed(kernels: Kernels, rng):
    """Tiles far from the band keep what was there."""
    size = 320
    rows = np.arange(size)
    band = Band.from_limits(np.maximum(rows - 2, 0), np.minimum(rows + 3, size))
    a, b = (kernels.array(rng.normal(size=(size, size))) for _ in range(2))
    out = kernels.array(np.full((size, size), 7.0))
    kernels.banded_product(a, b, kept=band, out=out)
    far = np.abs(rows[:, None] - rows) > reach(kernels)
    np.testing.assert_array_equal(kernels.numpy(out)[far], 7.0)


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
