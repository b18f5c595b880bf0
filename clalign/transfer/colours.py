"""Colours of shapes: by position, and by the values of a function."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clalign.transfer.surface_map import SurfaceMap

UNMATCHED = np.array([0.72, 0.72, 0.72])
"""Colour of vertices that the map gives no match."""

_DIVERGING = np.array(
    [[33, 60, 130], [58, 115, 178], [132, 182, 214], [243, 243, 240], [236, 163, 128], [202, 86, 74], [126, 22, 47]]
)
_SEQUENTIAL = np.array([[44, 30, 86], [59, 82, 139], [33, 145, 140], [94, 201, 98], [190, 220, 60], [253, 231, 37]])

RAMPS = {"signed": _DIVERGING, "amount": _SEQUENTIAL}
"""Stops (0 to 255, sRGB) between which colours are interpolated: blue-white-red, and dark to bright."""


def position_colours(vertices: NDArray[np.floating], view: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (n, 3) sRGB colours in [0, 1] of vertices (n, 3) that change smoothly with their place in space.

    Hue runs along the height and a little across, lightness tells left from right, chroma front from back, so that a
    mirrored or rotated map shows at once.

    view : (3, 3) float64, rotation to viewing axes.
    """
    points = np.asarray(vertices, dtype=np.float64) @ view.T
    low = points.min(axis=0)
    across, height, depth = ((points - low) / np.maximum(np.ptp(points, axis=0), 1e-300) - 0.5).T
    hue = np.deg2rad(165.0 + 265.0 * height + 70.0 * across)
    chroma = 46.0 + 22.0 * depth
    lightness = 69.0 + 26.0 * across + 6.0 * depth
    return _srgb_of_lab(lightness, chroma * np.cos(hue), chroma * np.sin(hue))


def function_colours(values: NDArray[np.floating], *, limit: float | None = None) -> NDArray[np.float64]:
    """Return (n, 3) colours of a signed function: white at zero, red above, blue below; `limit` is full colour.

    `limit` defaults to the 99 % quantile of |values|, so that a few extreme vertices do not bleach the rest.
    """
    signed = np.asarray(values, dtype=np.float64)
    if limit is None:
        limit = float(np.quantile(np.abs(signed), 0.99)) if signed.size else 1.0
    return _ramp(_DIVERGING, 0.5 + 0.5 * signed / max(limit, 1e-300))


def amount_colours(values: NDArray[np.floating], low: float, high: float) -> NDArray[np.float64]:
    """Return (n, 3) colours of an amount: dark at `low`, bright at `high`."""
    return _ramp(_SEQUENTIAL, (np.asarray(values, dtype=np.float64) - low) / max(high - low, 1e-300))


def carried_colours(target_colours: NDArray[np.float64], to_target: SurfaceMap) -> NDArray[np.float64]:
    """Return (n_x, 3) colours pulled back from the target; grey where a source vertex has no match."""
    return np.where(to_target.matched[:, None], to_target.pull(target_colours), UNMATCHED)


def _ramp(stops: NDArray[np.integer], place: NDArray[np.float64]) -> NDArray[np.float64]:
    at = np.linspace(0.0, 1.0, len(stops))
    return np.stack([np.interp(place, at, stops[:, channel] / 255.0) for channel in range(3)], axis=-1)


def _srgb_of_lab(lightness: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """CIE L*a*b* (D65) to sRGB, clipped to what a screen can show."""
    fy = (lightness + 16.0) / 116.0
    f = np.stack([fy + a / 500.0, fy, fy - b / 200.0], axis=-1)
    xyz = np.where(f > 6 / 29, f**3, 3 * (6 / 29) ** 2 * (f - 4 / 29)) * (0.95047, 1.0, 1.08883)
    to_rgb = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
    linear = np.clip(xyz @ to_rgb.T, 0.0, 1.0)
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)
