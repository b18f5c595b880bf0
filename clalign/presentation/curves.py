"""Charts: the share of points whose error is at most r, and how the time of a match grows with the meshes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from clalign.errors import InputError
from clalign.evaluation.errors import THRESHOLDS, area_under_curve
from clalign.storage.files import visible

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from clalign.benchmark.pair import ScaleTime

Unit = Literal["sqrt_area", "diameter"]
AXIS_LABELS: dict[Unit, str] = {
    "sqrt_area": "geodesic error / √area",
    "diameter": "geodesic error / diameter",
}
COLOURS = 10
LINE_STYLES = ("-", "--", ":")
SHOWN_ABOVE = 0.02
"""A stage is drawn when it takes this share of the largest match."""


def new_figure(width: float, height: float, layout: Literal["constrained"] | None = None) -> Any:
    """Return an empty matplotlib figure of a size in inches.

    Raises
    ------
    InputError
        matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise InputError("figures need matplotlib: pip install 'clalign[plots]'") from error
    return Figure(figsize=(width, height), layout=layout)


def save_error_curves(curves: Mapping[str, NDArray[np.float64]], path: str | Path, *, unit: Unit = "sqrt_area") -> None:
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
    figure = new_figure(5.6, 3.8 + legend_height(len(curves)), "constrained")
    plot_error_curves(figure.add_subplot(), curves, unit)
    _save(figure, path)


def plot_error_curves(axes: Axes, curves: Mapping[str, NDArray[np.float64]], unit: Unit) -> None:
    """Plot curves with their names below, where they hide none, however many there are."""
    for number, (label, curve) in enumerate(curves.items()):
        style = LINE_STYLES[number // COLOURS % len(LINE_STYLES)]
        named = f"{visible(label)} ({area_under_curve(curve):.3f})"
        axes.plot(THRESHOLDS, 100 * curve, style, color=f"C{number % COLOURS}", label=named, linewidth=1.6)
    axes.set(xlim=(0, THRESHOLDS[-1]), ylim=(0, 101), xlabel=AXIS_LABELS[unit], ylabel="% of points")
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


def save_scale_plot(times: Sequence[ScaleTime], path: str | Path, title: str = "") -> None:
    """Draw seconds of the match and of its longer stages over the number of vertices, both axes logarithmic.

    Parameters
    ----------
    times : at least one, in any order.
    path : the ending chooses the format: PNG, SVG or PDF.

    Raises
    ------
    InputError
        There is no time; or matplotlib is not installed, or the file cannot be written.
    """
    from clalign.benchmark.pair import stage_exponents

    if not times:
        raise InputError("no time to draw")
    ordered = sorted(times, key=lambda one: one.vertices)
    sizes, last = [one.vertices for one in ordered], ordered[-1].time
    powers = {name: "" if p is None else f", n^{p:.2f}" for name, p in stage_exponents(ordered).items()}
    figure = new_figure(6.4, 4.2, "constrained")
    axes = figure.add_subplot()
    totals = [one.time.seconds for one in ordered]
    axes.plot(sizes, totals, "k-o", label=f"whole match{powers['total']}", linewidth=2)
    for name, longest in last.stages.items():
        if longest >= SHOWN_ABOVE * last.seconds:
            seconds = [one.time.stages.get(name, float("nan")) for one in ordered]
            axes.plot(sizes, seconds, "-o", label=name + powers[name], linewidth=1.2, markersize=4)
    axes.plot(sizes, [totals[0] * size / sizes[0] for size in sizes], ":", color="grey", label="∝ n")
    axes.set(xscale="log", yscale="log", xlabel="vertices of each mesh", ylabel="seconds", title=title)
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize="small")
    _save(figure, path)


def _save(figure: Any, path: str | Path) -> None:
    try:
        figure.savefig(path, dpi=160)
    except (ValueError, OSError) as error:
        raise InputError(f"{path}: {error}") from error
