"""Square matrices that are zero outside a band, such as the rotation R inside its funnel (Eq. 25)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clalign.errors import InputError


@dataclass(frozen=True)
class Band:
    """The entries of a square matrix that may differ from zero: one run of columns in every row.

    lower, upper : (d,) int32, row i holds columns ``lower[i] .. upper[i] - 1``; both never decrease with i.
    offsets : (d + 1,) int32, position of each row's first entry among the packed values.
    """

    lower: NDArray[np.int32]
    upper: NDArray[np.int32]
    offsets: NDArray[np.int32]

    @staticmethod
    def from_limits(lower: ArrayLike, upper: ArrayLike) -> Band:
        """Build a band from the limits of its rows.

        Raises
        ------
        InputError
            The limits leave the matrix, cross, or decrease from one row to the next.
        """
        low, high = np.asarray(lower, dtype=np.int32), np.asarray(upper, dtype=np.int32)
        size = low.size
        if low.shape != high.shape or low.ndim != 1 or size == 0:
            raise InputError(f"a band needs two limits a row, got shapes {low.shape} and {high.shape}")
        bad = np.flatnonzero((low < 0) | (high > size) | (low >= high))
        if bad.size:
            row = int(bad[0])
            raise InputError(f"row {row} of the band holds columns {low[row]}..{high[row] - 1} of {size}")
        if np.any(np.diff(low) < 0) or np.any(np.diff(high) < 0):
            raise InputError("the limits of a band must not decrease from one row to the next")
        offsets = np.concatenate([[0], np.cumsum(high - low)]).astype(np.int32)
        return Band(low, high, offsets)

    @cached_property
    def transposed(self) -> Band:
        """The band of the transpose.

        Raises
        ------
        InputError
            A column has nothing inside the band.
        """
        columns = np.arange(self.size)
        first, last = np.searchsorted(self.upper, columns, "right"), np.searchsorted(self.lower, columns, "right")
        return Band.from_limits(first, last)

    @cached_property
    def positions(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Rows and columns of the packed entries, each (count,)."""
        widths = self.upper - self.lower
        rows = np.repeat(np.arange(self.size), widths)
        return rows, np.arange(self.count) - np.repeat(self.offsets[:-1] - self.lower, widths)

    @property
    def size(self) -> int:
        """Rows (and columns) of the matrix."""
        return int(self.lower.size)

    @property
    def count(self) -> int:
        """Entries inside the band."""
        return int(self.offsets[-1])
