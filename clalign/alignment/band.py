"""The funnel of R: the entries that are variables (Eq. 25)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clalign.engine.band import Band
from clalign.options import AlignmentOptions


def funnel_widths(count: int, slope: float, offset: int) -> NDArray[np.int64]:
    """Return W_i = ceil(i / a) + b for i = 1 … count (Eq. 25), at most 2 count: the whole matrix in every reading."""
    # As floats first: a slope near zero gives widths, and infinity, that no integer holds.
    with np.errstate(over="ignore"):
        widths = np.ceil(np.arange(1, count + 1) / slope) + min(offset, 2 * count)
    return np.minimum(widths, 2 * count).astype(np.int64)


def funnel_band(count: int, options: AlignmentOptions) -> Band:
    """Return the entries of R that are variables, as a column interval for each row.

    Parameters
    ----------
    count : d, the number of aligned eigenfunctions.
    options : `band` says how the width W_i is read: "half" keeps |i − j| ≤ W_i (measured to hold 90–99 % of the
        energy of the true C̃ between poses), "full" keeps |i − j| ≤ W_i / 2, "diagonal" only i = j, "none" all.

    Returns
    -------
    Band
        Row i holds columns ``lower[i] … upper[i] - 1``; ``offsets[i]`` is the place of the row's first entry in the
        packed vector, ``offsets[d]`` the number of variables.
    """
    rows = np.arange(count, dtype=np.int64)
    if options.band == "none":
        reach = np.full(count, count, dtype=np.int64)
    elif options.band == "diagonal":
        reach = np.zeros(count, dtype=np.int64)
    else:
        widths = funnel_widths(count, options.band_slope, options.band_offset)
        reach = widths if options.band == "half" else widths // 2
    return Band.from_limits(np.maximum(rows - reach, 0), np.minimum(rows + reach + 1, count))


def band_mask(band: Band) -> NDArray[np.bool_]:
    """Return the (d, d) boolean mask of a band."""
    columns = np.arange(band.lower.size)
    return (columns >= band.lower[:, None]) & (columns < band.upper[:, None])
