"""Fig. 5, 6 and 7: error curves, matched colours, and a mirrored result beside the search that avoids it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from clalign.correspondence import Correspondence
from clalign.evaluation.errors import THRESHOLDS, Evaluation
from clalign.presentation.curves import AXIS_LABELS, Unit, legend_height, new_figure, plot_error_curves
from clalign.presentation.figures.sheet import AFTER, BEFORE, PANEL_HEIGHT, Drawing, Image, panel_sheet
from clalign.presentation.figures.surfaces import PairView

_ERRORS = ("mean", "median", "exact", "mirrored_mean", "flipped")
_LOSSES = ("total", "align", "unsup", "unitarity")
_MIRROR_SHOWN = (2, 3, 4, 5)

Curves = Mapping[str, NDArray[np.float64]]


def draw_error_curves(curves: Mapping[Unit, Curves]) -> Drawing:
    """Draw Fig. 5: the share of points within a distance of the truth, per diameter as in the paper and per √area.

    Parameters
    ----------
    curves : unit to label to (251,) shares at `clalign.evaluation.errors.THRESHOLDS`.
    """
    units = [unit for unit in AXIS_LABELS if unit in curves][::-1]
    figure = new_figure(9.0, 3.7 + legend_height(max(len(curves[unit]) for unit in units)), "constrained")
    for axes, unit in zip(np.atleast_1d(figure.subplots(1, len(units))), units, strict=True):
        plot_error_curves(axes, curves[unit], unit)
    named = [(f"{label} / {unit}", curve) for unit in units for label, curve in curves[unit].items()]
    rows = tuple(
        (float(threshold), *(float(curve[place]) for _, curve in named)) for place, threshold in enumerate(THRESHOLDS)
    )
    return Drawing(figure, ("threshold", *(name for name, _ in named)), rows)


def draw_matched_colours(
    results: Mapping[str, Correspondence], evaluations: Mapping[str, Evaluation], height: int = PANEL_HEIGHT
) -> Drawing:
    """Draw Fig. 6: corresponding points of each pair in one colour, the target's colours carried to the source.

    Matches, and those of them that could be measured, go by label; `height` is half that of a panel, in pixels.
    """
    panels: list[Image] = []
    notes: list[str] = []
    for label, result in results.items():
        panels += PairView.of(result).map_panels(result, 2 * height)
        notes.append(_error_text(evaluations.get(label)))
    figure = panel_sheet(
        [panels],
        columns=[word for result in results.values() for word in (result.source.name, result.target.name)],
        notes=notes if any(notes) else (),
        note_span=2,
        gaps_after=[2 * place + 1 for place in range(len(results) - 1)],
    )
    rows = tuple((label, *_error_cells(evaluations.get(label))) for label in results)
    return Drawing(figure, ("pair", *_ERRORS), rows)


def draw_mirrored(
    results: Mapping[str, Correspondence], evaluations: Mapping[str, Evaluation], height: int = PANEL_HEIGHT
) -> Drawing:
    """Draw Fig. 7: maps of one pair from different starts, and the first aligned eigenfunctions that they lead to.

    Parameters
    ----------
    results : label to match of one pair; the last one is drawn as the good one.
    evaluations : by the same labels, with errors to the mirrored truth where it is known.
    """
    grid: list[list[Image]] = []
    *_, good = results.values()
    view = PairView.of(good)
    for result in results.values():
        panels = [*view.map_panels(result, height)]
        aligned = result.source_aligned, result.target_aligned
        background = AFTER if result is good else BEFORE
        for number in _MIRROR_SHOWN:
            index = min(number, min(result.rotation.shape)) - 1
            panels += view.function_panels(aligned, index, height, background)
        grid.append(panels)
    figure = panel_sheet(
        grid,
        columns=["source", "target", *(word for number in _MIRROR_SHOWN for word in (f"{number}, source", "target"))],
        rows=["\n".join([label, *_error_text(evaluations.get(label)).split(", ")]) for label in results],
        gaps_after=[1, 3, 5, 7],
    )
    rows = tuple(
        (
            label,
            *_error_cells(evaluations.get(label)),
            *(result.losses.get(name) for name in _LOSSES),
            result.orientation,
        )
        for label, result in results.items()
    )
    return Drawing(figure, ("start", *_ERRORS, *_LOSSES, "orientation"), rows)


def _error_text(evaluation: Evaluation | None) -> str:
    if evaluation is None:
        return ""
    text = f"mean error {100 * evaluation.mean:.2f}"
    if evaluation.mirrored_mean is not None:
        text += f", to the mirror image {100 * evaluation.mirrored_mean:.2f}"
    return text


def _error_cells(evaluation: Evaluation | None) -> tuple[float | str | None, ...]:
    if evaluation is None:
        return (None,) * len(_ERRORS)
    flipped = None if evaluation.flipped is None else str(evaluation.flipped).lower()
    return evaluation.mean, evaluation.median, evaluation.exact, evaluation.mirrored_mean, flipped
