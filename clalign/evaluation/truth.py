"""Ground truth: pairs of vertices known to be the same point of the body, and the files that hold them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from clalign.errors import ResultError
from clalign.maps.functional_maps import PointMaps
from clalign.mesh.mesh import Mesh

Base = Literal[0, 1]


@dataclass(frozen=True)
class Truth:
    """Line i says that vertex ``source_points[i]`` of X and vertex ``target_points[i]`` of Y are the same point.

    Both are (p,) int64, 0-based, in the numbering of the mesh files. A vertex may stand in several lines (points of
    the body snapped to the vertices of a coarser mesh) or in none.
    """

    source_points: NDArray[np.int64]
    target_points: NDArray[np.int64]

    def __post_init__(self) -> None:
        source = _vertex_numbers(self.source_points, "source")
        target = _vertex_numbers(self.target_points, "target")
        if source.size != target.size:
            raise ResultError(
                f"the truth has {source.size} source points and {target.size} target points; "
                "line i of both must be the same point, so their numbers must agree"
            )
        object.__setattr__(self, "source_points", source)
        object.__setattr__(self, "target_points", target)

    @property
    def count(self) -> int:
        """Number of lines."""
        return int(self.source_points.size)

    @staticmethod
    def unknown() -> Truth:
        """Truth without a line."""
        return Truth.identity(0)

    @staticmethod
    def identity(count: int) -> Truth:
        """Vertex i ↔ vertex i, for two meshes of one connectivity with `count` vertices each."""
        return Truth(np.arange(count), np.arange(count))

    @staticmethod
    def from_index(target_of_source: ArrayLike) -> Truth:
        """Truth from the target vertex of every source vertex; negative entries have none and are left out."""
        index = np.asarray(target_of_source, dtype=np.int64)
        known = np.flatnonzero(index >= 0)
        return Truth(known, index[known])

    def mirrored(self, mirror: ArrayLike) -> Truth:
        """Truth of the map that confuses left and right.

        Parameters
        ----------
        mirror : (p,) int, line i is the number of the line that is the mirror image of line i.

        Raises
        ------
        ResultError
            `mirror` has another length than this truth, or names a line that does not exist.
        """
        lines = np.asarray(mirror, dtype=np.int64).ravel()
        if lines.size != self.count:
            raise ResultError(
                f"the mirror file has {lines.size} lines and the truth {self.count}; line i of the mirror file is "
                "the mirror image of point i, so it needs one line a point"
            )
        bad = np.flatnonzero((lines < 0) | (lines >= self.count))
        if bad.size:
            raise ResultError(f"mirror line {bad[0] + 1} says {lines[bad[0]]}, outside 0 … {self.count - 1}")
        return Truth(self.source_points, self.target_points[lines])

    def renumbered(self, new_of_old: NDArray[np.int64]) -> Truth:
        """Truth after the target's vertices were given new numbers."""
        return Truth(self.source_points, new_of_old[self.target_points])

    def check_against(self, source_count: int, target_count: int) -> None:
        """Raise `ResultError` when a point is not a vertex of its mesh file."""
        for side, points, count in (
            ("source", self.source_points, source_count),
            ("target", self.target_points, target_count),
        ):
            bad = np.flatnonzero(points >= count)
            if bad.size:
                raise ResultError(
                    f"line {bad[0] + 1} of the truth names {side} vertex {points[bad[0]]} (0-based), but that mesh has "
                    f"{count} vertices: wrong file, or a 1-based file read as 0-based"
                )


def _vertex_numbers(points: ArrayLike, side: str) -> NDArray[np.int64]:
    values = np.asarray(points)
    if values.ndim != 1 or (values.size and values.dtype.kind not in "iu"):
        raise ResultError(f"{side} points must be one row of whole numbers, got {values.dtype} of shape {values.shape}")
    numbers = values.astype(np.int64)
    numbers.setflags(write=False)
    bad = np.flatnonzero(numbers < 0)
    if bad.size:
        raise ResultError(f"line {bad[0] + 1} of the truth names {side} vertex {numbers[bad[0]]}: below zero")
    return numbers


def true_maps(source: Mesh, target: Mesh, truth: Truth) -> PointMaps:
    """Return the truth in the vertex order of the meshes, both ways.

    Vertices that the truth does not name take what their nearest named neighbour in space has.

    Raises
    ------
    ResultError
        The truth does not fit the meshes, or has no point on both surfaces.
    """
    truth.check_against(source.file_count, target.file_count)
    source_points = source.vertex_of_file[truth.source_points]
    target_points = target.vertex_of_file[truth.target_points]
    known = (source_points >= 0) & (target_points >= 0)
    if not known.any():
        raise ResultError(f"the truth has no point on both {source.name} and {target.name}")
    source_points, target_points = source_points[known], target_points[known]
    return PointMaps(
        target_of_source=_filled(source.vertices, source_points, target_points),
        source_of_target=_filled(target.vertices, target_points, source_points),
    )


def _filled(vertices: NDArray[np.float64], named: NDArray[np.int64], values: NDArray[np.int64]) -> NDArray[np.int64]:
    found = np.full(len(vertices), -1, dtype=np.int64)
    found[named] = values
    known = np.flatnonzero(found >= 0)
    nearest = cKDTree(vertices[known]).query(vertices)[1]
    return found[known[nearest]]


def read_numbers(path: str | Path) -> NDArray[np.int64]:
    """Read a text file with one whole number a line (blank lines at the end are allowed).

    Raises
    ------
    ResultError
        The file cannot be read, is empty, or a line is not one whole number (file and line are named).
    """
    try:
        lines = Path(path).read_text(encoding="utf-8").rstrip().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise ResultError(f"{path}: cannot be read as text ({reason})") from error
    if not lines:
        raise ResultError(f"{path}: the file is empty; expected one vertex number a line")
    numbers = np.empty(len(lines), dtype=np.int64)
    for row, line in enumerate(lines):
        try:
            # "12.0" and "1.2e+01" count as whole because MATLAB writes them.
            if not float(line).is_integer():
                raise ValueError(line)
            numbers[row] = int(float(line))
        except ValueError as error:
            raise ResultError(f"{path}, line {row + 1}: {line.strip()[:40]!r} is not one whole number") from error
    return numbers


def read_index(path: str | Path, *, base: Base = 0, count: int | None = None) -> NDArray[np.int64]:
    """Read vertex numbers, one a line, and return them 0-based.

    Parameters
    ----------
    path : text file.
    base : number of the first vertex in the file, 0 or 1.
    count : vertices of the mesh that the numbers refer to, when known: then a wrong base is recognised.

    Returns
    -------
    (p,) int64, 0-based; -1 (no such point) is allowed in a 0-based file only.

    Raises
    ------
    ResultError
        A number is outside the mesh; the message says when the other base would fit.
    """
    numbers = read_numbers(path)
    first, last = int(numbers.min()), int(numbers.max())
    lowest, wrong = (1, "in a 1-based file; read it as 0-based") if base else (-1, "is below zero")
    if first < lowest:
        line = int(np.argmax(numbers < lowest)) + 1
        raise ResultError(f"{path}, line {line}: vertex {numbers[line - 1]} {wrong}")
    if count is not None and last - base >= count:
        line = int(np.argmax(numbers)) + 1
        hint = (
            "; it looks 1-based: say --truth-base 1, or --base 1 for a map (in Python base=1)"
            if base == 0 and first >= 1 and last == count
            else ""
        )
        raise ResultError(
            f"{path}, line {line}: vertex {last} is outside {base} … {count - 1 + base} of a mesh of {count} vertices, "
            f"read as {base}-based{hint}"
        )
    return numbers - base


def read_index_truth(
    path: str | Path, *, base: Base = 0, source_count: int | None = None, target_count: int | None = None
) -> Truth:
    """Read an index file: line i is the target vertex of source vertex i (0-based files may say -1 for none).

    Raises
    ------
    ResultError
        Another number of lines than `source_count`, or a number outside the target mesh.
    """
    index = read_index(path, base=base, count=target_count)
    if source_count is not None and index.size != source_count:
        raise ResultError(
            f"{path} has {index.size} lines, but the source mesh has {source_count} vertices: an index file has one "
            "line for every source vertex"
        )
    return Truth.from_index(index)


def read_pair_truth(
    source_file: str | Path,
    target_file: str | Path,
    *,
    base: Base | None = None,
    source_count: int | None = None,
    target_count: int | None = None,
) -> Truth:
    """Read two files whose line i names the vertex of either mesh at the same point of the body.

    Parameters
    ----------
    source_file, target_file : ``X.truth.txt`` and ``Y.truth.txt`` (0-based), or ``X.vts`` and ``Y.vts`` (1-based).
    base : number of the first vertex; None takes 1 for ``.vts`` and 0 for everything else.
    source_count, target_count : vertices of the meshes, for checking.

    Raises
    ------
    ResultError
        The files have different numbers of lines, or a number is outside its mesh or below zero (a point without
        a vertex would shift the lines that ``mirror.txt`` speaks of).
    """
    source = read_index(source_file, base=_base_of(source_file, base), count=source_count)
    target = read_index(target_file, base=_base_of(target_file, base), count=target_count)
    if source.size != target.size:
        raise ResultError(
            f"{source_file} has {source.size} lines and {target_file} has {target.size}: line i of both must be the "
            "same point"
        )
    return Truth(source, target)


def _base_of(path: str | Path, base: Base | None) -> Base:
    if base is not None:
        return base
    return 1 if Path(path).suffix.lower() == ".vts" else 0


def read_mirror(path: str | Path, *, count: int | None = None) -> NDArray[np.int64]:
    """Read ``mirror.txt``: line i is the number (0-based) of the point that is the mirror image of point i.

    Raises
    ------
    ResultError
        A line names a point that does not exist, or the number of lines is not `count`.
    """
    mirror = read_index(path, base=0)
    if count is not None and mirror.size != count:
        raise ResultError(f"{path} has {mirror.size} lines, but there are {count} points")
    if mirror.min() < 0 or mirror.max() >= mirror.size:
        line = int(np.flatnonzero((mirror < 0) | (mirror >= mirror.size))[0]) + 1
        raise ResultError(f"{path}, line {line}: point {mirror[line - 1]} is outside 0 … {mirror.size - 1}")
    return mirror
