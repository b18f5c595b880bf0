"""The matrix of all pairs: a table of coloured links, or a picture where the shapes are too many for one."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from dataclasses import dataclass
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from clalign.collection.result import Collection
from clalign.collection.store import PairRow
from clalign.presentation.raster import png_bytes
from clalign.transfer.colours import RAMPS, amount_colours

PAGE_FILE = "report.html"
MOST_CELLS = 100
"""Shapes up to which every pair has a cell of its own; a larger table would take a browser too long."""


@dataclass(frozen=True)
class Measure:
    """A number of each pair that the matrix can be coloured by; `low` and `high` get the ends of the colours."""

    name: str
    field: str
    label: str
    hint: str
    low: float
    high: float


MEASURES = (
    Measure("confidence", "confidence", "confidence", "by how much the map beats the best different one", 0.0, 1.0),
    Measure("cycle", "cycle_error", "cycle error", "how badly triangles of maps close: 0 exactly, 1 a flip", 1.0, 0.0),
    Measure("network", "network_error", "network error", "distance from the map that all others imply", 1.0, 0.0),
    Measure("distortion", "distortion", "distortion", "mean change of distances, in sqrt(area)", 0.1, 0.0),
)


def switches() -> str:
    """Return the buttons that choose a measure."""
    return "".join(
        f'<label><input type="radio" name="measure" value="{measure.name}"{" checked" if not number else ""}> '
        f"<span>{measure.label}</span></label>"
        for number, measure in enumerate(MEASURES)
    )


def legends() -> str:
    """Return what the colours and signs mean, one line a measure."""
    stops = ", ".join("rgb({},{},{})".format(*stop) for stop in RAMPS["amount"].tolist())
    ramps = "".join(
        f'<p class="legend measure" data-measure="{measure.name}"{" hidden" if number else ""}>{measure.low:g} '
        f'<span class="ramp" style="background: linear-gradient(90deg, {stops})"></span> {measure.high:g}: '
        f"{html.escape(measure.hint)}</p>"
        for number, measure in enumerate(MEASURES)
    )
    signs = "".join(
        f'<span><span class="sign {kind}"></span> {text}</span>'
        for kind, text in (
            ("direct", "grey: not known"),
            ("repaired", "replaced, it contradicted the others"),
            ("derived", "made from the other maps"),
            ("failed", "no map"),
        )
    )
    return f'{ramps}<p class="legend">{signs}</p>'


def matrix(collection: Collection, names: Sequence[str]) -> str:
    """Return the matrix as HTML; cells link to the pages of the pairs that have one."""
    if len(names) > MOST_CELLS:
        return "".join(_picture(collection, names, measure) for measure in MEASURES)
    rows = {frozenset((row.source, row.target)): row for row in collection.pairs}
    head = "".join(f'<th scope="col">{html.escape(name)}</th>' for name in names)
    lines = []
    for name in names:
        cells = "".join(_cell(collection, name, other, rows.get(frozenset((name, other)))) for other in names)
        lines.append(f'<tr><th scope="row">{html.escape(name)}</th>{cells}</tr>')
    return f"<table><thead><tr><td></td>{head}</tr></thead><tbody>{''.join(lines)}</tbody></table>"


def page_link(collection: Collection, row: PairRow) -> str | None:
    """Return the address of a pair's page, relative to the collection, or None where there is none."""
    subfolder = "pairs" if row.kind == "direct" else "consistent"
    if not (collection.folder / subfolder / row.source / row.target / PAGE_FILE).is_file():
        return None
    return "/".join(quote(part) for part in (subfolder, row.source, row.target, PAGE_FILE))


def _cell(collection: Collection, name: str, other: str, row: PairRow | None) -> str:
    if name == other:
        return '<td><span class="self"></span></td>'
    if row is None:
        return f'<td><span title="{html.escape(f"{name}, {other}: not matched")}"></span></td>'
    said = html.escape(_said(row), quote=True)
    if not row.ok:
        return f'<td><span class="failed" title="{said}"></span></td>'
    colours = ";".join(
        f"--{measure.name}:{_css(amount_colours(np.array([value]), measure.low, measure.high)[0])}"
        for measure in MEASURES
        if (value := getattr(row, measure.field)) is not None
    )
    link = page_link(collection, row)
    facts = f'class="{row.kind}" style="{colours}" title="{said}"'
    return f'<td><a href="{link}" aria-label="{said}" {facts}></a></td>' if link else f"<td><span {facts}></span></td>"


def _said(row: PairRow) -> str:
    if not row.ok:
        return f"{row.source}, {row.target}: {row.status}, {row.message}"
    values = [
        f"{measure.label} {value:.3g}" for measure in MEASURES if (value := getattr(row, measure.field)) is not None
    ]
    return f"{row.source}, {row.target}: {', '.join([row.kind, *values])}"


def _css(colour: NDArray[np.float64]) -> str:
    return "rgb({},{},{})".format(*(round(255 * float(part)) for part in colour))


def _picture(collection: Collection, names: Sequence[str], measure: Measure) -> str:
    number = {name: index for index, name in enumerate(names)}
    image = np.full((len(names), len(names), 3), 220, dtype=np.uint8)
    for row in collection.pairs:
        value = getattr(row, measure.field)
        if row.ok and value is not None:
            colour = np.rint(255 * amount_colours(np.array([value]), measure.low, measure.high)[0]).astype(np.uint8)
            i, j = number[row.source], number[row.target]
            image[i, j] = image[j, i] = colour
    content = base64.b64encode(png_bytes(image)).decode("ascii")
    alt = f"Matrix of {len(names)} by {len(names)} shapes, coloured by {measure.label}"
    return f'<img data-measure="{measure.name}" alt="{alt}" src="data:image/png;base64,{content}">'
