"""Files of values on vertices: what `clalign transfer` reads and writes."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clalign.errors import InputError
from clalign.mesh.mesh import Mesh
from clalign.mesh.writing import save_mesh
from clalign.transfer.colours import UNMATCHED, amount_colours

MESH_SUFFIXES = (".ply", ".off", ".obj")
DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+")
WITH_A_POINT = "has a comma within a number: write decimals with a point"
_TEXT_SUFFIXES = (".txt", ".csv", ".xyz", ".lab", ".vts")


def read_values(path: str | Path, *, whole: bool = False) -> NDArray:
    """Read numbers from a NumPy file or from text with one row a line, separated by blanks or commas.

    Parameters
    ----------
    path : ``.npy``, or any text file; "#" begins a comment.
    whole : the numbers must be whole.

    Returns
    -------
    (rows,) or (rows, columns), int64 if `whole`, else float64.

    Raises
    ------
    InputError
        The file cannot be read, or holds something else.
    """
    path = Path(path)
    try:
        if path.suffix == ".npy":
            values = np.load(path, allow_pickle=False)
        else:
            values = _table(path, path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except InputError:
        raise
    except (ValueError, EOFError) as error:
        raise InputError(f"{path}: is not a table of numbers, one row a vertex: {error}") from error
    if not values.size:
        raise InputError(f"{path}: holds no numbers; one row a vertex is needed")
    if not np.issubdtype(values.dtype, np.number) or values.ndim not in (1, 2):
        raise InputError(f"{path}: holds {values.dtype} of shape {values.shape}; one row of numbers a vertex is needed")
    if values.ndim == 2 and values.shape[1] == 1:
        values = values[:, 0]
    if not whole:
        return np.asarray(values, dtype=np.float64)
    rounded = np.rint(values)
    if not np.array_equal(rounded, values):
        raise InputError(f"{path}: holds numbers that are not whole")
    return rounded.astype(np.int64)


def _table(path: Path, text: str) -> NDArray[np.float64]:
    """(rows, columns) numbers of a text; InputError names the first line that is no row of them."""
    lines = [(number, line.split("#")[0].strip()) for number, line in enumerate(text.splitlines(), start=1)]
    lines = [(number, line) for number, line in lines if line]
    # "0,5" is one number with a decimal comma or two; only the suffix can tell.
    if path.suffix.lower() != ".csv" and lines and all(DECIMAL_COMMA.fullmatch(line) for _, line in lines):
        raise InputError(
            f"{path}, line {lines[0][0]}: {lines[0][1]!r} {WITH_A_POINT}, and columns with a blank between"
        )
    rows: list[list[float]] = []
    for number, line in lines:
        separated = line.replace(", ", " ") if " " in line or "\t" in line else line.replace(",", " ")
        comma = re.search(r"\d,\d", line)
        try:
            rows.append([float(word) for word in separated.replace(",\t", " ").rstrip(",").split()])
        except ValueError as error:
            said = WITH_A_POINT if comma else "holds something that is no number"
            raise InputError(f"{path}, line {number}: {line[:60]!r} {said}; one row of numbers a vertex") from error
        if len(rows[-1]) != len(rows[0]):
            hint = f"; perhaps it {WITH_A_POINT}" if comma else ""
            raise InputError(
                f"{path}, line {number}: {line[:60]!r} has {len(rows[-1])} numbers, the first row has "
                f"{len(rows[0])}{hint}"
            )
    return np.array(rows)


def check_colours(path: Path, values: NDArray) -> None:
    """Raise InputError unless the values that were read from a file are colours: three columns, 0 to 1 or 0 to 255."""
    columns = values.shape[1] if values.ndim == 2 else 1
    if columns not in (3, 4):
        raise InputError(
            f"{path}: colours are three columns, and it has {columns}; carry other numbers with the kind 'scalars'"
        )
    known = values[np.isfinite(values)]
    if known.size and not 0.0 <= known.min() <= known.max() <= 255.0:
        raise InputError(
            f"{path}: colours are 0 to 1 or 0 to 255, and it has {known.min():.4g} to {known.max():.4g}; carry other "
            "numbers with the kind 'scalars'"
        )


def write_values(path: str | Path, values: NDArray, mesh: Mesh) -> None:
    """Write values of vertices: as numbers, or as a mesh whose colours show them.

    Parameters
    ----------
    path : ``.npy``; ``.txt`` or ``.csv``, one row a line; or ``.ply``, ``.off``, ``.obj`` for a coloured mesh.
    values : (file_count,) numbers, or (file_count, 3) colours from 0 to 1 or to 255; NaN is drawn grey.
    mesh : the mesh that the values belong to.

    Raises
    ------
    InputError
        Unknown suffix, or values that cannot be shown as colours.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".npy":
        np.save(path, values)
    elif suffix in _TEXT_SUFFIXES:
        whole = np.issubdtype(values.dtype, np.integer)
        np.savetxt(path, values, fmt="%d" if whole else "%.17g", delimiter="," if suffix == ".csv" else " ")
    elif suffix in MESH_SUFFIXES:
        save_mesh(path, mesh.file_positions(), mesh.all_file_faces, _colours_of(values))
    else:
        known = ", ".join((".npy", *_TEXT_SUFFIXES, *MESH_SUFFIXES))
        raise InputError(f"{path}: unknown kind of file; give it one of the suffixes {known}")


def _colours_of(values: NDArray) -> NDArray[np.float64]:
    rows = np.asarray(values, dtype=np.float64)
    known = np.asarray(np.isfinite(rows.reshape(len(rows), -1)).all(axis=1))
    if not known.any():
        raise InputError("no vertex has a value to be shown as a colour")
    if rows.ndim == 1:
        colours = amount_colours(rows, float(rows[known].min()), float(rows[known].max()))
    elif rows.shape[1] in (3, 4):
        colours = rows[:, :3] / (255.0 if rows[known].max() > 1.0 else 1.0)
    else:
        raise InputError(f"{rows.shape[1]} numbers a vertex cannot be shown as colours; write them as .npy or .txt")
    return np.where(known[:, None], colours, UNMATCHED)
