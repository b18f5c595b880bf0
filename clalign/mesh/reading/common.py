"""What every reader returns, the reasons for which it gives up, and polygons and parts made into one list of triangles.

A reader takes the bytes of a file and the folder in which further files that it names would lie.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

SHOWN_NAMES = 12
"""More parts than this are counted, not named."""


@dataclass(frozen=True)
class FileMesh:
    """What a file says, unchecked: its vertices in file order, and its polygons as triangles."""

    vertices: NDArray[np.float64]
    """(n, 3) positions as in the file."""
    faces: NDArray[np.int64]
    """(m, 3) vertex numbers counted from 0; may be out of range. (0, 3) for a point cloud."""
    notes: tuple[str, ...] = ()
    """What the reader did that the user should know."""
    normals: NDArray[np.float64] | None = None
    """(n, 3) normals of the vertices, of any length, if the file has them."""


Reader = Callable[[bytes, Path], FileMesh]


class FormatError(Exception):
    """Why the bytes are not a file of their format; `read_mesh_file` puts the file's name to it."""


@dataclass(frozen=True)
class Part:
    """One of several meshes in a file."""

    name: str
    vertices: NDArray[np.float64]
    """(n, 3)"""
    faces: NDArray[np.int64]
    """(m, 3) numbers of this part's own vertices, counted from 0."""


def joined(parts: Sequence[Part], what: str) -> FileMesh:
    """Put the parts of a file one after the other; with more than one, a note names them.

    what : the parts in the plural, "meshes" or "pieces".
    """
    before = np.cumsum([0] + [len(part.vertices) for part in parts])
    faces = [part.faces + start for part, start in zip(parts, before, strict=False)]
    notes: tuple[str, ...] = ()
    if len(parts) > 1:
        listed = named([(part.name, len(part.vertices)) for part in parts])
        notes = (f"the file has {len(parts)} {what}; their vertices are numbered one after the other: {listed}",)
    vertices = np.concatenate([np.zeros((0, 3)), *(part.vertices for part in parts)])
    return FileMesh(vertices, np.concatenate([NO_FACES, *faces]), notes)


def named(counts: Sequence[tuple[str, int]]) -> str:
    """Return "head (120 vertices), body (800 vertices)", without the end of a long list."""
    words = [f"{shown(name)} ({count} vertices)" for name, count in counts[:SHOWN_NAMES]]
    more = len(counts) - len(words)
    return ", ".join(words) + (f" and {more} more" if more > 0 else "")


def fan(sizes: NDArray[np.int64], corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """(m, 3) triangles of polygons, given by their sizes and all their corners, each cut around its first corner."""
    sizes = np.maximum(sizes, 2)
    start = np.repeat(np.cumsum(sizes) - sizes, sizes - 2)
    step = np.arange(len(start)) - np.repeat(np.cumsum(sizes - 2) - (sizes - 2), sizes - 2)
    if not len(start):
        return NO_FACES
    return np.stack([corners[start], corners[start + step + 1], corners[start + step + 2]], axis=1)


def strip(corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """(m, 3) triangles of one strip, every second one turned so that all have one side."""
    triangles = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
    triangles[1::2] = triangles[1::2, [1, 0, 2]]
    return triangles


def strips(sizes: NDArray[np.int64], corners: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Return the triangles (m, 3) of each of several strips, given by their lengths and all their corners."""
    return [strip(part) for part in np.split(corners, np.cumsum(sizes)[:-1]) if len(part) > 2]


def doubles(values: NDArray[np.number]) -> NDArray[np.float64]:
    """Return the values as float64; a damaged file may hold kinds of NaN of which numpy would warn."""
    with np.errstate(invalid="ignore"):
        return values.astype(np.float64)


NO_FACES = np.zeros((0, 3), dtype=np.int64)


def shown(text: bytes | str) -> str:
    """Return a short printable form of some of the file's text."""
    words = text if isinstance(text, str) else text.decode("utf-8", errors="replace")
    return repr(words[:40] + ("…" if len(words) > 40 else ""))


@contextmanager
def damage_in_a_sentence() -> Iterator[None]:
    """Turn whatever damaged bytes make a reader raise into one sentence; warnings of libraries are not shown."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except FormatError:
        raise
    # A damaged file makes readers fail in any way: IndexError, KeyError, UnboundLocalError, MemoryError, ...
    except Exception as error:
        said = (str(error) or "no more is known").splitlines()[0][:160]
        reason = f"{type(error).__name__}: {said}"
        raise FormatError(f"is damaged, truncated or of another format ({reason}); export it again") from error


def missing_package(package: str, what: str) -> FormatError:
    """Return the sentence on a package of the extra "formats" that is not installed."""
    return FormatError(f'{what} are read with {package}, which is not installed; pip install "clalign[formats]"')
