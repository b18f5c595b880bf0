"""VTK's XML files: PolyData (.vtp), and the surface cells of unstructured grids (.vtu).

Arrays are text, or binary in base64 where they belong, or appended to the document (raw or base64), all of the binary
ones with or without compression.
"""

from __future__ import annotations

import base64
import lzma
import re
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from clalign.mesh.reading.common import NO_FACES, FileMesh, FormatError, Part, damage_in_a_sentence, fan, joined, strips
from clalign.mesh.reading.vtk import surface_cells

TYPES = {f"{kind}{bits}": f"{kind[0].lower()}{bits // 8}" for kind in ("Int", "UInt") for bits in (8, 16, 32, 64)}
TYPES |= {"Float32": "f4", "Float64": "f8"}
COMPRESSORS: dict[str, Callable[[bytes], bytes]] = {
    "vtkZLibDataCompressor": zlib.decompress,
    "vtkLZMADataCompressor": lzma.decompress,
}


def read_vtk_xml(content: bytes, folder: Path) -> FileMesh:
    """Read the points, polygons and triangle strips of all pieces."""
    if b"<VTKFile" not in content[:4096]:
        raise FormatError("is no VTK file in XML; is the suffix right? Otherwise export it again")
    with damage_in_a_sentence():
        # What is appended is no XML, and is cut off first.
        cut = re.search(rb"<AppendedData[^>]*encoding\s*=\s*[\"'](\w+)[\"'][^>]*>\s*_", content)
        text = content if cut is None else content[: cut.start()] + b"</VTKFile>"
        root = ElementTree.fromstring(text)
        kind = root.get("type", "")
        if kind not in ("PolyData", "UnstructuredGrid"):
            raise FormatError(f"holds {kind!r}, which is no surface mesh; save its surface as PolyData (.vtp)")
        appended = (b"", True) if cut is None else (content[cut.end() :], cut[1] == b"base64")
        arrays = _Arrays(
            root.get("byte_order", ""), root.get("header_type", "UInt32"), root.get("compressor"), *appended
        )
        notes: tuple[str, ...] = ()
        parts = []
        for number, piece in enumerate(root.iterfind(f"{kind}/Piece")):
            points = arrays.values(piece.find("Points/DataArray")).reshape(-1, 3).astype(np.float64)
            faces, left_out = _faces(arrays, piece)
            parts.append(Part(f"piece {number}", points, faces))
            notes += left_out
    mesh = joined(parts, "pieces")
    return FileMesh(mesh.vertices, mesh.faces, mesh.notes + notes)


def _faces(arrays: _Arrays, piece: ElementTree.Element) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """(m, 3) triangles of a piece, and notes on cells that were left out."""
    cells = piece.find("Cells")
    if cells is not None:
        types = arrays.values(cells.find("DataArray[@Name='types']")).astype(np.int64)
        return surface_cells(types, *_cells(arrays, cells))
    found = [NO_FACES]
    for name in ("Polys", "Strips"):
        table = piece.find(name)
        if table is not None and table.find("DataArray") is not None:
            sizes, corners = _cells(arrays, table)
            found += [fan(sizes, corners)] if name == "Polys" else strips(sizes, corners)
    return np.concatenate(found), ()


def _cells(arrays: _Arrays, table: ElementTree.Element) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Sizes (cells,) and points of all cells, one after the other."""
    corners = arrays.values(table.find("DataArray[@Name='connectivity']")).astype(np.int64)
    ends = arrays.values(table.find("DataArray[@Name='offsets']")).astype(np.int64)
    sizes = np.diff(ends, prepend=0)
    if (sizes < 0).any() or sizes.sum() != len(corners):
        raise FormatError("its cells have other sizes than it says; the file is damaged; export it again")
    return sizes, corners


@dataclass(frozen=True)
class _Arrays:
    """How the arrays of one file are written."""

    byte_order: str
    header_type: str
    compressor: str | None
    appended: bytes
    """What follows the document."""
    encoded: bool
    """Whether that is base64."""

    def values(self, element: ElementTree.Element | None) -> NDArray[np.number]:
        """(n,) numbers of a DataArray.

        Raises
        ------
        FormatError
            There is no such array, or it is shorter than it says, or written in an unknown way.
        """
        if element is None:
            raise FormatError("lacks an array of points or cells; export it again")
        dtype = self._ordered(element.get("type", ""))
        form, text = element.get("format", "ascii"), (element.text or "").strip().encode()
        if form == "ascii":
            return np.array(text.split(), dtype=np.float64 if dtype.kind == "f" else np.int64)
        if form == "appended":
            data = self._decoded(self.appended[int(element.get("offset", "0")) :], self.encoded)
        else:
            data = self._decoded(text, True)
        return np.frombuffer(data, dtype)

    def _ordered(self, name: str) -> np.dtype[Any]:
        return np.dtype(TYPES[name]).newbyteorder(">" if self.byte_order == "BigEndian" else "<")

    def _decoded(self, raw: bytes, encoded: bool) -> bytes:
        """Return the bytes of one array: after a header with their number, or with those of compressed blocks."""
        kind = self._ordered(self.header_type)
        width = kind.itemsize
        if self.compressor is None:
            begin = _Bytes(raw, encoded)
            size = int(np.frombuffer(begin.take(width), kind)[0])
            # Some programs encode the header alone, which then ends in padding, others together with the data.
            return begin.take(size) if begin.padded or not encoded else _Bytes(raw, True).take(width + size)[width:]
        if self.compressor not in COMPRESSORS:
            raise FormatError(f"is compressed with {self.compressor}, which is not read; save it with zlib or without")
        blocks = int(np.frombuffer(_Bytes(raw, encoded).take(3 * width), kind)[0])
        stream = _Bytes(raw, encoded)
        sizes = np.frombuffer(stream.take((3 + blocks) * width), kind)[3:].astype(np.int64)
        data, ends = stream.take(int(sizes.sum())), np.cumsum(sizes)
        return b"".join(
            COMPRESSORS[self.compressor](data[end - size : end]) for end, size in zip(ends, sizes, strict=True)
        )


class _Bytes:
    """Bytes taken one after the other, decoded if they are base64."""

    def __init__(self, raw: bytes, encoded: bool) -> None:
        self.raw, self.encoded, self.padded, self.at = raw, encoded, False, 0

    def take(self, count: int) -> bytes:
        """Return the next bytes, which in base64 begin and end with a group of letters."""
        length = 4 * -(-count // 3) if self.encoded else count
        piece = self.raw[self.at : self.at + length]
        self.at += length
        self.padded = piece.endswith(b"=")
        data = base64.b64decode(piece)[:count] if self.encoded else piece
        if len(data) < count:
            raise FormatError("ends within an array; the file is truncated; export it again")
        return data
