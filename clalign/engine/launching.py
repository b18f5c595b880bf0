"""What the launchers of both classes of devices share. A launcher queues kernels for arguments that fit each other."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from clalign.engine.band import Band
from clalign.engine.device import Device, DeviceArray

Array: TypeAlias = DeviceArray
ArrayPair: TypeAlias = tuple[Array, Array]

NO_BANDS: tuple[None, None, None] = (None, None, None)


class Launcher:
    """A device and the tables that its kernels read."""

    def __init__(self, device: Device) -> None:
        self.device = device

    def _band_tables(self, band: Band) -> ArrayPair:
        """Limits and offsets of a band, kept on the device."""
        key = (band.lower.tobytes(), band.upper.tobytes())
        lower = self.device.table(("lower", *key), lambda: band.lower)
        return lower, self.device.table(("offsets", *key), lambda: band.offsets)

    def _ranges(self, band: Band | None, width: int, make: Callable[[Band, int], NDArray[np.int32]]) -> Array | None:
        """Table of what the rows or columns of a band reach, kept on the device."""
        if band is None:
            return None
        key = (make, band.lower.tobytes(), band.upper.tobytes(), width)
        return self.device.table(key, lambda: make(band, width))


def ceil_div(a: int, b: int) -> int:
    """Quotient rounded up."""
    return -(-a // b)


def equal_parts(length: int, most: int) -> tuple[int, int]:
    """Cut a length into at most `most` parts, the last of them shorter: how many there are, and the size of the others.

    No part is empty: nobody would write its sum, which is added to the others.
    """
    size = ceil_div(length, max(most, 1))
    return ceil_div(length, size), size


def panel_ranges(band: Band, width: int) -> NDArray[np.int32]:
    """First and last + 1 row with anything inside the band, for every panel of `width` columns: (panels, 2)."""
    first, last = _runs(band.size, width)
    # A row reaches columns first..last if its run ends behind `first` and starts at or before `last`.
    return np.stack(
        [np.searchsorted(band.upper, first, "right"), np.searchsorted(band.lower, last, "right")], axis=1
    ).astype(np.int32)


def row_ranges(band: Band, height: int) -> NDArray[np.int32]:
    """First and last + 1 column with anything inside the band, for every group of `height` rows: (groups, 2)."""
    first, last = _runs(band.size, height)
    return np.stack([band.lower[first], band.upper[last]], axis=1)


def _runs(size: int, length: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and last of every run of `length` numbers below `size`."""
    first = np.arange(0, size, length)
    return first, np.minimum(first + length, size) - 1


def pair_runs(k: int, length: int) -> NDArray[np.int32]:
    """Runs of `length` pairs (a, b .. b + length - 1) that cover all pairs a <= b < k: (runs, 2)."""
    return np.array([(a, b) for a in range(k) for b in range(a, k, length)], dtype=np.int32)


def distortion_definitions(floor: float | None, item_bytes: int) -> dict[str, str | int]:
    """``-D`` names and values of ``distortion_error.cl``, for reals of that many bytes; see `distortion_batch`."""
    suffix = "f" if item_bytes == 4 else ""
    return {} if floor is None else {"FLOOR": f"{float(floor)!r}{suffix}"}
