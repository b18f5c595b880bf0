"""The index of a collection: one row a pair and one a shape, as CSV files that any program reads."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeVar, get_type_hints

from clalign.errors import ResultError

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

    FILE: ClassVar[str] = "pairs.csv"

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

    FILE: ClassVar[str] = "shapes.csv"

    @property
    def ok(self) -> bool:
        """Whether the shape could be prepared."""
        return self.status == "ok"


Row = TypeVar("Row", PairRow, ShapeRow)


def plain(row: PairRow) -> dict[str, Any]:
    """Return a row as values that JSON can write; `PairRow(**plain(row))` is the row."""
    return asdict(row)


def read_rows(kind: type[Row], folder: Path) -> list[Row]:
    """Return the complete rows of an index file, the last one of each pair or shape; none without a file.

    Raises
    ------
    ResultError
        The file is of another kind.
    """
    path = folder / kind.FILE
    if not path.is_file() or not path.stat().st_size:
        return []
    # Line by line, as no cell holds a line break: a line that was cut inside quotes must not swallow the next one.
    lines = [next(csv.reader([line])) for line in path.read_text(encoding="utf-8").split("\n") if line]
    if lines[0] != _columns(kind):
        raise ResultError(f"{path}: was not written by this version of clalign; choose another --out")
    return [_row(kind, cells) for cells in lines[1:] if len(cells) == len(lines[0])]


def append_row(row: PairRow, folder: Path) -> None:
    """Add a row to the index and force it to the disk."""
    path = folder / row.FILE
    text = _text([] if path.is_file() and path.stat().st_size else [_columns(type(row))], [row])
    with path.open("a+b") as stream:
        # A line that a kill cut short must not swallow the next one.
        if stream.tell():
            stream.seek(-1, os.SEEK_END)
            text = text if stream.read(1) == b"\n" else "\n" + text
        stream.write(text.encode())
        stream.flush()
        os.fsync(stream.fileno())


def write_rows(kind: type[Row], rows: Sequence[Row], folder: Path) -> None:
    """Write the whole index anew; the earlier one is replaced at once."""
    path = folder / kind.FILE
    unfinished = folder / f".{kind.FILE}.{os.getpid()}"
    with unfinished.open("wb") as stream:
        stream.write(_text([_columns(kind)], rows).encode())
        stream.flush()
        os.fsync(stream.fileno())
    os.replace(unfinished, path)


def _columns(kind: type[Any]) -> list[str]:
    return [item.name for item in fields(kind) if item.metadata.get("stored", True)]


def _text(head: Iterable[Sequence[str]], rows: Sequence[PairRow] | Sequence[ShapeRow]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows(head)
    for row in rows:
        writer.writerow([_cell(getattr(row, name)) for name in _columns(type(row))])
    return text.getvalue()


def _cell(value: Any) -> str:
    if value is None:
        return ""
    # A line break inside a cell is good CSV, but a cut line could then not be told from a whole one.
    return f"{value:.9g}" if isinstance(value, float) else " ".join(str(value).split())


def _row(kind: type[Row], cells: Sequence[str]) -> Row:
    hints = get_type_hints(kind)
    values: dict[str, Any] = {}
    for name, cell in zip(_columns(kind), cells, strict=True):
        if hints[name] == float | None:
            values[name] = float(cell) if cell else None
        elif hints[name] == int | None:
            values[name] = int(cell) if cell else None
        else:
            values[name] = cell
    return kind(**values)
