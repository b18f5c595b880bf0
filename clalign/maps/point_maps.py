"""Maps between the vertices of two shapes: their container, what makes one valid, and their text file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clalign.errors import ResultError


@dataclass(frozen=True)
class PointMaps:
    """A map and its reverse, each found on its own, of all vertices of both shapes or of samples of them.

    Attributes
    ----------
    target_of_source : (n_x,) int64, a vertex of Y for every vertex (or sample) of X.
    source_of_target : (n_y,) int64, a vertex of X for every vertex (or sample) of Y.
    """

    target_of_source: NDArray[np.int64]
    source_of_target: NDArray[np.int64]

    @property
    def reversed(self) -> PointMaps:
        """The same maps with the shapes exchanged."""
        return PointMaps(self.source_of_target, self.target_of_source)


def check_map(name: str, values: NDArray[np.int64], count: int, other_count: int) -> None:
    """Check a vertex map: one entry a vertex, each -1 or a vertex of the other mesh.

    Parameters
    ----------
    name : how messages call the map.
    values : (count,) integers.
    count, other_count : vertices of the mesh that the map starts from, and of the one it leads to.

    Raises
    ------
    ResultError
        Wrong size or type, or an entry outside the other mesh.
    """
    if values.ndim != 1 or len(values) != count:
        raise ResultError(f"{name}: has shape {values.shape}, expected one entry for each of {count} vertices")
    if not np.issubdtype(values.dtype, np.integer):
        raise ResultError(f"{name}: holds {values.dtype} values, expected integers")
    bad = np.flatnonzero((values < -1) | (values >= other_count))
    if len(bad):
        raise ResultError(
            f"{name}: entry {bad[0]} is {values[bad[0]]}, but the other mesh has vertices 0 to {other_count - 1}"
        )


def read_map(path: Path) -> NDArray[np.int64]:
    """Read a vertex map that `write_map` wrote, or any text with a whole number a line.

    Raises
    ------
    ResultError
        The file cannot be read, or a line is no whole number.
    """
    try:
        lines = path.read_text(encoding="utf-8").split("\n")
    except (OSError, UnicodeDecodeError) as error:
        raise ResultError(f"{path}: cannot be read ({error})") from error
    numbers = []
    for number, line in enumerate(lines):
        if line.strip():
            try:
                numbers.append(int(line))
            except ValueError as error:
                raise ResultError(f"{path}: line {number + 1} is {line[:40]!r}, not a vertex number") from error
    return np.array(numbers, dtype=np.int64)


def write_map(path: Path, values: NDArray[np.int64]) -> None:
    """Write a vertex map as text: line i holds the 0-based vertex of the other file, -1 for none."""
    path.write_text("".join(f"{value}\n" for value in values.tolist()), encoding="ascii")
