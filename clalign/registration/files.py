"""Writes a registered mesh: the source's own file with its vertices moved, or plain vertices and faces."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clalign.errors import InputError, MeshError
from clalign.mesh.moved import REWRITTEN, moved_file, moved_ply
from clalign.mesh.reading import read_mesh_file
from clalign.mesh.reading.files import mesh_suffix
from clalign.mesh.writing import mesh_bytes, require_format, write_bytes
from clalign.registration.register import Registration


def check_output(path: Path, columns: Mapping[str, NDArray], count: int) -> None:
    """Refuse a file that cannot be written, before work is done for it.

    Parameters
    ----------
    columns : values of vertices by their names.
    count : vertices of the source's file.

    Raises
    ------
    MeshError, InputError
        No mesh is written with this suffix, it cannot hold the columns, or one of these does not fit.
    """
    require_format(path)
    if columns and path.suffix.lower() != ".ply":
        raise InputError(f"{path}: values of vertices are written to .ply alone")
    for name, values in columns.items():
        if values.shape != (count,):
            raise InputError(
                f"{name}: has the shape {values.shape}; one number for each of the {count} vertices of the source's "
                "file is needed"
            )


def save_registration(
    registration: Registration, path: str | Path, columns: Mapping[str, NDArray] | None = None
) -> str | None:
    """Write a registered mesh, with the numbers of the vertices of the source's file.

    Where the source was read from a file of the same kind, PLY or OBJ, it is that file with its vertices moved:
    texture coordinates, materials, polygons, colours, weights and labels in it stay.

    Parameters
    ----------
    path : with suffix ``.ply``, ``.obj`` or ``.off``.
    columns : (file_count_x,) numbers of vertices, by the names that they get in a PLY file.

    Returns
    -------
    str or None
        What stayed behind, as a sentence for the user.

    Raises
    ------
    MeshError, InputError
        See `check_output`; or the disk refuses.
    """
    path, columns, source = Path(path), dict(columns or {}), registration.source
    check_output(path, columns, source.file_count)
    suffix, own = path.suffix.lower(), source.path
    if own is not None and suffix in REWRITTEN and mesh_suffix(own) == suffix:
        try:
            given = read_mesh_file(own).vertices
            if len(given) == source.file_count:
                content = moved_file(own, registration.positions(given), registration.faces, columns)
                write_bytes(path, content)
                return None
            reason = f"{own} has changed since the match"
        except MeshError as error:
            reason = str(error)
    else:
        kind = "no file" if own is None else f"a file of the kind '{mesh_suffix(own)}'"
        reason = f"the source is {kind}"
    positions = registration.vertices
    positions = np.where(np.isfinite(positions), positions, registration.target.offset)
    content = mesh_bytes(path, positions, registration.faces)
    if columns:
        content = moved_ply(content, positions, registration.faces, columns)
    write_bytes(path, content)
    return f"{path} has vertices and triangles only, no texture coordinates or other properties: {reason}"
