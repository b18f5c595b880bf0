"""Picture of how the time of a match grows with the meshes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from clalign.benchmark.pair import ScaleTime, stage_exponents, stage_names
from clalign.errors import InputError

SHOWN_ABOVE = 0.02
"""A stage is drawn when it takes this share of the largest match."""


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
    if not times:
        raise InputError("no time to draw")
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise InputError("pictures of times need matplotlib: pip install 'clalign[plots]'") from error
    ordered = sorted(times, key=lambda one: one.vertices)
    sizes, last = [one.vertices for one in ordered], ordered[-1].time
    exponents = stage_exponents(ordered)
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axes = figure.add_subplot()
    totals = [one.time.seconds for one in ordered]
    axes.plot(sizes, totals, "k-o", label=_label("whole match", exponents["total"]), linewidth=2)
    for name in stage_names([last]):
        if last.stages[name] >= SHOWN_ABOVE * last.seconds:
            seconds = [one.time.stages.get(name, float("nan")) for one in ordered]
            axes.plot(sizes, seconds, "-o", label=_label(name, exponents[name]), linewidth=1.2, markersize=4)
    axes.plot(sizes, [totals[0] * size / sizes[0] for size in sizes], ":", color="grey", label="∝ n")
    axes.set(xscale="log", yscale="log", xlabel="vertices of each mesh", ylabel="seconds", title=title)
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize="small")
    try:
        figure.savefig(path, dpi=160)
    except (ValueError, OSError) as error:
        raise InputError(f"{path}: {error}") from error


def _label(name: str, exponent: float | None) -> str:
    return name if exponent is None else f"{name}, n^{exponent:.2f}"
