"""Which formats are read, and one clear sentence for every file that cannot be."""

from __future__ import annotations

import gzip
import os
import zlib
from pathlib import Path

from clalign.errors import MeshError
from clalign.mesh.reading.common import FileMesh, FormatError, Reader
from clalign.mesh.reading.neuro import FREESURFER_MAGIC, OTHER_MAGICS, read_freesurfer, read_gifti
from clalign.mesh.reading.ply import read_ply
from clalign.mesh.reading.scenes import read_3mf, read_glb, read_gltf
from clalign.mesh.reading.stl import read_stl
from clalign.mesh.reading.text import read_obj, read_off, read_points
from clalign.mesh.reading.vtk import read_vtk
from clalign.mesh.reading.vtk_xml import read_vtk_xml

READERS: dict[str, Reader] = {
    ".off": read_off,
    ".ply": read_ply,
    ".obj": read_obj,
    ".stl": read_stl,
    ".glb": read_glb,
    ".gltf": read_gltf,
    ".3mf": read_3mf,
    ".vtk": read_vtk,
    ".vtp": read_vtk_xml,
    ".vtu": read_vtk_xml,
    ".gii": read_gifti,
    ".xyz": read_points,
    ".pts": read_points,
    ".txt": read_points,
}
"""The reader of every suffix. FreeSurfer's surfaces have none of their own and are known by their first bytes."""
SUFFIXES = tuple(suffix for suffix, reader in READERS.items() if reader is not read_points)
"""Suffixes of meshes. Lists of points are not looked for in folders: text files there may be anything."""
COMPRESSED = ".gz"


def is_mesh_name(path: str | os.PathLike[str]) -> bool:
    """Tell whether a file is a mesh by its name: one of the suffixes, or one of them and ``.gz``."""
    return mesh_suffix(path) in SUFFIXES


def mesh_suffix(path: str | os.PathLike[str]) -> str:
    """Return the suffix that says the format, in small letters: ``.ply`` of "a.PLY" and of "a.ply.gz"."""
    path = Path(path)
    return (path.with_suffix("") if path.suffix.lower() == COMPRESSED else path).suffix.lower()


def mesh_stem(path: str | os.PathLike[str]) -> str:
    """Return the name of a mesh file without its folder, its suffix and ``.gz``; other words stay whole."""
    path = Path(path)
    if mesh_suffix(path) not in READERS:
        return str(path)
    return Path(path.stem).stem if path.suffix.lower() == COMPRESSED else path.stem


def read_mesh_file(path: str | os.PathLike[str]) -> FileMesh:
    """Read the vertices and triangles of a file without checking the surface.

    Parameters
    ----------
    path : a file of a kind in `READERS`, gzipped (``.gz``) or not, or a FreeSurfer surface; ``~`` is the home folder.

    Raises
    ------
    MeshError
        naming the file and the reason, if it is missing, unreadable, of another format, truncated or damaged.
    """
    path = expanded(path)
    if os.path.isdir(path):
        raise MeshError(f"{path}: is a directory; name a mesh file in it ({', '.join(SUFFIXES)})")
    # A pipe or device could block for ever; what does not exist gets its own message when it is opened.
    if os.path.exists(path) and not os.path.isfile(path):
        raise MeshError(f"{path}: is not a regular file; save the mesh to a file first")
    reader = READERS.get(mesh_suffix(path)) or _reader_by_content(path)
    content = file_content(path)
    if not content.strip():
        raise MeshError(f"{path}: the file is empty; export the mesh again")
    try:
        return reader(content, path.parent)
    except FormatError as error:
        raise MeshError(f"{path}: {error}") from error


def expanded(path: str | os.PathLike[str]) -> Path:
    """Return the path with ``~`` as the home folder, if there is one."""
    try:
        return Path(path).expanduser()
    except RuntimeError:
        return Path(path)


def _reader_by_content(path: Path) -> Reader:
    """Return the reader for a file whose suffix says nothing.

    Raises
    ------
    MeshError
        It is no FreeSurfer surface.
    """
    known = os.path.exists(path)
    if known and file_content(path)[:3] in (FREESURFER_MAGIC, *OTHER_MAGICS):
        return read_freesurfer
    raise MeshError(
        f"{path}: {'unknown mesh format' if known else 'no such file, and not a mesh format'} "
        f"('{mesh_suffix(path)}'); give a file of the kind {', '.join(READERS)}, one of these with .gz, or a "
        "FreeSurfer surface"
    )


def file_content(path: Path) -> bytes:
    """Read all bytes, unpacked, with the operating system's refusals put into words."""
    try:
        content = path.read_bytes()
        return gzip.decompress(content) if path.suffix.lower() == COMPRESSED else content
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise MeshError(f"{path}: is no whole gzip file ({error}); copy or pack it again") from error
    except FileNotFoundError as error:
        raise MeshError(f"{path}: no such file; check the path (current folder: {Path.cwd()})") from error
    except PermissionError as error:
        raise MeshError(f"{path}: no permission to read it; change its access rights or copy it") from error
    except (OSError, ValueError) as error:
        raise MeshError(f"{path}: cannot be read ({error})") from error
