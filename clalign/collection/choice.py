"""Which pairs of a collection are matched: all, a star, a tree, or those of a file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from clalign.collection.network import spanning_tree
from clalign.errors import ResultError
from clalign.mesh.reading import SUFFIXES

Pairing = Literal["all", "star", "tree"]
PAIRINGS: tuple[Pairing, ...] = ("all", "star", "tree")

BLOCK = 4
"""Pairs are taken in blocks of so many sources and targets, so that a worker meets shapes that it still holds."""

Pairs = list[tuple[int, int]]


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
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ResultError(f"{path}: cannot read the pairs ({error})") from error
    names = []
    for number, line in enumerate(lines, start=1):
        words = line.partition("#")[0].replace(",", " ").split()
        if words and len(words) != 2:
            raise ResultError(f"{path}, line {number}: expected a source and a target, got {line.strip()!r}")
        if words:
            names.append((words[0], words[1]))
    if not names:
        raise ResultError(f"{path}: no pair in it")
    return names


def mesh_stem(word: str) -> str:
    """Return the name of a mesh that is given by its name or by its file."""
    return Path(word).stem if Path(word).suffix.lower() in SUFFIXES else word
