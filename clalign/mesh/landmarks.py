"""Landmarks: points known to be the same on both shapes, from arrays and from the files of other programs."""

from __future__ import annotations

import json
import os
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from clalign.errors import InputError
from clalign.mesh.mesh import Mesh

FARTHEST = 0.2
"""A point farther from the surface than this, in sqrt(area), is taken for one in other coordinates."""


@dataclass(frozen=True)
class Landmarks:
    """Pairs of vertices that are the same point.

    source, target : (k,) int64, vertices of the surfaces.
    names : k words for messages: labels of the file, or numbers from 1.
    source_gap, target_gap : (k,) float64, how far each given point was from its vertex, in sqrt(area).
    tolerance : how far they may be off, in sqrt(area); 0 if they are to be kept exactly.
    """

    source: NDArray[np.int64]
    target: NDArray[np.int64]
    names: tuple[str, ...]
    source_gap: NDArray[np.float64]
    target_gap: NDArray[np.float64]
    tolerance: float = 0.0

    def __len__(self) -> int:
        return len(self.names)


@dataclass(frozen=True)
class _Side:
    """What a file or an array says of one shape: vertex numbers (k,) or points (k, 3); names and axes, if known."""

    values: NDArray[np.number]
    names: tuple[str, ...] | None = None
    system: str = ""


def landmarks_of(given: Any, source: Mesh, target: Mesh, tolerance: float = 0.0) -> Landmarks:
    """Take landmarks in any form a caller may hold them in.

    Parameters
    ----------
    given : path or two paths
            see `read_landmarks`.
        (k, 2) int
            vertices of the source's and of the target's file, counted from 0.
        tuple of two arrays, (k,) int or (k, 3) float each
            vertices, or points in the coordinates of the file, of source and target.
    source, target : the surfaces.
    tolerance : how far they may be off, in sqrt(area).

    Raises
    ------
    InputError
        `given` is none of these, names no vertex of a surface, or a point is far from it; or the tolerance is negative.
    """
    if not 0 <= tolerance < np.inf:
        raise InputError(f"the tolerance of landmarks must not be negative, got {tolerance!r}")
    if isinstance(given, Landmarks):
        return replace(given, tolerance=tolerance or given.tolerance)
    return replace(_landmarks_of(given, source, target), tolerance=tolerance)


def _landmarks_of(given: Any, source: Mesh, target: Mesh) -> Landmarks:
    if isinstance(given, (str, os.PathLike)):
        return read_landmarks([given], source, target)
    try:
        rows = list(given)
    except TypeError as error:
        raise InputError(f"landmarks: expected pairs of vertices, two arrays or files, not {given!r}") from error
    if rows and all(isinstance(row, (str, os.PathLike)) for row in rows):
        return read_landmarks(rows, source, target)
    of_sides = isinstance(given, tuple) or (
        isinstance(given, list) and all(isinstance(row, np.ndarray) for row in rows)
    )
    if len(rows) == 2 and of_sides:
        return _paired(_Side(_numbers(rows[0])), _Side(_numbers(rows[1])), source, target)
    table = _numbers(rows)
    if table.ndim != 2 or table.shape[1] != 2 or not len(table):
        raise InputError(f"landmarks: expected rows of two vertices, got an array of shape {table.shape}")
    return _paired(_Side(table[:, 0]), _Side(table[:, 1]), source, target)


def _numbers(values: ArrayLike) -> NDArray[np.number]:
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"landmarks: expected numbers ({error})") from error


def read_landmarks(paths: Sequence[str | os.PathLike[str]], source: Mesh, target: Mesh) -> Landmarks:
    """Read one file with both sides of every landmark in a row, or one file for each side.

    Rows of text or CSV hold two vertex numbers or two points (six numbers); of one side a number or a point. A first
    column that is no number holds names, as does a first row. 3D Slicer's ``.mrk.json`` and MeshLab's ``.pp`` hold the
    points of one side. Two files with names are joined by name, others by order.

    Raises
    ------
    InputError
        A file cannot be read, or what it holds names no vertex of a surface, or a point is far from it.
    """
    if len(paths) == 1:
        return _paired(*_both_sides(Path(paths[0])), source, target)
    if len(paths) != 2:
        raise InputError(f"landmarks: give one file, or one of the source and one of the target, not {len(paths)}")
    first, second = (_one_side(Path(path)) for path in paths)
    if first.system and second.system and first.system != second.system:
        raise InputError(
            f"{paths[0]} has {first.system} coordinates and {paths[1]} has {second.system}; save both as their meshes"
        )
    if first.names is not None and second.names is not None:
        first, second = _joined_by_name(first, second, [Path(path).name for path in paths])
    return _paired(first, second, source, target)


def _joined_by_name(first: _Side, second: _Side, files: Sequence[str]) -> tuple[_Side, _Side]:
    """The landmarks that both sides name, in the order of the first."""
    mine, other = first.names or (), second.names or ()
    for names, file in ((mine, files[0]), (other, files[1])):
        double = sorted({name for name in names if names.count(name) > 1})
        if double:
            raise InputError(f"{file}: two landmarks are called {double[0]!r}; names must differ")
    common = [name for name in mine if name in other]
    if not common:
        raise InputError(f"{files[0]} and {files[1]} have no landmark name in common; call the same points the same")
    names = tuple(common)
    left = first.values[[mine.index(name) for name in common]]
    return _Side(left, names), _Side(second.values[[other.index(name) for name in common]], names)


def _paired(first: _Side, second: _Side, source: Mesh, target: Mesh) -> Landmarks:
    """Find the vertices of both sides and check that each is used once."""
    if len(first.values) != len(second.values):
        raise InputError(f"landmarks: {len(first.values)} on the source and {len(second.values)} on the target")
    if not len(first.values):
        raise InputError("landmarks: there are none")
    names = first.names or second.names or tuple(str(number + 1) for number in range(len(first.values)))
    here, here_gap = _vertices(first.values, source, names)
    there, there_gap = _vertices(second.values, target, names)
    for vertices, mesh in ((here, source), (there, target)):
        unique, place, count = np.unique(vertices, return_index=True, return_counts=True)
        if (count > 1).any():
            twice = names[int(place[count > 1][0])]
            number = mesh.file_index[unique[count > 1][0]]
            raise InputError(f"landmark {twice}: vertex {number} of {mesh.name} belongs to another landmark as well")
    return Landmarks(here, there, names, here_gap, there_gap)


def _vertices(
    values: NDArray[np.number], mesh: Mesh, names: Sequence[str]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The vertices of a surface (k,) that vertex numbers of its file or points stand for, and how far they are off."""
    if values.ndim == 2 and values.shape[1] == 3:
        points = (values.astype(np.float64) - mesh.offset) / mesh.scale
        if not np.isfinite(points).all():
            raise InputError(f"landmarks: a point on {mesh.name} has no finite coordinates")
        gap, vertex = cKDTree(mesh.vertices).query(points)
        if gap.max() > FARTHEST:
            worst = int(gap.argmax())
            raise InputError(
                f"landmark {names[worst]}: lies {gap[worst] * mesh.scale:.3g} away from {mesh.name}, in its unit; give "
                "points in the coordinates of the mesh file"
            )
        return vertex.astype(np.int64), gap.astype(np.float64)
    if values.ndim != 1 or (values != np.floor(values)).any():
        raise InputError(f"landmarks: expected vertex numbers or points of three coordinates, got {values.shape}")
    outside = (values < 0) | (values >= mesh.file_count)
    if outside.any():
        worst = int(outside.argmax())
        raise InputError(
            f"landmark {names[worst]}: {values[worst]:.0f} is no vertex of {mesh.name}, which has 0 to "
            f"{mesh.file_count - 1}"
        )
    vertex = mesh.vertex_of_file[values.astype(np.int64)]
    if (vertex < 0).any():
        worst = int((vertex < 0).argmax())
        raise InputError(f"landmark {names[worst]}: vertex {values[worst]:.0f} of {mesh.name} is not on its surface")
    return vertex, np.zeros(len(vertex))


def _both_sides(path: Path) -> tuple[_Side, _Side]:
    if path.name.lower().endswith((".json", ".pp")):
        raise InputError(f"{path}: holds the points of one shape; give a file for the source and one for the target")
    names, table = _rows(path)
    if table.shape[1] not in (2, 6):
        raise InputError(f"{path}: expected 2 vertex numbers or 6 coordinates a row, found {table.shape[1]} numbers")
    half = table.shape[1] // 2
    left, right = (part[:, 0] if half == 1 else part for part in (table[:, :half], table[:, half:]))
    return _Side(left, names), _Side(right, names)


def _one_side(path: Path) -> _Side:
    readers: dict[str, Callable[[Path], _Side]] = {".json": _read_slicer, ".pp": _read_meshlab}
    reader = readers.get(path.suffix.lower())
    if reader is not None:
        return reader(path)
    names, table = _rows(path)
    if table.shape[1] not in (1, 3):
        raise InputError(f"{path}: expected a vertex number or 3 coordinates a row, found {table.shape[1]} numbers")
    return _Side(table[:, 0] if table.shape[1] == 1 else table, names)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: landmarks cannot be read ({error})") from error


def _rows(path: Path) -> tuple[tuple[str, ...] | None, NDArray[np.float64]]:
    """Names, if there are any, and the table of numbers of a text file."""
    lines = [line.strip() for line in _text(path).splitlines() if not re.match(r"\s*#(\s|$)", line)]
    # Names may hold blanks where something else stands between columns.
    words = [
        [word.strip() for word in re.split(r"[,;\t]" if re.search(r"[,;\t]", line) else r"\s+", line) if word.strip()]
        for line in lines
        if line
    ]
    if words and not any(_is_number(word) for word in words[0]):
        words = words[1:]
    if not words:
        raise InputError(f"{path}: holds no landmark")
    named = [not _is_number(row[0]) for row in words]
    if any(named) != all(named):
        raise InputError(f"{path}: some rows begin with a name and some do not")
    names = tuple(row[0] for row in words) if all(named) else None
    numbers = [row[1:] if names else row for row in words]
    for number, row in enumerate(numbers):
        if len(row) != len(numbers[0]) or not all(map(_is_number, row)):
            raise InputError(f"{path}: landmark {number + 1} is given as {' '.join(words[number])[:60]!r}")
    return names, np.array(numbers, dtype=np.float64).reshape(len(numbers), -1)


def _is_number(word: str) -> bool:
    return re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", word) is not None


def _read_slicer(path: Path) -> _Side:
    """3D Slicer's markups: the control points that have a place."""
    try:
        points = [
            point
            for markup in json.loads(_text(path))["markups"]
            for point in markup["controlPoints"]
            if point.get("positionStatus", "defined") == "defined"
        ]
        places = np.array([point["position"] for point in points], dtype=np.float64).reshape(-1, 3)
        systems = {str(markup.get("coordinateSystem", "")) for markup in json.loads(_text(path))["markups"]}
        return _Side(places, tuple(str(point["label"]) for point in points), "/".join(sorted(systems)))
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: is no markups file of 3D Slicer ({type(error).__name__}: {error})") from error


def _read_meshlab(path: Path) -> _Side:
    """MeshLab's picked points: those that are switched on."""
    try:
        points = [point for point in ElementTree.fromstring(_text(path)).iter("point") if point.get("active") != "0"]
        places = np.array([[float(point.attrib[axis]) for axis in "xyz"] for point in points]).reshape(-1, 3)
        return _Side(places, tuple(point.attrib["name"] for point in points))
    except (ElementTree.ParseError, KeyError, ValueError) as error:
        raise InputError(f"{path}: is no file of picked points of MeshLab ({error})") from error
