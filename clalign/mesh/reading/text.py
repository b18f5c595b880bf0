"""OFF, OBJ, and lists of points.

trimesh splits an OBJ at the seams of its texture; read here, it keeps its numbering, and a bad face is named by its
number instead of being dropped or wrapped.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clalign.mesh.reading import rows as text_rows
from clalign.mesh.reading.common import NO_FACES, FileMesh, FormatError, named, shown
from clalign.mesh.reading.rows import text_lines

UNIT_NORMAL = 0.05
"""Columns 4 to 6 of points are normals if their lengths are within this of 1; colours would not be."""


def read_off(content: bytes, folder: Path) -> FileMesh:
    """OFF and its variants with colours or normals (COFF, NOFF, STOFF, ...): positions are the first three numbers.

    The counts may follow OFF without a blank, as in ModelNet40.
    """
    lines = text_lines(content)
    header = re.match(rb"(?:ST)?C?N?(4?n?)(?:OFF|off)(?![A-Za-z_])\s*(?P<rest>.*)", lines[0] if lines else b"")
    if header is None:
        raise FormatError(
            "does not begin with OFF, so it is no OFF file; is the suffix right? Otherwise export it again"
        )
    if header[1] or header["rest"].upper().startswith(b"BINARY"):
        raise FormatError("is an OFF variant (4OFF, nOFF or binary) that is not read; export it as plain OFF or PLY")
    rows = ([header["rest"]] if header["rest"] else []) + lines[1:]
    counts = rows[0].split() if rows else []
    if len(counts) < 2 or not all(re.fullmatch(rb"\d{1,15}", word) for word in counts[:2]):
        raise FormatError("has no line with the counts of vertices and faces after OFF; export it again")
    n_vertices, n_faces = int(counts[0]), int(counts[1])
    if len(rows) - 1 != n_vertices + n_faces:
        raise FormatError(
            f"its header promises {n_vertices} vertices and {n_faces} faces, but {len(rows) - 1} lines follow; "
            "the file is truncated or its counts are wrong; export it again"
        )
    vertex_rows = [row.split() for row in rows[1 : n_vertices + 1]]
    text_rows.same_width(vertex_rows)
    vertices = text_rows.numbers([words[:3] for words in vertex_rows], 3, "three")
    polygons = [text_rows.corners(row.split(), number) for number, row in enumerate(rows[n_vertices + 1 :])]
    return FileMesh(vertices, text_rows.triangles(polygons))


def read_obj(content: bytes, folder: Path) -> FileMesh:
    """OBJ: the `v` lines in their order, and the first number of every corner of the `f` lines.

    Objects and groups (`o`, `g`) are read as one mesh. Normals are kept if there is one for every vertex, with the
    same number.
    """
    lines = text_lines(content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" "))
    positions: list[list[bytes]] = []
    normals: list[list[bytes]] = []
    polygons: list[list[bytes]] = []
    seen: list[int] = []
    names = [b""]
    object_of: list[int] = []
    for line in lines:
        words = line.split()
        if words[0] == b"v":
            positions.append(words[1:4])
        elif words[0] == b"vn":
            normals.append(words[1:4])
        elif words[0] in (b"o", b"g"):
            names.append(b" ".join(words[1:]))
        elif words[0] == b"f":
            if len(words) < 4:
                raise FormatError(
                    f"face {len(polygons)} is given as {shown(line)}: a face needs three corners; "
                    "mend or remove that line"
                )
            polygons.append(words[1:])
            seen.append(len(positions))
            object_of.append(len(names) - 1)
    if not positions and not polygons:
        raise FormatError(
            "has neither vertices (`v` lines) nor faces (`f` lines), so it is no OBJ mesh; is the suffix right? "
            "Otherwise export it again"
        )
    vertices = text_rows.numbers(positions, 3, "three")
    triangles = text_rows.triangles([[word.partition(b"/")[0] for word in polygon] for polygon in polygons])
    cuts = [len(polygon) - 2 for polygon in polygons]
    before = np.repeat(np.array(seen, dtype=np.int64), cuts)
    # Positive numbers count from 1, negative ones backward from the last vertex above the face; 0 names no vertex.
    faces = np.where(triangles > 0, triangles - 1, np.where(triangles < 0, before[:, None] + triangles, -1))
    notes = _object_notes(names, np.repeat(np.array(object_of, dtype=np.int64), cuts), faces)
    return FileMesh(vertices, faces, notes, _obj_normals(normals, len(positions), polygons))


def _object_notes(names: list[bytes], object_of: NDArray[np.int64], faces: NDArray[np.int64]) -> tuple[str, ...]:
    """Name the objects that have faces, if there is more than one; a name that comes back goes on with its object."""
    words = [name.decode("utf-8", errors="replace") or "without a name" for name in names]
    numbers: dict[str, list[int]] = {}
    for number in np.unique(object_of).tolist():
        numbers.setdefault(words[number], []).append(number)
    if len(numbers) < 2:
        return ()
    counts = [(name, len(np.unique(faces[np.isin(object_of, these)]))) for name, these in numbers.items()]
    return (f"the file has {len(counts)} objects or groups, read as one mesh: {named(counts)}",)


def _obj_normals(rows: list[list[bytes]], count: int, polygons: list[list[bytes]]) -> NDArray[np.float64] | None:
    """(n, 3) normals of the vertices; None if they belong to corners, or are no numbers."""
    if not rows or len(rows) != count or not all(text_rows.holds_numbers(row, 3) for row in rows):
        return None
    corners = (word.split(b"/") for polygon in polygons for word in polygon)
    if any(len(numbers) < 3 or numbers[2] != numbers[0] for numbers in corners):
        return None
    return text_rows.numbers(rows, 3, "three")


def read_points(content: bytes, folder: Path) -> FileMesh:
    """Rows of three numbers, or of six with normals; blanks or commas between them, the count on top in some files."""
    lines = text_lines(content)
    if lines and re.fullmatch(rb"\d+", lines[0]):
        if int(lines[0]) != len(lines) - 1:
            raise FormatError(
                f"its first line promises {shown(lines[0])} points, but {len(lines) - 1} lines follow; export it again"
            )
        lines = lines[1:]
    rows = [_point_words(line) for line in lines]
    width = len(rows[0]) if rows else 0
    if width not in (3, 6):
        raise FormatError(
            f"its first row is {shown(lines[0] if lines else b'')}: points are given as three numbers a line, or six "
            "with normals; export it again"
        )
    text_rows.same_width(rows)
    values = text_rows.numbers(rows, width, "three" if width == 3 else "six")
    if width == 3:
        return FileMesh(values, NO_FACES)
    lengths = np.linalg.norm(values[:, 3:], axis=1)
    if bool((np.abs(lengths - 1.0) <= UNIT_NORMAL).all()):
        return FileMesh(values[:, :3].copy(), NO_FACES, normals=values[:, 3:].copy())
    note = "columns 4 to 6 are no vectors of length 1, so they were not taken for normals"
    return FileMesh(values[:, :3].copy(), NO_FACES, (note,))


def _point_words(line: bytes) -> list[bytes]:
    """Split at blanks, or at commas where these separate; a decimal comma stays, and is then no number."""
    separated = b"," in line and (b", " in line or not re.search(rb"\s", line))
    return [word.strip() for word in line.split(b",")] if separated else line.split()
