"""Which shapes a collection has, files of a folder or of a list, and which pairs of them are matched."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clalign.collection.network import spanning_tree
from clalign.errors import ResultError
from clalign.mesh.reading import SUFFIXES, is_mesh_name, mesh_stem

DIGEST_LETTERS = 16

BLOCK = 4
"""Pairs are taken in blocks of so many sources and targets, so that a worker meets shapes that it still holds."""

PAIRINGS = ("all", "star", "tree")
Pairs = list[tuple[int, int]]


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
    files = [path for path in folder.iterdir() if is_mesh_name(path) and path.is_file()]
    if not files:
        raise ResultError(f"{folder}: no mesh file in this folder ({', '.join(SUFFIXES)})")
    return sorted(files, key=lambda path: (_natural(path.stem), path.suffix))


def _listed_files(listing: Path) -> list[Path]:
    if is_mesh_name(listing):
        raise ResultError(f"{listing}: is one mesh file; give a folder of meshes or a text file that lists them")
    words = [line.partition("#")[0].strip() for line in _lines(listing, "is neither a folder nor a list of meshes")]
    return [listing.parent / word for word in words if word]


def _lines(path: Path, problem: str) -> list[str]:
    try:
        # Names in it may be no UTF-8, as those of files.
        text = path.read_text(encoding="utf-8", errors="surrogateescape")
    except OSError as error:
        raise ResultError(f"{path}: {problem} ({error})") from error
    if "\0" in text:
        raise ResultError(f"{path}: {problem} (it is no text)")
    return text.splitlines()


def _natural(text: str) -> tuple[tuple[int, int | str], ...]:
    """Sort key that puts pose 2 before pose 10."""
    return tuple((0, int(part)) if part.isdecimal() else (1, part) for part in re.split(r"(\d+)", text) if part)


def _names(paths: Sequence[Path], where: str) -> list[str]:
    stems = Counter(mesh_stem(path.name) for path in paths)
    names = [
        stem if stems[stem] == 1 else f"{path.parent.name}-{path.name}"
        for path, stem in ((path, mesh_stem(path.name)) for path in paths)
    ]
    repeated = [name for name, count in Counter(names).items() if count > 1]
    if repeated:
        raise ResultError(f"{where}: {repeated[0]!r} is there twice; every mesh needs a name of its own")
    return names


def _member(name: str, path: Path) -> Member:
    try:
        with path.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
        return Member(name, str(path), digest[:DIGEST_LETTERS], path.stat().st_size)
    except OSError:
        return Member(name, str(path), "", 0)


def all_pairs(count: int) -> Pairs:
    """Return every pair (i, j), i < j, block by block."""
    pairs = [(i, j) for i in range(count) for j in range(i + 1, count)]
    return sorted(pairs, key=lambda pair: (pair[0] // BLOCK, pair[1] // BLOCK, pair))


def star_pairs(distances: NDArray[np.float64]) -> Pairs:
    """Return every other shape with the one in the middle: that of least summed distance to all."""
    hub = int(distances.sum(axis=1).argmin())
    return [(min(hub, other), max(hub, other)) for other in range(len(distances)) if other != hub]


def tree_pairs(distances: NDArray[np.float64]) -> Pairs:
    """Return the tree that joins all shapes over the smallest distances: each is matched with shapes like it."""
    first, second = np.triu_indices(len(distances), 1)
    pairs = np.stack([first, second], axis=1)
    kept = spanning_tree(len(distances), pairs, distances[first, second])
    return [(int(i), int(j)) for i, j in pairs[kept]]


def spectrum_distances(eigenvalues: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (n, n) root mean square differences of logarithms of eigenvalues (n, m), all positive.

    Eigenvalues of shapes of unit area hardly change with the pose, and tell bodies apart.
    """
    logarithms = np.log(eigenvalues)
    return np.stack([np.sqrt(np.mean((logarithms - row) ** 2, axis=1)) for row in logarithms])


def listed_pairs(path: str | Path, names: Sequence[str]) -> Pairs:
    """Return the pairs of a file, source and target a line, by name or file name; each pair once.

    Raises
    ------
    ResultError
        The file cannot be read, or names a mesh that is not in the collection, or one mesh twice in a line.
    """
    number = {name: index for index, name in enumerate(names)}
    pairs: dict[frozenset[int], tuple[int, int]] = {}
    for words in read_pairs_file(path):
        found = [number.get(word, number.get(mesh_stem(word), -1)) for word in words]
        for word, index in zip(words, found, strict=True):
            if index < 0:
                raise ResultError(f"{path}: there is no mesh {word!r} in the collection")
        if found[0] == found[1]:
            raise ResultError(f"{path}: {words[0]!r} is paired with itself")
        pairs.setdefault(frozenset(found), (found[0], found[1]))
    return list(pairs.values())


def read_pairs_file(path: str | Path) -> list[tuple[str, str]]:
    """Read a pairs file: source and target a line, ``#`` starts a comment.

    Raises
    ------
    ResultError
        The file cannot be read, or a line is not two names.
    """
    names = []
    for number, line in enumerate(_lines(Path(path), "cannot read the pairs"), start=1):
        words = line.partition("#")[0].replace(",", " ").split()
        if words and len(words) != 2:
            raise ResultError(f"{path}, line {number}: expected a source and a target, got {line.strip()!r}")
        if words:
            names.append((words[0], words[1]))
    if not names:
        raise ResultError(f"{path}: no pair in it")
    return names
