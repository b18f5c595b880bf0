"""The shapes of a collection: files of a folder or of a list, each with a name of its own."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from clalign.errors import ResultError
from clalign.mesh.reading import SUFFIXES

DIGEST_LETTERS = 16


@dataclass(frozen=True)
class Member:
    """A shape of a collection, as it is known before its file is opened as a mesh.

    Attributes
    ----------
    name : unique in the collection, and a good file name.
    path : absolute path of the mesh file.
    digest : of the file's bytes; empty for a file that cannot be read, which then fails when it is its turn.
    size : of the file in bytes.
    """

    name: str
    path: str
    digest: str
    size: int


def read_members(shapes: str | Path | Sequence[str | Path]) -> tuple[Member, ...]:
    """Return the shapes of a folder (every mesh file in it), of a list file, or of a sequence of mesh files.

    A list file names one mesh a line, relative to its own folder; ``#`` starts a comment.

    Raises
    ------
    ResultError
        No such folder or list, fewer than two meshes, or two meshes that cannot be told apart by folder and name.
    """
    if isinstance(shapes, str | Path):
        place = Path(shapes).expanduser()
        paths = _folder_files(place) if place.is_dir() else _listed_files(place)
        where = str(place)
    else:
        paths = [Path(shape) for shape in shapes]
        where = "the shapes given"
    paths = [path.expanduser().absolute() for path in paths]
    if len(paths) < 2:
        raise ResultError(f"{where}: a collection needs two meshes or more, found {len(paths)}")
    return tuple(_member(name, path) for name, path in zip(_names(paths, where), paths, strict=True))


def _folder_files(folder: Path) -> list[Path]:
    files = [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.is_file()]
    if not files:
        raise ResultError(f"{folder}: no mesh file in this folder ({', '.join(SUFFIXES)})")
    return sorted(files, key=lambda path: (_natural(path.stem), path.suffix))


def _listed_files(listing: Path) -> list[Path]:
    if listing.suffix.lower() in SUFFIXES:
        raise ResultError(f"{listing}: is one mesh file; give a folder of meshes or a text file that lists them")
    try:
        lines = listing.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ResultError(f"{listing}: is neither a folder nor a list of meshes ({error})") from error
    words = [line.partition("#")[0].strip() for line in lines]
    return [listing.parent / word for word in words if word]


def _natural(text: str) -> tuple[tuple[int, int | str], ...]:
    """Sort key that puts pose 2 before pose 10."""
    return tuple((0, int(part)) if part.isdecimal() else (1, part) for part in re.split(r"(\d+)", text) if part)


def _names(paths: Sequence[Path], where: str) -> list[str]:
    stems = Counter(path.stem for path in paths)
    names = [path.stem if stems[path.stem] == 1 else f"{path.parent.name}-{path.name}" for path in paths]
    repeated = [name for name, count in Counter(names).items() if count > 1]
    if repeated:
        raise ResultError(f"{where}: {repeated[0]!r} is there twice; every mesh needs a name of its own")
    return names


def _member(name: str, path: Path) -> Member:
    digest = hashlib.sha256()
    try:
        with path.open("rb") as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
        return Member(name, str(path), digest.hexdigest()[:DIGEST_LETTERS], path.stat().st_size)
    except OSError:
        return Member(name, str(path), "", 0)
