"""The index of a collection: one row a pair and one a shape, as CSV files that any program reads."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from clalign.storage.rows import RowFile

PAIRS_FILE = "pairs.csv"
SHAPES_FILE = "shapes.csv"

Kind = Literal["direct", "repaired", "derived"]
Status = Literal["ok", "failed", "skipped"]


@dataclass(frozen=True)
class PairRow:
    """What is known of one pair. Lengths in sqrt(area), times in seconds; None, an empty cell, is not known.

    Attributes
    ----------
    source, target : names of the shapes.
    kind : "direct" for a map that was matched, "derived" for one that came from the network alone, "repaired" for one
        that was matched and then replaced because it contradicted the network.
    status : "ok"; "failed"; "skipped" because a shape of the pair failed.
    message : why there is no map.
    confidence, orientation : of the match, see `clalign.Correspondence`.
    distortion : mean change of distances under the map.
    cycle_error, network_error : of the matched map, before any repair: median deviation around triangles, and
        deviation from the network's map (see `clalign.collection.network`).
    total, align, unsup : losses at the kept point.
    seconds : of the work on this pair, all stages together.
    stages : "name=seconds" joined by ";".
    loaded : prepared shapes of the pair that the worker had to fetch from the cache, or compute.
    peak_memory : bytes of the worker process at its largest so far.
    warnings : joined by " | ".
    device : that computed, as it names itself.
    worker : that did the work.
    """

    source: str
    target: str
    kind: Kind = "direct"
    status: Status = "ok"
    message: str = ""
    confidence: float | None = None
    orientation: float | None = None
    distortion: float | None = None
    cycle_error: float | None = None
    network_error: float | None = None
    total: float | None = None
    align: float | None = None
    unsup: float | None = None
    seconds: float | None = None
    stages: str = ""
    loaded: int | None = None
    peak_memory: int | None = None
    warnings: str = ""
    device: str = ""
    worker: str = ""

    @property
    def ok(self) -> bool:
        """Whether there is a map."""
        return self.status == "ok"


@dataclass(frozen=True)
class ShapeRow:
    """What is known of one shape; `eigenvalues` (not in the file) are the first of its LBO that are positive."""

    name: str
    path: str
    status: Status = "ok"
    message: str = ""
    vertices: int | None = None
    faces: int | None = None
    seconds: float | None = None
    notes: str = ""
    eigenvalues: tuple[float, ...] = field(default=(), metadata={"stored": False})

    @property
    def ok(self) -> bool:
        """Whether the shape could be prepared."""
        return self.status == "ok"


def plain(row: PairRow) -> dict[str, Any]:
    """Return a row as values that JSON can write; `PairRow(**plain(row))` is the row."""
    return asdict(row)


def pair_rows(folder: Path) -> RowFile[PairRow]:
    """Return the index of pairs in the folder of a collection."""
    return RowFile(folder / PAIRS_FILE, PairRow)


def shape_rows(folder: Path) -> RowFile[ShapeRow]:
    """Return the index of shapes in the folder of a collection."""
    return RowFile(folder / SHAPES_FILE, ShapeRow)
