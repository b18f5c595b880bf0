"""Reading mesh files with their vertex numbers kept.

trimesh keeps a file's numbering only for OFF and PLY: an OBJ with texture coordinates comes back split at the seams,
and an STL has no numbering at all. PLY and STL are read through trimesh's format functions and compared with the file's
own counts. OFF and OBJ are read here, which also lets a bad face be named by its number instead of being dropped or
wrapped.
"""

from __future__ import annotations

import io
import os
import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.errors import MeshError
from clalign.mesh.topology import merge_positions

SUFFIXES = (".off", ".ply", ".obj", ".stl")


@dataclass(frozen=True)
class FileMesh:
    """What a file says, unchecked: its vertices in file order, and its polygons as triangles."""

    vertices: NDArray[np.float64]
    """(n, 3) positions as in the file."""
    faces: NDArray[np.int64]
    """(m, 3) vertex numbers counted from 0; may be out of range."""
    notes: tuple[str, ...] = ()
    """What the reader did that the user should know."""


class _FormatError(Exception):
    """Why the bytes are not a file of their format; `read_mesh_file` puts the file's name to it."""


def read_mesh_file(path: str | os.PathLike[str]) -> FileMesh:
    """Read the vertices and triangles of an OFF, PLY, OBJ or STL file without checking the surface.

    Raises
    ------
    MeshError
        naming the file and the reason, if it is missing, unreadable, of another format, truncated or damaged.
    """
    path = Path(path)
    if os.path.isdir(path):
        raise MeshError(f"{path}: is a directory; name a mesh file in it ({', '.join(SUFFIXES)})")
    # A pipe or device could block for ever; what does not exist gets its own message when it is opened.
    if os.path.exists(path) and not os.path.isfile(path):
        raise MeshError(f"{path}: is not a regular file; save the mesh to a file first")
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise MeshError(
            f"{path}: {'unknown mesh format' if os.path.exists(path) else 'no such file, and not a mesh format'} "
            f"('{path.suffix}'); give a file of the kind {', '.join(SUFFIXES)}"
        )
    content = _file_content(path)
    if not content.strip():
        raise MeshError(f"{path}: the file is empty; export the mesh again")
    try:
        return reader(content)
    except _FormatError as error:
        raise MeshError(f"{path}: {error}") from error


def _file_content(path: Path) -> bytes:
    """Read all bytes, with the operating system's refusals put into words."""
    try:
        return path.read_bytes()
    except FileNotFoundError as error:
        raise MeshError(f"{path}: no such file; check the path (current folder: {Path.cwd()})") from error
    except PermissionError as error:
        raise MeshError(f"{path}: no permission to read it; change its access rights or copy it") from error
    except (OSError, ValueError) as error:
        raise MeshError(f"{path}: cannot be read ({error})") from error


def _read_off(content: bytes) -> FileMesh:
    """OFF and its variants with colours or normals (COFF, NOFF, STOFF, ...): positions are the first three numbers."""
    lines = _text_lines(content)
    header = re.match(rb"(?:ST)?C?N?(4?n?)(?:OFF|off)\b\s*(?P<rest>.*)", lines[0] if lines else b"")
    if header is None:
        raise _FormatError(
            "does not begin with OFF, so it is no OFF file; is the suffix right? Otherwise export it again"
        )
    if header[1] or header["rest"].upper().startswith(b"BINARY"):
        raise _FormatError("is an OFF variant (4OFF, nOFF or binary) that is not read; export it as plain OFF or PLY")
    rows = ([header["rest"]] if header["rest"] else []) + lines[1:]
    counts = rows[0].split() if rows else []
    if len(counts) < 2 or not all(re.fullmatch(rb"\d{1,15}", word) for word in counts[:2]):
        raise _FormatError("has no line with the counts of vertices and faces after OFF; export it again")
    n_vertices, n_faces = int(counts[0]), int(counts[1])
    if len(rows) - 1 != n_vertices + n_faces:
        raise _FormatError(
            f"its header promises {n_vertices} vertices and {n_faces} faces, but {len(rows) - 1} lines follow; "
            "the file is truncated or its counts are wrong; export it again"
        )
    vertex_rows = [row.split() for row in rows[1 : n_vertices + 1]]
    _same_width(vertex_rows)
    vertices = _positions([words[:3] for words in vertex_rows])
    polygons = [_corners(row, number) for number, row in enumerate(rows[n_vertices + 1 : n_vertices + n_faces + 1])]
    return FileMesh(vertices, _triangles(polygons))


def _corners(row: bytes, number: int) -> list[bytes]:
    """The vertex numbers of a face that is given as their count and themselves."""
    words = row.split()
    size = _integer(words[0], "face", number)
    if not 3 <= size < len(words):
        raise _FormatError(
            f"face {number} is given as {_shown(row)}: expected a count of 3 or more and as many "
            "numbers; mend that line, or export the mesh again"
        )
    return words[1 : size + 1]


def _read_obj(content: bytes) -> FileMesh:
    """OBJ: the `v` lines in their order, and the first number of every corner of the `f` lines."""
    lines = _text_lines(content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" "))
    positions: list[list[bytes]] = []
    polygons: list[list[bytes]] = []
    seen: list[int] = []
    for line in lines:
        words = line.split()
        if words[0] == b"v":
            positions.append(words[1:4])
        elif words[0] == b"f":
            if len(words) < 4:
                raise _FormatError(
                    f"face {len(polygons)} is given as {_shown(line)}: a face needs three corners; "
                    "mend or remove that line"
                )
            polygons.append([word.partition(b"/")[0] for word in words[1:]])
            seen.append(len(positions))
    if not positions and not polygons:
        raise _FormatError(
            "has neither vertices (`v` lines) nor faces (`f` lines), so it is no OBJ mesh; is the suffix right? "
            "Otherwise export it again"
        )
    vertices = _positions(positions)
    triangles = _triangles(polygons)
    before = np.repeat(np.array(seen, dtype=np.int64), [len(polygon) - 2 for polygon in polygons])
    # Positive numbers count from 1, negative ones backward from the last vertex above the face; 0 names no vertex.
    faces = np.where(triangles > 0, triangles - 1, np.where(triangles < 0, before[:, None] + triangles, -1))
    return FileMesh(vertices, faces)


def _read_ply(content: bytes) -> FileMesh:
    """PLY, text or binary, through trimesh; the counts are those of the header."""
    header_end = re.search(rb"end_header\r?\n?", content)
    if not content.startswith(b"ply"):
        raise _FormatError("has no PLY header, so it is no PLY file; is the suffix right? Otherwise export it again")
    if header_end is None:
        raise _FormatError("its PLY header has no end (end_header), so the file is truncated; export it again")
    header, body = content[: header_end.start()], content[header_end.end() :]
    elements = re.findall(rb"^\s*element\s+(\w+)\s+(\d{1,15})\s*$", header, re.MULTILINE)
    counts = {name: int(count) for name, count in elements}
    if not {b"vertex", b"face"} <= counts.keys():
        raise _FormatError("its header does not count vertices and faces; export it as a triangle mesh")
    n_vertices, n_faces = counts[b"vertex"], counts[b"face"]
    promise = f"its header promises {n_vertices} vertices and {n_faces} faces"
    # Every vertex takes at least three bytes: counts beyond that would only make the reader ask for absurd memory.
    if 3 * n_vertices + n_faces > len(body):
        raise _FormatError(
            f"{promise}, more than the file can hold; the file is truncated or its counts are wrong; export it again"
        )
    if re.search(rb"^\s*format\s+ascii", header, re.MULTILINE):
        rows = [line for line in body.splitlines() if line.strip()]
        if len(rows) != sum(counts.values()):
            raise _FormatError(
                f"{promise}, but {len(rows)} lines follow; the file is truncated or its counts are wrong; "
                "export it again"
            )
        _check_ply_rows(header, rows)
    # Comments may be in any encoding, which trimesh does not expect.
    plain_header = (header + header_end[0]).decode("ascii", errors="replace").encode("ascii", errors="replace")
    from trimesh.exchange.ply import load_ply

    loaded = _quietly(load_ply, plain_header + body, fix_texture=False, skip_materials=True)
    vertices, faces = _loaded_vertices(loaded), _loaded_faces(loaded)
    if len(vertices) != n_vertices or len(faces) < n_faces:
        raise _FormatError(
            f"{promise}, but {len(vertices)} vertices and {len(faces)} triangles could be read; the file is truncated, "
            "its counts are wrong, or it has faces with fewer than three corners; export it again"
        )
    return FileMesh(vertices, faces)


def _check_ply_rows(header: bytes, rows: list[bytes]) -> None:
    """Name the first row of a text PLY that is not what the header says; trimesh only says that something is wrong."""
    first = 0
    for element in re.split(rb"^\s*element\s+", header, flags=re.MULTILINE)[1:]:
        name, count = element.split()[:2]
        of_element = rows[first : first + int(count)]
        first += int(count)
        properties = re.findall(rb"^\s*property\s+(list\b)?", element, re.MULTILINE)
        if name == b"vertex" and not any(properties):
            for number, row in enumerate(of_element):
                if not _holds_numbers(row.split(), len(properties)):
                    raise _misgiven(number, row.split(), str(len(properties)))
            _same_width([row.split() for row in of_element])
        if name == b"face" and properties[:1] == [b"list"]:
            for number, row in enumerate(of_element):
                for word in _corners(row, number):
                    _integer(word, "face", number)


def _holds_numbers(words: list[bytes], wanted: int) -> bool:
    try:
        return len([float(word) for word in words]) >= wanted
    except ValueError:
        return False


def _misgiven(number: int, words: list[bytes], wanted: str) -> _FormatError:
    return _FormatError(
        f"vertex {number} is given as {_shown(b' '.join(words))}: expected {wanted} numbers; "
        "mend that line, or export the mesh again"
    )


def _read_stl(content: bytes) -> FileMesh:
    """STL, text or binary, through trimesh; corners at the same position become one vertex."""
    from trimesh.exchange.stl import load_stl

    n_facets = int.from_bytes(content[80:84], "little")
    if len(content) != 84 + 50 * n_facets:
        # Text may come in any encoding; only the name of the solid can contain more than ASCII.
        content = content.decode("ascii", errors="replace").encode("ascii", errors="replace")
        if not (content.lstrip().lower().startswith(b"solid") and b"facet" in content and b"endsolid" in content):
            raise _FormatError(
                f"is neither a whole text STL (solid ... endsolid) nor a binary one ({n_facets} facets would need "
                f"{84 + 50 * n_facets} bytes, the file has {len(content)}); it is truncated or has a wrong "
                "suffix; export it again"
            )
    loaded = _quietly(load_stl, content)
    corners, faces = _loaded_vertices(loaded), _loaded_faces(loaded)
    if not len(faces):
        raise _FormatError("has no facets, or is no STL file; is the suffix right? Otherwise export it again")
    first, vertex_of_corner = merge_positions(corners)
    note = (
        f"an STL file has no vertex numbers: its {len(corners)} corners were merged by position into {len(first)} "
        "vertices, numbered by first appearance"
    )
    return FileMesh(corners[first], vertex_of_corner[faces], (note,))


_READERS: dict[str, Callable[[bytes], FileMesh]] = {
    ".off": _read_off,
    ".obj": _read_obj,
    ".ply": _read_ply,
    ".stl": _read_stl,
}


def _text_lines(content: bytes) -> list[bytes]:
    """Lines without comments, blanks and byte-order mark."""
    content = content.removeprefix(b"\xef\xbb\xbf")
    if b"#" in content:
        content = re.sub(rb"#[^\r\n]*", b"", content)
    return [line for line in (raw.strip() for raw in content.splitlines()) if line]


def _same_width(rows: list[list[bytes]]) -> None:
    """Refuse a row unlike the first: with wrong counts in the header, faces would be read as vertices."""
    for number, words in enumerate(rows):
        if len(words) != len(rows[0]):
            raise _FormatError(
                f"vertex {number} is given as {_shown(b' '.join(words))}, {len(words)} numbers where vertex 0 has "
                f"{len(rows[0])}; the counts in the header may be wrong; export it again"
            )


def _positions(rows: list[list[bytes]]) -> NDArray[np.float64]:
    """(n, 3) positions from rows of three words; names the first row that is not three numbers."""
    try:
        return np.array(rows, dtype=np.float64).reshape(len(rows), 3)
    except ValueError:
        pass
    for number, row in enumerate(rows):
        if not _holds_numbers(row, 3):
            raise _misgiven(number, row, "three")
    raise _FormatError("its vertex positions are not numbers; export it again")


def _triangles(polygons: list[list[bytes]]) -> NDArray[np.int64]:
    """(m, 3) numbers from the words of each polygon, cut into a fan of triangles around its first corner."""
    sizes = np.array([len(polygon) for polygon in polygons], dtype=np.int64)
    try:
        flat = np.array([word for polygon in polygons for word in polygon]).astype(np.int64)
    except (ValueError, OverflowError):
        flat = np.array([_integer(w, "face", f) for f, polygon in enumerate(polygons) for w in polygon], dtype=np.int64)
    start = np.repeat(np.cumsum(sizes) - sizes, sizes - 2)
    step = np.arange(len(start)) - np.repeat(np.cumsum(sizes - 2) - (sizes - 2), sizes - 2)
    return np.stack([flat[start], flat[start + step + 1], flat[start + step + 2]], axis=1) if len(start) else _NO_FACES


_NO_FACES = np.zeros((0, 3), dtype=np.int64)


def _integer(word: bytes, what: str, number: int) -> int:
    """One vertex number, or the reason why the word is none."""
    if not re.fullmatch(rb"[+-]?\d{1,18}", word):
        raise _FormatError(
            f"{what} {number} contains {_shown(word)} where a vertex number is expected; "
            "mend that line, or export the mesh again"
        )
    return int(word)


def _shown(text: bytes) -> str:
    """A short printable form of some of the file's bytes."""
    shown = text[:40].decode("utf-8", errors="replace")
    return repr(shown + ("…" if len(text) > 40 else ""))


def _quietly(reader: Callable[..., Any], content: bytes, **options: Any) -> dict[str, Any]:
    """Run one of trimesh's readers; whatever it raises on damaged bytes becomes one sentence."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            loaded = reader(io.BytesIO(content), **options)
    # A damaged file makes these readers fail in any way: IndexError, KeyError, UnboundLocalError, MemoryError, ...
    except Exception as error:
        reason = f"{type(error).__name__}: {error}".splitlines()[0][:160]
        raise _FormatError(f"is damaged, truncated or of another format ({reason}); export it again") from error
    return dict(loaded)


def _loaded_rows(loaded: dict[str, Any], key: str) -> NDArray[np.number]:
    """The (n, c) array of numbers that trimesh returned under `key`, c at least 3."""
    values = np.zeros((0, 3)) if loaded.get(key) is None else np.asarray(loaded[key])
    if values.size == 0:
        return np.zeros((0, 3))
    if values.ndim != 2 or values.shape[1] < 3 or values.dtype.kind not in "iuf":
        raise _FormatError(f"is damaged or truncated: its {key} are no table of numbers; export it again")
    return values


def _loaded_vertices(loaded: dict[str, Any]) -> NDArray[np.float64]:
    """(n, 3) positions from what trimesh returned."""
    return _loaded_rows(loaded, "vertices")[:, :3].astype(np.float64)


def _loaded_faces(loaded: dict[str, Any]) -> NDArray[np.int64]:
    """(m, 3) triangles from what trimesh returned, which may be polygons of one size."""
    rows = _loaded_rows(loaded, "faces")
    if rows.dtype.kind == "f" and not (np.isfinite(rows) & (rows == np.floor(rows)) & (np.abs(rows) < 2**62)).all():
        raise _FormatError("its faces contain something else than vertex numbers; export it again")
    polygons = rows.astype(np.int64)
    fans = [polygons[:, [0, step, step + 1]] for step in range(1, polygons.shape[1] - 1)]
    return np.stack(fans, axis=1).reshape(-1, 3)
