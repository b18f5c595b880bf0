"""Pictures of error curves: the share of points whose error is at most r."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from clalign.errors import InputError
from clalign.evaluation.errors import THRESHOLDS, area_under_curve

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Unit = Literal["sqrt_area", "diameter"]
AXIS_LABELS: dict[Unit, str] = {
    "sqrt_area": "geodesic error / √area",
    "diameter": "geodesic error / diameter",
}
COLOURS = 10
LINE_STYLES = ("-", "--", ":")


def save_error_curves(
    curves: Mapping[str, NDArray[np.float64]],
    path: str | Path,
    *,
    unit: Unit = "sqrt_area",
) -> None:
    """Draw curves over the thresholds of `clalign.evaluation.errors` into a PNG, SVG or PDF file.

    Parameters
    ----------
    curves : label to (251,) shares, drawn in this order; the legend adds the area under each curve.
    path : the ending chooses the format.
    unit : what errors are divided by, for the axis.

    Raises
    ------
    InputError
        There is no curve, or one of another length; or matplotlib is not installed, or the file cannot be written.
    """
    for label, curve in curves.items():
        if curve.shape != THRESHOLDS.shape:
            raise InputError(f"curve {label!r} has shape {curve.shape}, expected {THRESHOLDS.shape}")
    if not curves:
        raise InputError("no curve to draw")
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise InputError("pictures of curves need matplotlib: pip install 'clalign[plots]'") from error
    figure = Figure(figsize=(5.6, 3.8 + legend_height(len(curves))), layout="constrained")
    plot_error_curves(figure.add_subplot(), curves, unit, float(THRESHOLDS[-1]))
    try:
        figure.savefig(path, dpi=160)
    except (ValueError, OSError) as error:
        raise InputError(f"{path}: {error}") from error


def plot_error_curves(axes: Axes, curves: Mapping[str, NDArray[np.float64]], unit: Unit, largest: float) -> None:
    """Plot curves with their names below, where they hide none, however many there are."""
    for number, (label, curve) in enumerate(curves.items()):
        style = LINE_STYLES[number // COLOURS % len(LINE_STYLES)]
        named = f"{label} ({area_under_curve(curve):.3f})"
        axes.plot(THRESHOLDS, 100 * curve, style, color=f"C{number % COLOURS}", label=named, linewidth=1.6)
    axes.set(xlim=(0, largest), ylim=(0, 101), xlabel=AXIS_LABELS[unit], ylabel="% of points")
    axes.grid(alpha=0.3)
    axes.legend(
        loc="upper center",
        bbox_to_anchor=(0.5, -0.16),
        frameon=False,
        fontsize="x-small",
        title="area under the curve in brackets",
        title_fontsize="x-small",
    )


def legend_height(count: int) -> float:
    """Return the inches that the names of so many curves take."""
    return 0.25 + 0.16 * count
