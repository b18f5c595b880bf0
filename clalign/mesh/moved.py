"""A mesh file with its vertices moved: everything else that it holds stays as it is.

Texture coordinates, materials, groups, polygons, colours, skin weights and labels belong to vertices and faces, and a
mesh whose vertices have moved still has them. Normals have no meaning any more: PLY's are computed anew, those of OBJ
are left out.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from clalign.errors import MeshError
from clalign.mesh.reading.common import FormatError
from clalign.mesh.reading.files import expanded, file_content, mesh_suffix
from clalign.mesh.reading.ply import Element, element_offsets, ply_header
from clalign.mesh.topology import vertex_normals

REWRITTEN = (".ply", ".obj")
"""Suffixes of the formats that are written so."""

_NAME = re.compile(r"[A-Za-z_]\w*")


def moved_file(
    path: str | os.PathLike[str],
    positions: NDArray[np.float64],
    faces: NDArray[np.integer],
    columns: Mapping[str, NDArray] | None = None,
) -> bytes:
    """Return the content of a PLY or OBJ file with other positions of its vertices.

    Parameters
    ----------
    path : the file.
    positions : (n, 3), one for every vertex of the file.
    faces : (m, 3), from which normals are computed where a PLY file has them.
    columns : (n,) further numbers for every vertex, whole or not; PLY alone holds such.

    Raises
    ------
    MeshError
        The file cannot be read, or its vertices cannot be rewritten.
    """
    path = expanded(path)
    suffix, content = mesh_suffix(path), file_content(path)
    try:
        if suffix == ".obj":
            return _moved_obj(content, positions)
        return moved_ply(content, positions, faces, columns or {})
    except FormatError as error:
        raise MeshError(f"{path}: {error}") from error


def _moved_obj(content: bytes, positions: NDArray[np.float64]) -> bytes:
    lines, number = [], 0
    for line in re.sub(rb"\\\r?\n", b" ", content).splitlines():
        words = line.split()
        kind = words[0] if words else b""
        if kind == b"vn":
            continue
        if kind == b"v":
            if number < len(positions):
                moved = " ".join(repr(value) for value in positions[number].tolist()).encode()
                # Behind the coordinates stand a weight or a colour.
                line = b" ".join([b"v", moved, *words[4:]])
            number += 1
        elif kind == b"f":
            line = b" ".join([b"f", *(_without_normal(word) for word in words[1:])])
        lines.append(line)
    if number != len(positions):
        raise FormatError(f"has {number} vertices where {len(positions)} were read; export it again")
    return b"\n".join(lines) + b"\n"


def _without_normal(corner: bytes) -> bytes:
    vertex, _, rest = corner.partition(b"/")
    texture = rest.partition(b"/")[0]
    return vertex + b"/" + texture if texture else vertex


def moved_ply(
    content: bytes, positions: NDArray[np.float64], faces: NDArray[np.integer], columns: Mapping[str, NDArray]
) -> bytes:
    """Return the bytes of a PLY file with other positions, and further columns, of its vertices; see `moved_file`."""
    order, elements, start = ply_header(content)
    vertex = next(element for element in elements if element.name == "vertex")
    if vertex.count != len(positions) or any(each.count_type is not None for each in vertex.properties):
        raise FormatError("its vertices hold lists, which cannot be written anew; export it without them")
    changed = {axis: positions[:, place] for place, axis in enumerate("xyz")}
    if all(vertex.position(f"n{axis}") is not None for axis in "xyz"):
        normals = vertex_normals(positions, faces)
        changed |= {f"n{axis}": normals[:, place] for place, axis in enumerate("xyz")}
    for name in columns:
        if not _NAME.fullmatch(name) or vertex.position(name) is not None:
            raise FormatError(f"vertices cannot have another column called {name!r}; use a word of its own")
    head = _with_columns(content[:start], vertex, columns)
    before = elements[: elements.index(vertex)]
    if order:
        return head + _binary_body(content[start:], before, vertex, order, changed, columns)
    return head + _text_body(content[start:], before, vertex, changed, columns)


def _with_columns(head: bytes, vertex: Element, columns: Mapping[str, NDArray]) -> bytes:
    """The header with lines for further columns behind the last property of the vertices."""
    if not columns:
        return head
    ending = b"\r\n" if b"\r\n" in head else b"\n"
    lines = head.split(ending)
    first = next(number for number, line in enumerate(lines) if line.split()[:2] == [b"element", b"vertex"])
    place, seen = first, 0
    while seen < len(vertex.properties):
        place += 1
        seen += lines[place].split()[:1] == [b"property"]
    kinds = {name: "int" if values.dtype.kind in "iub" else "double" for name, values in columns.items()}
    added = [f"property {kind} {name}".encode() for name, kind in kinds.items()]
    return ending.join([*lines[: place + 1], *added, *lines[place + 1 :]])


def _binary_body(
    body: bytes,
    before: list[Element],
    vertex: Element,
    order: str,
    changed: Mapping[str, NDArray],
    columns: Mapping[str, NDArray],
) -> bytes:
    at = 0
    for element in before:
        _, _, at = element_offsets(body, at, element, order)
    kinds = [(each.name, order + each.type) for each in vertex.properties]
    added = [(name, order + ("i4" if values.dtype.kind in "iub" else "f8")) for name, values in columns.items()]
    given = np.frombuffer(body, dtype=kinds, count=vertex.count, offset=at)
    rows = np.zeros(vertex.count, dtype=[*kinds, *added])
    for name, _ in kinds:
        rows[name] = changed.get(name, given[name])
    for name, values in columns.items():
        rows[name] = values
    return body[:at] + rows.tobytes() + body[at + given.nbytes :]


def _text_body(
    body: bytes,
    before: list[Element],
    vertex: Element,
    changed: Mapping[str, NDArray],
    columns: Mapping[str, NDArray],
) -> bytes:
    lines = [line for line in body.splitlines() if line.strip()]
    first = sum(element.count for element in before)
    for number in range(vertex.count):
        words = lines[first + number].split()
        for name, values in changed.items():
            words[vertex.position(name) or 0] = repr(float(values[number])).encode()
        words += [repr(values[number].item()).encode() for values in columns.values()]
        lines[first + number] = b" ".join(words)
    return b"\n".join(lines) + b"\n"
