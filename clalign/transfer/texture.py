"""Texture coordinates of OBJ files, and how they go through a map without being torn at seams."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clalign.correspondence import Correspondence
from clalign.errors import InputError
from clalign.mesh.mesh import Mesh
from clalign.transfer.transfer import Side, map_from, sides

_MOST_CHOICES = 4


@dataclass(frozen=True)
class Texture:
    """Texture coordinates of the corners of triangles; a vertex on a seam has several.

    Attributes
    ----------
    coordinates : (t, 2) float64.
    corners : (m, 3) int64, coordinate of each corner of each triangle.
    faces : (m, 3) int64, vertex of each corner, in file numbering.
    materials : lines of the file that name materials ("mtllib …", "usemtl …"), to be kept in a copy.
    """

    coordinates: NDArray[np.float64]
    corners: NDArray[np.int64]
    faces: NDArray[np.int64]
    materials: tuple[str, ...] = ()


def read_texture(path: str | Path) -> Texture:
    """Read the texture coordinates of an OBJ file; polygons are cut into triangles.

    Raises
    ------
    InputError
        The file cannot be read, has no texture coordinates, or a line of it is not what OBJ asks for.
    """
    vertices = 0
    coordinates: list[tuple[float, float]] = []
    corners: list[tuple[int, int, int]] = []
    faces: list[tuple[int, int, int]] = []
    materials: list[str] = []
    try:
        lines = Path(path).read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    for number, line in enumerate(lines, start=1):
        words = line.split()
        if not words:
            continue
        try:
            if words[0] == "v":
                vertices += 1
            elif words[0] == "vt":
                coordinates.append((float(words[1]), float(words[2])))
            elif words[0] == "f":
                polygon = [_corner(word, vertices, len(coordinates)) for word in words[1:]]
                for a, b in itertools.pairwise(polygon[1:]):
                    faces.append((polygon[0][0], a[0], b[0]))
                    corners.append((polygon[0][1], a[1], b[1]))
            elif words[0] in ("mtllib", "usemtl"):
                materials.append(line.strip())
        except (ValueError, IndexError) as error:
            raise InputError(
                f"{path}, line {number}: {line.strip()[:60]!r} cannot be read as OBJ with texture ('f v/vt …')"
            ) from error
    if not coordinates or not faces:
        raise InputError(f"{path}: has no faces with texture coordinates ('vt' lines, and 'f v/vt …')")
    return Texture(np.array(coordinates), np.array(corners), np.array(faces), tuple(dict.fromkeys(materials)))


def write_textured_obj(path: str | Path, vertices: NDArray[np.float64], texture: Texture) -> None:
    """Write an OBJ file of positions (n, 3) in file numbering with texture coordinates of corners."""
    lines = list(texture.materials)
    lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += [f"vt {u:.7g} {v:.7g}" for u, v in texture.coordinates.tolist()]
    corners = np.stack([texture.faces + 1, texture.corners + 1], axis=2).reshape(-1, 6)
    lines += [f"f {a}/{s} {b}/{t} {c}/{u}" for a, s, b, t, c, u in corners.tolist()]
    # Names of materials are written as they were read, in whatever encoding.
    Path(path).write_bytes(("\n".join(lines) + "\n").encode("utf-8", errors="surrogateescape"))


def carry_texture(correspondence: Correspondence, texture: Texture, *, origin: Side = "source") -> Texture:
    """Give the corners of the other shape's triangles the texture coordinates of their matches, and return that.

    Where a match lies on a seam it has several coordinates: each triangle takes those that keep it smallest in the
    texture, so that only triangles whose corners really fall into different charts are torn.

    texture : of the origin, in the numbering of its file.

    Raises
    ------
    InputError
        The texture names a vertex that the origin's file does not have, or leaves a matched vertex without coordinates.
    """
    here, there = sides(correspondence, origin)
    if texture.faces.max() >= here.file_count:
        raise InputError(f"the texture names vertex {texture.faces.max()}, {here.name} has {here.file_count} vertices")
    choices = _choices(_as_read(texture, here), here.file_count)
    vertex = map_from(correspondence, origin).vertex
    matched = np.where(vertex >= 0, here.file_index[np.maximum(vertex, 0)], -1)
    bare = np.flatnonzero((matched >= 0) & (choices[matched, 0] < 0))
    if bare.size:
        raise InputError(f"vertex {matched[bare[0]]} of {here.name} has no texture coordinates")
    corners = choices[np.maximum(matched, 0)][there.faces]
    best = np.zeros((there.n_faces, 3), dtype=np.int64)
    shortest = np.full(there.n_faces, np.inf)
    for pick in itertools.product(range(choices.shape[1]), repeat=3):
        chosen = np.stack([corners[:, corner, pick[corner]] for corner in range(3)], axis=1)
        places = texture.coordinates[chosen]
        around = np.linalg.norm(places - np.roll(places, 1, axis=1), axis=2).sum(axis=1)
        around[(chosen < 0).any(axis=1)] = np.inf
        better = around < shortest
        best[better], shortest[better] = chosen[better], around[better]
    return Texture(texture.coordinates, best, there.file_faces, texture.materials)


def _as_read(texture: Texture, mesh: Mesh) -> Texture:
    """Return the texture on the vertices that the file's were joined to; files often cut surfaces along its seams."""
    known = mesh.vertex_of_file >= 0
    kept = np.where(known, mesh.file_index[mesh.vertex_of_file], np.arange(mesh.file_count))
    _, first, same = np.unique(texture.coordinates, axis=0, return_index=True, return_inverse=True)
    return replace(texture, corners=first[same.reshape(-1)][texture.corners], faces=kept[texture.faces])


def _choices(texture: Texture, vertices: int) -> NDArray[np.int64]:
    """Return (vertices, c) int64: the different coordinates of each vertex, filled up with -1."""
    pairs = np.unique(np.stack([texture.faces.ravel(), texture.corners.ravel()], axis=1), axis=0)
    first = np.searchsorted(pairs[:, 0], pairs[:, 0])
    rank = np.arange(len(pairs)) - first
    kept = rank < _MOST_CHOICES
    choices = np.full((vertices, int(rank[kept].max()) + 1), -1, dtype=np.int64)
    choices[pairs[kept, 0], rank[kept]] = pairs[kept, 1]
    return choices


def _corner(word: str, vertices: int, coordinates: int) -> tuple[int, int]:
    parts = word.split("/")
    found = []
    for text, count in ((parts[0], vertices), (parts[1], coordinates)):
        # OBJ counts from 1; negative numbers count back from the latest line.
        index = int(text) - 1 if int(text) > 0 else count + int(text)
        if not 0 <= index < count:
            raise ValueError(word)
        found.append(index)
    return found[0], found[1]
