"""Writing meshes for other tools."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clalign.errors import MeshError
from clalign.storage.files import replaced_file

Colours = NDArray[np.uint8] | None


def save_mesh(
    path: str | os.PathLike[str], vertices: ArrayLike, faces: ArrayLike, colours: ArrayLike | None = None
) -> None:
    """Write a mesh for other tools, keeping the order of the vertices; the file appears whole or not at all.

    Parameters
    ----------
    path : with suffix `.ply` (binary, float64), `.off` or `.obj`.
    vertices, faces : (n, 3) float and (m, 3) int.
    colours : (n, 3) or (n, 4), uint8 or float from 0 to 1.

    Raises
    ------
    MeshError
        for another suffix, colours that do not fit, or a file that cannot be written.
    """
    path = Path(path)
    write_bytes(path, mesh_bytes(path, vertices, faces, colours))


def mesh_bytes(path: Path, vertices: ArrayLike, faces: ArrayLike, colours: ArrayLike | None = None) -> bytes:
    """Return what `save_mesh` writes."""
    require_format(path)
    points = np.asarray(vertices, dtype=np.float64).reshape(-1, 3)
    triangles = np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    colour_rows = None if colours is None else _colour_bytes(colours, len(points), path)
    return _WRITERS[path.suffix.lower()](points, triangles, colour_rows)


def write_bytes(path: Path, content: bytes) -> None:
    """Write the content of a mesh file, which appears whole or not at all.

    Raises
    ------
    MeshError
        The file cannot be written.
    """
    try:
        with replaced_file(path) as stream:
            stream.write(content)
    except OSError as error:
        raise MeshError(
            f"{path}: cannot be written ({error.strerror}); check the folder and its access rights"
        ) from error


def require_format(path: Path) -> None:
    """Raise MeshError unless meshes can be written as the suffix says."""
    if path.suffix.lower() not in _WRITERS:
        raise MeshError(f"{path}: meshes are not written as '{path.suffix}'; use one of {', '.join(_WRITERS)}")


def _colour_bytes(colours: ArrayLike, count: int, path: Path) -> NDArray[np.uint8]:
    """(n, 3) uint8 colours."""
    values = np.asarray(colours)
    if values.ndim != 2 or len(values) != count or values.shape[1] not in (3, 4):
        raise MeshError(f"{path}: colours have shape {values.shape}; expected ({count}, 3)")
    if values.dtype.kind == "f":
        values = np.rint(np.clip(values, 0.0, 1.0) * 255.0)
    return values[:, :3].astype(np.uint8)


def _ply_bytes(points: NDArray[np.float64], triangles: NDArray[np.int64], colours: Colours) -> bytes:
    fields: list[tuple[str, str]] = [("x", "<f8"), ("y", "<f8"), ("z", "<f8")]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header += [f"property double {axis}" for axis in "xyz"]
    if colours is not None:
        fields += [(name, "u1") for name in ("red", "green", "blue")]
        header += [f"property uchar {name}" for name in ("red", "green", "blue")]
    header += [f"element face {len(triangles)}", "property list uchar int vertex_indices", "end_header", ""]
    rows = np.zeros(len(points), dtype=fields)
    for axis, name in enumerate("xyz"):
        rows[name] = points[:, axis]
    for channel, (name, _) in enumerate(fields[3:]):
        rows[name] = colours[:, channel] if colours is not None else 0
    sides = np.zeros(len(triangles), dtype=[("count", "u1"), ("corners", "<i4", (3,))])
    sides["count"], sides["corners"] = 3, triangles
    return "\n".join(header).encode() + rows.tobytes() + sides.tobytes()


def _off_bytes(points: NDArray[np.float64], triangles: NDArray[np.int64], colours: Colours) -> bytes:
    lines = ["OFF" if colours is None else "COFF", f"{len(points)} {len(triangles)} 0"]
    if colours is None:
        lines += [f"{x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
    else:
        pairs = zip(points.tolist(), colours.tolist(), strict=True)
        lines += [f"{x!r} {y!r} {z!r} {r} {g} {b} 255" for (x, y, z), (r, g, b) in pairs]
    lines += [f"3 {a} {b} {c}" for a, b, c in triangles.tolist()]
    return ("\n".join(lines) + "\n").encode()


def _obj_bytes(points: NDArray[np.float64], triangles: NDArray[np.int64], colours: Colours) -> bytes:
    if colours is None:
        lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
    else:
        pairs = zip(points.tolist(), (colours / 255.0).tolist(), strict=True)
        lines = [f"v {x!r} {y!r} {z!r} {r:.4f} {g:.4f} {b:.4f}" for (x, y, z), (r, g, b) in pairs]
    lines += [f"f {a} {b} {c}" for a, b, c in (triangles + 1).tolist()]
    return ("\n".join(lines) + "\n").encode()


_WRITERS: dict[str, Callable[[NDArray[np.float64], NDArray[np.int64], Colours], bytes]] = {
    ".ply": _ply_bytes,
    ".off": _off_bytes,
    ".obj": _obj_bytes,
}
