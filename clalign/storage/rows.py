"""Tables that grow row by row and survive a kill at any moment, as CSV files that any program reads."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, Generic, TypeVar, get_type_hints

from clalign.errors import ResultError
from clalign.storage.files import replaced_file

Row = TypeVar("Row")


def append_rows(path: Path, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Add rows to a CSV file, below a header if it is new, and force them to the disk.

    A line that a kill cut short is removed first.
    """
    with path.open("a+b") as stream:
        if stream.tell() and stream.seek(-1, os.SEEK_END) >= 0 and stream.read(1) != b"\n":
            stream.seek(0)
            stream.truncate(stream.read().rfind(b"\n") + 1)
        begun = stream.seek(0, os.SEEK_END) > 0
        stream.write(_csv(rows if begun else [header, *rows]))
        stream.flush()
        os.fsync(stream.fileno())


def complete_rows(path: Path, header: Sequence[str]) -> list[list[str]]:
    """Return the complete rows of a CSV file of `append_rows`; none without a file.

    Raises
    ------
    ResultError
        The file has another header.
    """
    if not path.is_file():
        return []
    # Line by line, as no cell holds a line break: a line that was cut inside quotes must not swallow the next one.
    *lines, _ = path.read_text(encoding="utf-8", errors="surrogateescape").split("\n")
    rows = [next(csv.reader([line])) for line in lines if line]
    if rows and rows[0] != list(header):
        raise ResultError(f"{path}: was not written by this version of clalign; choose another --out")
    return [cells for cells in rows[1:] if len(cells) == len(header)]


class RowFile(Generic[Row]):
    """Rows of one dataclass in a CSV file that any program reads, one line each.

    Fields are texts, or int, float or bool or else None, which is an empty cell; those with ``"stored": False`` in
    their metadata are left out.

    Parameters
    ----------
    path : the file.
    kind : the dataclass.
    digits : of floats.
    """

    def __init__(self, path: Path, kind: type[Row], digits: int = 9) -> None:
        self.path, self.kind, self.digits = path, kind, digits
        stored: Any = kind
        self.header = [item.name for item in fields(stored) if item.metadata.get("stored", True)]

    def read(self) -> list[Row]:
        """Return the complete rows; see `complete_rows` for what is raised."""
        hints = get_type_hints(self.kind)
        return [
            self.kind(**{name: _value(hints[name], cell) for name, cell in zip(self.header, cells, strict=True)})
            for cells in complete_rows(self.path, self.header)
        ]

    def append(self, row: Row) -> None:
        """Add a row and force it to the disk."""
        append_rows(self.path, self.header, [self._cells(row)])

    def write(self, rows: Iterable[Row]) -> None:
        """Write the whole file anew; the earlier one is replaced at once."""
        with replaced_file(self.path, durable=True) as stream:
            stream.write(_csv([self.header, *map(self._cells, rows)]))

    def _cells(self, row: Row) -> list[str]:
        return [self._cell(getattr(row, name)) for name in self.header]

    def _cell(self, value: Any) -> str:
        if value is None:
            return ""
        # A line break inside a cell is good CSV, but a cut line could then not be told from a whole one.
        return f"{value:.{self.digits}g}" if isinstance(value, float) else " ".join(str(value).splitlines())


def _csv(rows: Iterable[Sequence[str]]) -> bytes:
    """Rows as UTF-8; bytes of file names that are none stay as they are, since rows are read back by these names."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode("utf-8", errors="surrogateescape")


def _value(hint: Any, cell: str) -> Any:
    if hint == bool | None and cell:
        return cell == "True"
    for kind in (bool, int, float):
        if hint == kind | None:
            return kind(cell) if cell else None
    return cell
