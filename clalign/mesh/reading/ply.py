"""PLY, text or binary of either endianness: the vertices, and faces of any sizes."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clalign.mesh.reading import rows as text_rows
from clalign.mesh.reading.common import NO_FACES, FileMesh, FormatError, doubles, fan, shown, strip

TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("long", "int64"), "i8"),
    **dict.fromkeys(("ulong", "uint64"), "u8"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
FACE_LISTS = ("vertex_indices", "vertex_index")
PADDING = b" \t\r\n\0\x1a"
"""Bytes that programs leave behind the last element."""


@dataclass(frozen=True)
class Property:
    """A number of every row of an element, or a list of numbers."""

    name: str
    type: str
    """Its type as numpy has it, without the byte order."""
    count_type: str | None
    """The type of a list's length; None for a single number."""


@dataclass(frozen=True)
class Element:
    """A table of the file: `count` rows of the properties."""

    name: str
    count: int
    properties: tuple[Property, ...]

    def position(self, name: str) -> int | None:
        """Return the place of a property among the properties."""
        return next((place for place, p in enumerate(self.properties) if p.name == name), None)

    def list_position(self) -> int | None:
        """Return the place of the list of vertices: by its usual name, else the first list."""
        lists = [place for place, p in enumerate(self.properties) if p.count_type is not None]
        return next((place for place in lists if self.properties[place].name in FACE_LISTS), next(iter(lists), None))


@dataclass(frozen=True)
class Columns:
    """What an element holds, as far as it is needed."""

    numbers: dict[str, NDArray[np.float64]]
    """(count,) of each property that was asked for."""
    sizes: NDArray[np.int64]
    """(count,) lengths of the list of vertices."""
    corners: NDArray[np.int64]
    """All its numbers, one list after the other."""


def read_ply(content: bytes, folder: Path) -> FileMesh:
    """Read positions, normals if there are any, and faces or triangle strips."""
    order, elements, start = ply_header(content)
    body = content[start:]
    counts = {element.name: element.count for element in elements}
    promise = f"its header promises {counts['vertex']} vertices and {counts.get('face', 0)} faces"
    # Every number takes at least a byte: counts beyond that would only make numpy ask for absurd memory.
    if sum(element.count * max(len(element.properties), 1) for element in elements) > len(body):
        raise FormatError(
            f"{promise}, more than the file can hold; the file is truncated or its counts are wrong; export it again"
        )
    tables = _binary_tables(body, elements, order, promise) if order else _text_tables(body, elements, promise)
    numbers = tables["vertex"].numbers
    vertices = np.stack([numbers[axis] for axis in ("x", "y", "z")], axis=1)
    normals = None
    if all(axis in numbers for axis in ("nx", "ny", "nz")):
        normals = np.stack([numbers[axis] for axis in ("nx", "ny", "nz")], axis=1)
    return FileMesh(vertices, _faces(tables), normals=normals)


def _faces(tables: dict[str, Columns]) -> NDArray[np.int64]:
    """(m, 3) triangles of the faces, or of the strips if there are no faces."""
    faces, strips = tables.get("face"), tables.get("tristrips")
    if faces is not None and len(faces.sizes):
        few = np.flatnonzero(faces.sizes < 3)
        if len(few):
            raise FormatError(
                f"face {few[0]} has {faces.sizes[few[0]]} corners where 3 or more are needed; "
                "remove it, or export the mesh again"
            )
        return fan(faces.sizes, faces.corners)
    if strips is None:
        return NO_FACES
    ends = np.flatnonzero(np.append(strips.corners, -1) < 0)
    pieces = [strip(part[part >= 0]) for part in np.split(strips.corners, ends)]
    triangles = np.concatenate([NO_FACES, *pieces])
    # A strip turns a corner by naming a vertex twice.
    a, b, c = triangles.T
    return triangles[(a != b) & (b != c) & (c != a)]


def ply_header(content: bytes) -> tuple[str, list[Element], int]:
    """Return the byte order ("" for text), the elements, and where the body begins."""
    if not content.startswith(b"ply"):
        raise FormatError("has no PLY header, so it is no PLY file; is the suffix right? Otherwise export it again")
    newline = re.match(rb"ply[ \t]*(\r\n|\n|\r|$)", content)
    ending = newline[1] if newline and newline[1] else b"\n"
    # The body begins right after one newline, and may begin with a byte that looks like another.
    end = re.search(rb"[\r\n]end_header[ \t]*(?:" + ending + rb"|\r?\n|\r|$)", content)
    if end is None:
        raise FormatError("its PLY header has no end (end_header), so the file is truncated; export it again")
    order: str | None = None
    elements: list[Element] = []
    for line in content[: end.start()].decode("latin-1").splitlines()[1:]:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format":
            order = ORDERS.get(words[1]) if len(words) > 1 else None
        elif words[0] == "element" and len(words) == 3 and re.fullmatch(r"\d{1,15}", words[2]):
            elements.append(Element(words[1], int(words[2]), ()))
        elif words[0] == "property" and elements:
            last = elements[-1]
            elements[-1] = Element(last.name, last.count, (*last.properties, _property(words, line)))
        else:
            raise _no_header_line(line)
    if order is None:
        raise FormatError("its PLY header names no format that is known (text, or binary of either byte order)")
    vertex = next((element for element in elements if element.name == "vertex"), None)
    if vertex is None or len({element.name for element in elements}) < len(elements):
        raise FormatError("its header does not count vertices, or twice; export it as a triangle mesh")
    places = [vertex.position(axis) for axis in ("x", "y", "z")]
    if any(place is None or vertex.properties[place].count_type is not None for place in places):
        raise FormatError("its vertices have no numbers x, y and z; export it again")
    for element in elements:
        if element.name in ("face", "tristrips") and element.count and element.list_position() is None:
            raise FormatError(f"its element {shown(element.name)} has no list of vertices; export it again")
    return order, elements, end.end()


def _property(words: list[str], line: str) -> Property:
    if len(words) == 3 and words[1] in TYPES:
        return Property(words[2], TYPES[words[1]], None)
    is_list = len(words) == 5 and words[1] == "list" and {words[2], words[3]} <= TYPES.keys()
    if is_list and TYPES[words[2]][0] in "iu":
        return Property(words[4], TYPES[words[3]], TYPES[words[2]])
    raise _no_header_line(line)


def _no_header_line(line: str) -> FormatError:
    return FormatError(f"its PLY header has the line {shown(line)}, which says nothing known; export it again")


def _wanted(element: Element) -> list[int]:
    """Places of the numbers that are read: positions and normals of the vertices."""
    names = ("x", "y", "z", "nx", "ny", "nz") if element.name == "vertex" else ()
    return [place for place, p in enumerate(element.properties) if p.name in names and p.count_type is None]


def _text_tables(body: bytes, elements: list[Element], promise: str) -> dict[str, Columns]:
    """One row a line; the first row that is not what the header says is named."""
    rows = [line.split() for line in body.splitlines() if line.strip()]
    if len(rows) != sum(element.count for element in elements):
        raise FormatError(
            f"{promise}, but {len(rows)} lines follow; the file is truncated or its counts are wrong; export it again"
        )
    tables: dict[str, Columns] = {}
    first = 0
    for element in elements:
        tables[element.name] = _text_columns(rows[first : first + element.count], element)
        first += element.count
    return tables


def _text_columns(rows: list[list[bytes]], element: Element) -> Columns:
    none = np.zeros(0, dtype=np.int64)
    if element.name == "vertex":
        return Columns(_text_numbers(rows, element), none, none)
    place = element.list_position()
    if place is None or element.name not in ("face", "tristrips"):
        return Columns({}, none, none)
    lists = [_text_list(row, element.properties[:place], number) for number, row in enumerate(rows)]
    sizes = np.array([len(words) for words in lists], dtype=np.int64)
    flat = [text_rows.integer(word, "face", number) for number, words in enumerate(lists) for word in words]
    return Columns({}, sizes, np.array(flat, dtype=np.int64))


def _text_numbers(rows: list[list[bytes]], element: Element) -> dict[str, NDArray[np.float64]]:
    """Positions and normals of the vertices, by name."""
    wanted, width = _wanted(element), len(element.properties)
    if any(p.count_type is not None for p in element.properties):
        kept = [_numbers_beside_lists(row, element, number) for number, row in enumerate(rows)]
    else:
        for number, row in enumerate(rows):
            if not text_rows.holds_numbers(row, width):
                raise text_rows.misgiven(number, row, str(width))
        text_rows.same_width(rows)
        kept = [[row[place] for place in wanted] for row in rows]
    values = text_rows.numbers(kept, len(wanted), str(width))
    return {element.properties[place].name: values[:, column] for column, place in enumerate(wanted)}


def _numbers_beside_lists(row: list[bytes], element: Element, number: int) -> list[bytes]:
    """Return the words of positions and normals in a row with lists."""
    wanted, at, kept = _wanted(element), 0, []
    for place, p in enumerate(element.properties):
        if at >= len(row):
            raise text_rows.misgiven(number, row, "more")
        if place in wanted:
            kept.append(row[at])
        at += 1 if p.count_type is None else 1 + max(text_rows.integer(row[at], "vertex", number), 0)
    return kept


def _text_list(row: list[bytes], before: tuple[Property, ...], number: int) -> list[bytes]:
    """Return the list of vertices of a row, which comes after the properties `before`."""
    at = 0
    for p in before:
        length = 0 if p.count_type is None or at >= len(row) else text_rows.integer(row[at], "face", number)
        at += 1 + max(length, 0)
    return text_rows.corners(row[at:], number)


def _binary_tables(body: bytes, elements: list[Element], order: str, promise: str) -> dict[str, Columns]:
    tables: dict[str, Columns] = {}
    at = 0
    for element in elements:
        try:
            offsets, sizes, at = element_offsets(body, at, element, order)
        except (struct.error, IndexError) as error:
            raise FormatError(
                f"{promise}, but the file ends before the last {element.name}; the file is truncated or its counts "
                "are wrong; export it again"
            ) from error
        tables[element.name] = _binary_columns(body, element, order, offsets, sizes)
    rest = len(body[at:].strip(PADDING))
    if rest:
        raise FormatError(f"{promise}, but {rest} bytes follow the last of them; its counts are wrong; export it again")
    return tables


def _binary_columns(
    body: bytes, element: Element, order: str, offsets: NDArray[np.int64], sizes: NDArray[np.int64]
) -> Columns:
    """Take the numbers that are needed from where they lie."""
    data = np.frombuffer(body, dtype=np.uint8)
    numbers = {}
    for wanted in _wanted(element):
        p = element.properties[wanted]
        numbers[p.name] = doubles(_gathered(data, offsets[:, wanted], order + p.type))
    place = element.list_position()
    none = np.zeros(0, dtype=np.int64)
    if place is None or element.name not in ("face", "tristrips"):
        return Columns(numbers, none, none)
    p, lengths = element.properties[place], sizes[:, place]
    width = np.dtype(p.type).itemsize
    within = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    corners = _gathered(data, np.repeat(offsets[:, place], lengths) + within * width, order + p.type)
    if p.type[0] == "f" and not (np.isfinite(corners) & (corners == np.floor(corners)) & (abs(corners) < 2**62)).all():
        raise FormatError("its faces contain something else than vertex numbers; export it again")
    return Columns(numbers, lengths, corners.astype(np.int64))


def _gathered(data: NDArray[np.uint8], starts: NDArray[np.int64], dtype: str) -> NDArray[np.number]:
    """(n,) numbers that begin at the given bytes."""
    kind = np.dtype(dtype)
    return data[starts[:, None] + np.arange(kind.itemsize)].view(kind)[:, 0]


def element_offsets(
    body: bytes, at: int, element: Element, order: str
) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """Where every property of every row begins (a list: its first number), lengths of lists, and the element's end.

    Returns
    -------
    offsets, sizes, end : (count, p), (count, p) and int; single numbers have size 1.

    Raises
    ------
    struct.error, IndexError
        The element goes on beyond the body.
    """
    count, p = element.count, len(element.properties)
    if not count or not p:
        return np.zeros((count, p), dtype=np.int64), np.zeros((count, p), dtype=np.int64), at
    first, sizes, end = _row(body, at, element, order)
    # Mostly all rows are alike: then the lengths of all lists are those of the first row, wherever they are read.
    starts = np.array(first, dtype=np.int64) + (end - at) * np.arange(count)[:, None]
    if at + (end - at) * count <= len(body) and _all_alike(body, starts, sizes, element, order):
        return starts, np.broadcast_to(np.array(sizes, dtype=np.int64), (count, p)), at + (end - at) * count
    offsets, lengths = [], []
    for _ in range(count):
        row_offsets, row_sizes, at = _row(body, at, element, order)
        offsets.append(row_offsets)
        lengths.append(row_sizes)
    return np.array(offsets, dtype=np.int64), np.array(lengths, dtype=np.int64), at


def _all_alike(body: bytes, starts: NDArray[np.int64], sizes: list[int], element: Element, order: str) -> bool:
    """Whether the lists of all rows have these lengths, if rows begin where they would then."""
    data = np.frombuffer(body, dtype=np.uint8)
    for place, p in enumerate(element.properties):
        if p.count_type is None:
            continue
        lengths = _gathered(data, starts[:, place] - np.dtype(p.count_type).itemsize, order + p.count_type)
        if not bool((lengths == sizes[place]).all()):
            return False
    return True


def _row(body: bytes, at: int, element: Element, order: str) -> tuple[list[int], list[int], int]:
    """Where the properties of the row at `at` begin, their lengths, and where the next row begins."""
    offsets, sizes = [], []
    for p in element.properties:
        size = 1
        if p.count_type is not None:
            (size,) = struct.unpack_from(order + _CODES[p.count_type], body, at)
            at += _WIDTHS[p.count_type]
            if size < 0:
                raise IndexError
        offsets.append(at)
        sizes.append(size)
        at += size * _WIDTHS[p.type]
    if at > len(body):
        raise IndexError
    return offsets, sizes, at


_CODES = {name: np.dtype(name).char for name in ("i1", "u1", "i2", "u2", "i4", "u4")} | {"i8": "q", "u8": "Q"}
_WIDTHS = {name: np.dtype(name).itemsize for name in set(TYPES.values())}
