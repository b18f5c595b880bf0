"""VTK's legacy files (.vtk), text or binary: PolyData, and the surface cells of unstructured grids.

meshio reads no PolyData, which most surfaces are saved as, and no `.vtp`; so these files are read here.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clalign.mesh.reading.common import NO_FACES, FileMesh, FormatError, damage_in_a_sentence, fan, shown, strip, strips

Ints = NDArray[np.int64]

TYPES = {
    **dict.fromkeys((b"char", b"vtktypeint8"), "i1"),
    b"unsigned_char": "u1",
    b"short": "i2",
    b"unsigned_short": "u2",
    b"int": "i4",
    b"unsigned_int": "u4",
    b"float": "f4",
    b"double": "f8",
    # VTK's idtype is written in binary with four bytes.
    b"vtkidtype": "i4",
    **dict.fromkeys((b"long", b"vtktypeint64"), "i8"),
    **dict.fromkeys((b"unsigned_long", b"vtktypeuint64"), "u8"),
}
TRIANGLE, STRIP, POLYGON, PIXEL, QUAD = 5, 6, 7, 8, 9
FLAT = 4
"""Cells of types up to this one are points and lines."""


def read_vtk(content: bytes, folder: Path) -> FileMesh:
    """Read the points, polygons and triangle strips."""
    header = re.match(rb"# vtk DataFile Version (\d+)[^\n]*\n[^\n]*\n\s*(ASCII|BINARY)\s", content, re.IGNORECASE)
    if header is None:
        raise FormatError("has no VTK header, so it is no VTK file; is the suffix right? Otherwise export it again")
    with damage_in_a_sentence():
        return _dataset(_Cursor(content, header.end(), header[2].upper() == b"BINARY"), int(header[1]) >= 5)


def surface_cells(types: Ints, sizes: Ints, corners: Ints) -> tuple[Ints, tuple[str, ...]]:
    """Make triangles of the cells of an unstructured grid.

    Parameters
    ----------
    types, sizes : (cells,) VTK's number of the kind of each cell, and how many points it has.
    corners : the points of all cells, one after the other.

    Returns
    -------
    faces, notes : (m, 3), and a note on cells that were left out.

    Raises
    ------
    FormatError
        There are solid cells and no surface.
    """
    surface = np.isin(types, (TRIANGLE, STRIP, POLYGON, PIXEL, QUAD))
    others = int((types[~surface] > FLAT).sum())
    if others and not surface.any():
        raise FormatError(
            "holds solid or curved cells and no triangles; extract its surface first (in ParaView: Extract Surface)"
        )
    ends = np.cumsum(sizes)
    cells = [corners[ends[cell] - sizes[cell] : ends[cell]] for cell in np.flatnonzero(surface & (types != TRIANGLE))]
    faces: list[Ints] = []
    at = np.flatnonzero(types == TRIANGLE)
    faces.append(corners[(ends[at] - 3)[:, None] + np.arange(3)])
    for kind, cell in zip(types[surface & (types != TRIANGLE)].tolist(), cells, strict=True):
        if kind == STRIP:
            faces.append(strip(cell))
        else:
            faces.append(fan(np.array([len(cell)]), cell[[0, 1, 3, 2]] if kind == PIXEL else cell))
    what = "1 cell that is no triangle or polygon was" if others == 1 else f"{others} cells that are no polygons were"
    note = f"{what} left out"
    return np.concatenate([NO_FACES, *faces]).astype(np.int64), (note,) if others else ()


def _dataset(cursor: _Cursor, split: bool) -> FileMesh:
    """Read the sections up to the values of points and cells.

    split : cells come as offsets and points (version 5), not as counts and points in one list.
    """
    points, faces = np.zeros((0, 3)), [NO_FACES]
    notes: tuple[str, ...] = ()
    cells: tuple[Ints, Ints] = (np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))
    while (words := cursor.words()) and words[0] not in (b"POINT_DATA", b"CELL_DATA"):
        match words:
            case [b"DATASET", kind] if kind.upper() not in (b"POLYDATA", b"UNSTRUCTURED_GRID"):
                raise FormatError(
                    f"holds a data set of the kind {shown(kind)}, which is no surface mesh; save its surface as "
                    "PolyData (in ParaView: Extract Surface)"
                )
            case [b"POINTS", count, kind]:
                points = cursor.numbers(3 * int(count), kind).reshape(-1, 3).astype(np.float64)
            case [b"POLYGONS" | b"TRIANGLE_STRIPS" | b"CELLS" | b"VERTICES" | b"LINES", count, size]:
                cells = cursor.cells(int(count), int(size), split)
                if words[0] == b"POLYGONS":
                    faces.append(fan(*cells))
                if words[0] == b"TRIANGLE_STRIPS":
                    faces += strips(*cells)
            case [b"CELL_TYPES", count]:
                triangles, notes = surface_cells(cursor.numbers(int(count), b"int").astype(np.int64), *cells)
                faces.append(triangles)
            case [b"FIELD", _, count]:
                for _ in range(int(count)):
                    _, width, rows, kind = cursor.words()
                    cursor.numbers(int(width) * int(rows), kind)
    return FileMesh(points, np.concatenate(faces), notes)


class _Cursor:
    """A place in the file, from which lines of words or numbers are taken."""

    def __init__(self, content: bytes, at: int, binary: bool) -> None:
        self.content, self.at, self.binary = content, at, binary

    def words(self) -> list[bytes]:
        """Return the words of the next line that is not blank, the first in capitals; none at the end."""
        while self.at < len(self.content):
            words = self._line().split()
            if words:
                return [words[0].upper(), *words[1:]]
        return []

    def numbers(self, count: int, kind: bytes) -> NDArray[np.number]:
        """(count,) numbers of a type that is named as VTK does."""
        dtype = np.dtype(TYPES[kind.lower()])
        if self.binary:
            values = np.frombuffer(self.content, dtype.newbyteorder(">"), count, self.at)
            self.at += values.nbytes
            return values
        words: list[bytes] = []
        while len(words) < count:
            if self.at >= len(self.content):
                raise FormatError(f"ends before the last of {count} numbers; the file is truncated; export it again")
            words += self._line().split()
        return np.array(words, dtype=np.float64 if dtype.kind == "f" else np.int64)[:count]

    def cells(self, count: int, size: int, split: bool) -> tuple[Ints, Ints]:
        """Sizes (cells,) and points of the cells, one after the other."""
        if split:
            parts = [self.numbers(length, self.words()[1]).astype(np.int64) for length in (count, size)]
            return _checked(np.diff(parts[0]), parts[1])
        flat = self.numbers(size, b"int").astype(np.int64)
        if count > size:
            raise FormatError(f"promises {count} cells in {size} numbers; the file is damaged; export it again")
        sizes = np.zeros(count, dtype=np.int64)
        at = 0
        for cell in range(count):
            sizes[cell] = flat[at]
            at += int(sizes[cell]) + 1
        heads = np.cumsum(sizes + 1) - (sizes + 1)
        return _checked(sizes, np.delete(flat, heads))

    def _line(self) -> bytes:
        end = self.content.find(b"\n", self.at)
        end = len(self.content) if end < 0 else end
        line, self.at = self.content[self.at : end], end + 1
        return line


def _checked(sizes: Ints, corners: Ints) -> tuple[Ints, Ints]:
    """Refuse lengths that do not fit the list of points."""
    if (sizes < 0).any() or sizes.sum() != len(corners):
        raise FormatError("its cells have other sizes than it says; the file is damaged; export it again")
    return sizes, corners
