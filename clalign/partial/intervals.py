"""Distances on a part and on the whole, compared as intervals.

Along the part a distance d may be longer than on the whole, which has more ways; it is no shorter than a bound L (see
`SampledSurface.lower_rows`). So a match is consistent if the distance on the whole lies in [L, d], up to what another
pose does to distances. Where the other surface has a boundary too, its distance is an interval as well, and the two
have to meet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clalign.rules.parts import PartSearchRules

Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Intervals:
    """Bounds of distances, (a, b) each.

    Attributes
    ----------
    lower, upper : float32.
    """

    lower: Floats
    upper: Floats

    def at(self, rows: NDArray[np.integer], columns: NDArray[np.integer]) -> Intervals:
        """Return the bounds at some rows (r,) and columns (c,), as (r, c)."""
        return Intervals(self.lower[np.ix_(rows, columns)], self.upper[np.ix_(rows, columns)])


def tolerances(upper: Floats, rules: PartSearchRules) -> Floats:
    """Return by how much another pose may change distances."""
    return np.asarray(rules.tolerance + rules.slope * upper, dtype=np.float32)


def misfits(part: Intervals, whole: Intervals, tolerance: Floats) -> Floats:
    """Return 1 − exp(−½ (g / σ)²) with g the gap between two intervals: 0 where they meet, 1 where they are far apart.

    The arrays of both are broadcast against each other. It is robust as what another pose changes much counts no more
    than what it changes beyond doubt.
    """
    gap = np.maximum(part.lower - whole.upper, whole.lower - part.upper)
    np.maximum(gap, 0.0, out=gap)
    gap /= tolerance
    gap *= gap
    gap *= np.float32(-0.5)
    np.exp(gap, out=gap)
    return np.subtract(np.float32(1.0), gap, out=gap)
