"""Writes the page of a collection, with the pictures of its shapes beside it.

The matrix of all pairs is a table of coloured links, or a picture where the shapes are too many for one.
"""

from __future__ import annotations

import base64
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from clalign.collection.result import Collection
from clalign.collection.store import PairRow, subfolder_of
from clalign.correspondence import Correspondence
from clalign.presentation import PAGE_FILE
from clalign.presentation.collection_page.pictures import shape_pictures
from clalign.presentation.html_page import file_url, write_page
from clalign.presentation.raster import png_bytes, write_png
from clalign.presentation.report import write_report
from clalign.transfer.colours import RAMPS, amount_colours

PICTURE_FOLDER = "pictures"
MOST_CELLS = 100
"""Shapes up to which every pair has a cell of its own; a larger table would take a browser too long."""

_PAIR_FUNCTIONS = 8
_MOST_LISTED = 30


@dataclass(frozen=True)
class Measure:
    """A number of each pair that the matrix can be coloured by; `low` and `high` get the ends of the colours."""

    name: str
    field: str
    label: str
    hint: str
    low: float
    high: float

    def colour(self, value: float) -> tuple[int, int, int]:
        """Return the red, green and blue (0 to 255) of a value."""
        red, green, blue = np.rint(255 * amount_colours(np.array([value]), self.low, self.high)[0])
        return int(red), int(green), int(blue)


MEASURES = (
    Measure("confidence", "confidence", "confidence", "by how much the map beats the best different one", 0.0, 1.0),
    Measure("cycle", "cycle_error", "cycle error", "how badly triangles of maps close: 0 exactly, 1 a flip", 1.0, 0.0),
    Measure("network", "network_error", "network error", "distance from the map that all others imply", 1.0, 0.0),
    Measure("distortion", "distortion", "distortion", "mean change of distances, in sqrt(area)", 0.1, 0.0),
)


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
    write_page(
        path,
        "collection_page/page.html",
        title=collection.folder.name,
        facts=_facts(collection),
        failures=collection.failures,
        most_listed=_MOST_LISTED,
        shapes=collection.shapes,
        folder=PICTURE_FOLDER,
        ways=_draw_all(collection, path.parent) if pictures else {},
        measures=MEASURES,
        stops=RAMPS["amount"].tolist(),
        tabular=len(collection.shapes) <= MOST_CELLS,
        rows={pair: row for row in collection.pairs for pair in ((row.source, row.target), (row.target, row.source))},
        picture=lambda measure: _picture(collection, measure),
        link=lambda row: _page_link(collection, row),
        listed=_worth_a_look(collection),
    )


def _draw_all(collection: Collection, folder: Path) -> dict[str, tuple[str, ...]]:
    """Draw every shape; return the way of the colours by name, in the order of drawing."""
    place = folder / PICTURE_FOLDER
    place.mkdir(exist_ok=True)
    ways = {}
    for name, image, ways[name] in shape_pictures(collection):
        write_png(place / f"{name}.png", image)
    return ways


def _facts(collection: Collection) -> dict[str, str]:
    kinds = [row.kind for row in collection.pairs if row.ok]
    confidence = sorted(row.confidence for row in collection.pairs if row.confidence is not None)
    return {
        "shapes": str(sum(row.ok for row in collection.shapes)),
        "pairs with maps": f"{len(kinds)} of {len(collection.pairs)}",
        "matched": str(len(kinds) - kinds.count("derived")),
        "replaced": str(kinds.count("repaired")),
        "made from others": str(kinds.count("derived")),
        "median confidence": f"{confidence[len(confidence) // 2]:.2f}" if confidence else "not known",
        "work": f"{sum(row.seconds or 0.0 for row in collection.pairs):,.0f} s",
    }


def _page_link(collection: Collection, row: PairRow) -> str | None:
    """Return the address of a pair's page, relative to the collection, or None where there is none."""
    parts = (subfolder_of(row.kind), row.source, row.target, PAGE_FILE)
    return file_url(*parts) if collection.folder.joinpath(*parts).is_file() else None


def _worth_a_look(collection: Collection) -> list[PairRow]:
    """Return what was replaced, then the maps of least confidence and largest cycle error."""
    maps = [row for row in collection.pairs if row.ok]
    replaced = [row for row in maps if row.kind == "repaired"]
    doubtful = sorted((row for row in maps if row.confidence is not None), key=lambda row: row.confidence or 0.0)
    open_cycles = sorted((row for row in maps if row.cycle_error is not None), key=lambda row: -(row.cycle_error or 0))
    return list(dict.fromkeys([*replaced, *doubtful[:8], *open_cycles[:8]]))[:_MOST_LISTED]


def _picture(collection: Collection, measure: Measure) -> str:
    """Return the matrix, a pixel a pair, as a PNG file in base64."""
    number = {row.name: index for index, row in enumerate(collection.shapes)}
    image = np.full((len(number), len(number), 3), 220, dtype=np.uint8)
    for row in collection.pairs:
        value = getattr(row, measure.field)
        if row.ok and value is not None:
            i, j = number[row.source], number[row.target]
            image[i, j] = image[j, i] = measure.colour(value)
    return base64.b64encode(png_bytes(image)).decode("ascii")
