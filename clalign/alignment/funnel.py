"""The funnel mask of R (Eq. 25) and the packing of R's entries into the optimiser's vector."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clalign.engine.backend import Band
from clalign.options import AlignmentOptions


def funnel_widths(count: int, slope: float, offset: int) -> NDArray[np.int64]:
    """Return W_i = ceil(i / a) + b for i = 1 … count (Eq. 25)."""
    return np.ceil(np.arange(1, count + 1) / slope).astype(np.int64) + offset


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
    lower = np.maximum(rows - reach, 0)
    upper = np.minimum(rows + reach + 1, count)
    offsets = np.concatenate([[0], np.cumsum(upper - lower)])
    return Band(lower.astype(np.int32), upper.astype(np.int32), offsets.astype(np.int32))


def band_mask(band: Band) -> NDArray[np.bool_]:
    """Return the (d, d) boolean mask of a band."""
    columns = np.arange(band.lower.size)
    return (columns >= band.lower[:, None]) & (columns < band.upper[:, None])
