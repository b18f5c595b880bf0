"""What all figures share: sheets of labelled panels, and one way of saving a figure with its numbers."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.errors import InputError
from clalign.presentation.curves import new_figure
from clalign.storage.files import visible

DPI = 200
PANEL_HEIGHT = 300
_LINE = 26
BEFORE = (0.985, 0.925, 0.935)
AFTER = (0.915, 0.965, 0.925)
PLAIN = (1.0, 1.0, 1.0)

Image = NDArray[np.uint8]
Cell = str | int | float | None


@dataclass(frozen=True)
class Drawing:
    """A figure and the numbers that it shows: names of columns, the first saying what a row is, and rows of cells."""

    figure: Any
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


def save_drawing(drawing: Drawing, folder: Path, stem: str) -> list[Path]:
    """Write ``STEM.png``, ``STEM.svg`` and ``STEM.csv``; the same drawing gives the same bytes.

    Raises
    ------
    InputError
        A file cannot be written.
    """
    import matplotlib

    paths = [folder / f"{stem}.{ending}" for ending in ("png", "svg", "csv")]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with matplotlib.rc_context({"svg.hashsalt": stem, "svg.fonttype": "path"}):
            drawing.figure.savefig(paths[0], dpi=DPI)
            drawing.figure.savefig(paths[1], dpi=DPI, metadata={"Date": None})
        with paths[2].open("w", encoding="utf-8", errors="backslashreplace", newline="") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(drawing.columns)
            writer.writerows([[f"{c:.6g}" if isinstance(c, float) else c for c in row] for row in drawing.rows])
    except OSError as error:
        raise InputError(f"{error.filename or folder}: cannot be written ({error.strerror})") from error
    return paths


def panel_sheet(
    grid: Sequence[Sequence[Image]],
    *,
    columns: Sequence[str] = (),
    rows: Sequence[str] = (),
    notes: Sequence[str] = (),
    gaps_after: Sequence[int] = (),
    column_span: int = 1,
    note_span: int = 1,
) -> Any:
    """Return a figure of images of one size in rows and columns.

    Parameters
    ----------
    grid : rows of (h, w, 3) uint8 images, all of one shape.
    columns : words above the columns, each above `column_span` of them.
    rows : words to the left of the rows, turned by a quarter.
    notes : words below the columns, each below `note_span` of them.
    gaps_after : columns (from 0) that are followed by a gap.
    """
    height, width = grid[0][0].shape[:2]
    gap = max(6, width // 6)
    left = 24 + _LINE * _lines(rows) if rows else 8
    top = 12 + _LINE * _lines(columns) if columns else 8
    bottom = 12 + _LINE * _lines(notes) if notes else 8
    lefts = [left + column * width + gap * sum(column > g for g in gaps_after) for column in range(len(grid[0]))]
    size = (lefts[-1] + width + 8, top + len(grid) * height + bottom)
    canvas = np.full((size[1], size[0], 3), 255, dtype=np.uint8)
    for number, images in enumerate(grid):
        for place, image in zip(lefts, images, strict=True):
            canvas[top + number * height : top + (number + 1) * height, place : place + width] = image
    figure = new_figure(size[0] / DPI, size[1] / DPI)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    axes.imshow(canvas, extent=(0, size[0], size[1], 0), interpolation="none", aspect="auto")
    style = {"fontsize": 7, "ha": "center"}
    for words, span, y, anchor in (
        (columns, column_span, top - 8, "bottom"),
        (notes, note_span, size[1] - bottom + 8, "top"),
    ):
        for number, label in enumerate(words):
            ends = lefts[number * span], lefts[(number + 1) * span - 1] + width
            axes.text(sum(ends) / 2, y, visible(label), va=anchor, **style)
    for number, label in enumerate(rows):
        axes.text(left / 2, top + (number + 0.5) * height, visible(label), rotation=90, va="center", **style)
    return figure


def _lines(labels: Sequence[str]) -> int:
    return 1 + max(label.count("\n") for label in labels)
