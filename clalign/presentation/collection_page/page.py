"""Writes the page of a collection, with the pictures of its shapes beside it."""

from __future__ import annotations

import html
from pathlib import Path
from urllib.parse import quote

from clalign.collection.result import Collection
from clalign.collection.store import PairRow
from clalign.correspondence import Correspondence
from clalign.presentation.collection_page.matrix import PAGE_FILE, legends, matrix, page_link, switches
from clalign.presentation.collection_page.pictures import shape_pictures
from clalign.presentation.html_page import file_text, fill, head, write_page
from clalign.presentation.raster import write_png
from clalign.presentation.report import write_report

PICTURE_FOLDER = "pictures"

_REPORT = "clalign.presentation.report"
_PAIR_FUNCTIONS = 8
_MOST_LISTED = 30


def write_pair_page(result: Correspondence, folder: Path) -> None:
    """Write the page of one pair of a collection into the pair's folder, with few eigenfunctions as there are many."""
    write_report(result, folder / PAGE_FILE, functions=_PAIR_FUNCTIONS)


def write_collection_page(collection: Collection, path: str | Path, *, pictures: bool = True) -> None:
    """Write the page of a collection and, in ``pictures/`` beside it, a picture of every shape.

    Parameters
    ----------
    collection : with its folder; links to pairs' pages are made where those are.
    path : the file to write, in the collection's folder.
    pictures : False leaves the pictures out.
    """
    path = Path(path)
    drawn = _draw_all(collection, path.parent) if pictures else {}
    names = [row.name for row in collection.shapes]
    title = html.escape(collection.folder.name)
    style = file_text(_REPORT, "page.css") + file_text(__package__, "page.css")
    parts = {
        "head": head(title, style, "'self' file: data:"),
        "title": title,
        "facts": _facts(collection),
        "failures": _failures(collection),
        "colouring": _colouring(drawn),
        "gallery": _gallery(collection, drawn),
        "measures": switches(),
        "legends": legends(),
        "matrix": f'<div id="matrix" data-measure="confidence">{matrix(collection, names)}</div>',
        "look": _worth_a_look(collection),
    }
    write_page(path, fill(file_text(__package__, "page.html"), parts))


def _draw_all(collection: Collection, folder: Path) -> dict[str, tuple[str, ...]]:
    """Draw every shape; return the way of the colours by name, in the order of drawing."""
    place = folder / PICTURE_FOLDER
    place.mkdir(exist_ok=True)
    ways = {}
    for picture in shape_pictures(collection):
        write_png(place / f"{picture.name}.png", picture.image)
        ways[picture.name] = picture.way
    return ways


def _facts(collection: Collection) -> str:
    kinds = [row.kind for row in collection.pairs if row.ok]
    confidence = sorted(row.confidence for row in collection.pairs if row.confidence is not None)
    values = {
        "shapes": str(sum(row.ok for row in collection.shapes)),
        "pairs with maps": f"{len(kinds)} of {len(collection.pairs)}",
        "matched": str(len(kinds) - kinds.count("derived")),
        "replaced": str(kinds.count("repaired")),
        "made from others": str(kinds.count("derived")),
        "median confidence": f"{confidence[len(confidence) // 2]:.2f}" if confidence else "not known",
        "work": f"{sum(row.seconds or 0.0 for row in collection.pairs):,.0f} s",
    }
    return "".join(f"<div><dt>{name}</dt><dd>{value}</dd></div>" for name, value in values.items())


def _failures(collection: Collection) -> str:
    failures = collection.failures
    if not failures:
        return ""
    listed = "".join(f"<li>{html.escape(failure)}</li>" for failure in failures[:_MOST_LISTED])
    more = f"<li>and {len(failures) - _MOST_LISTED} more, see pairs.csv</li>" if len(failures) > _MOST_LISTED else ""
    return f'<div id="warnings" role="note"><strong>Left out</strong><ul>{listed}{more}</ul></div>'


def _colouring(drawn: dict[str, tuple[str, ...]]) -> str:
    if not drawn:
        return "Without pictures, as asked."
    first = html.escape(next(iter(drawn)))
    return f"Same colour, same point: colours are those of {first}, carried to all others by their maps."


def _gallery(collection: Collection, drawn: dict[str, tuple[str, ...]]) -> str:
    figures = []
    for row in collection.shapes:
        name = html.escape(row.name)
        if row.name in drawn:
            way = drawn[row.name]
            alt = f"{name}, coloured over {html.escape(' and '.join(way))}" if way else name
            picture = f'<img loading="lazy" alt="{alt}" src="{PICTURE_FOLDER}/{quote(row.name)}.png">'
        else:
            picture = '<span class="none">no picture</span>'
        size = f"{row.vertices:,} vertices" if row.ok and row.vertices is not None else html.escape(row.status)
        figures.append(f"<figure>{picture}<figcaption><b>{name}</b> {size}</figcaption></figure>")
    return "".join(figures)


def _worth_a_look(collection: Collection) -> str:
    """List what was replaced, then the maps of least confidence and largest cycle error."""
    maps = [row for row in collection.pairs if row.ok]
    replaced = [row for row in maps if row.kind == "repaired"]
    doubtful = sorted((row for row in maps if row.confidence is not None), key=lambda row: row.confidence or 0.0)
    open_cycles = sorted((row for row in maps if row.cycle_error is not None), key=lambda row: -(row.cycle_error or 0))
    listed = list(dict.fromkeys([*replaced, *doubtful[:8], *open_cycles[:8]]))[:_MOST_LISTED]
    if not listed:
        return '<p class="hint">There is no matched pair.</p>'
    columns = ("pair", "map", "confidence", "cycle error", "network error", "warnings")
    head = "<tr>" + "".join(f'<th scope="col">{column}</th>' for column in columns) + "</tr>"
    return f'<div class="scroll"><table>{head}{"".join(_line(collection, row) for row in listed)}</table></div>'


def _line(collection: Collection, row: PairRow) -> str:
    name = html.escape(f"{row.source}, {row.target}")
    link = page_link(collection, row)
    first = f'<a href="{link}">{name}</a>' if link else name
    numbers = "".join(
        f'<td class="number">{"" if value is None else f"{value:.3f}"}</td>'
        for value in (row.confidence, row.cycle_error, row.network_error)
    )
    return f'<tr><td>{first}</td><td>{row.kind}</td>{numbers}<td class="wrap">{html.escape(row.warnings)}</td></tr>'
