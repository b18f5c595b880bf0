"""Files of values on vertices: what `clalign transfer` reads and writes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clalign.errors import InputError
from clalign.mesh.mesh import Mesh
from clalign.mesh.writing import save_mesh
from clalign.transfer.colours import UNMATCHED, amount_colours

MESH_SUFFIXES = (".ply", ".off", ".obj")
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
            text = path.read_text(encoding="utf-8")
            lines = [line.split("#")[0].replace(",", " ") for line in text.splitlines()]
            values = np.array([[float(word) for word in line.split()] for line in lines if line.strip()])
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
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
        save_mesh(path, mesh.file_positions(), mesh.file_faces, _colours_of(values))
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
