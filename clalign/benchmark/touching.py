"""Topological noise: parts of a body that touch, fused where they are near in space and far on the surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from clalign.benchmark.pairs import BenchmarkPair, LoadedPair
from clalign.benchmark.perturb import renumber
from clalign.geometry.geodesics import farthest_point_geodesics
from clalign.mesh.mesh import Mesh, mesh_from_arrays
from clalign.mesh.topology import face_normals

SAMPLES = 100
"""Farthest-point samples from whose distances those between other vertices are bounded from below."""
APART = 0.4
"""Least geodesic distance of two parts that may touch, in sqrt(area): no fold of an elbow or a knee."""
REACHES = (0.05, 0.1, 0.2, 0.4)
"""Distances in space, in sqrt(area), within which the nearest such parts are looked for in turn."""
FACING = 0.5
"""Least cosine between the normal of either part and the way to the other: what lies back to back does not touch."""
BRIDGES = 3
"""Places of one contact that are fused ..."""
CONTACT = (0.02, 0.12)
"""... no nearer to each other and no farther from the first than this, in sqrt(area)."""


def fused(mesh: Mesh) -> Mesh:
    """Return a mesh whose nearest parts of different limbs are joined by short tubes; vertices stay as they are.

    Where vertices of two parts are nearest, a face of either is taken out and the two holes are joined by six faces:
    every tube is a handle, through which distances and heat take the short way.

    Raises
    ------
    ClalignError
        Distances cannot be computed.
    """
    vertices, faces = mesh.vertices, mesh.faces.astype(np.int64)
    rows = farthest_point_geodesics(mesh, SAMPLES, SAMPLES).rows.astype(np.float64)
    removed: list[int] = []
    added: list[NDArray[np.int64]] = []
    touched = np.zeros(len(vertices), dtype=bool)
    first: NDArray[np.float64] | None = None
    for a, b in _contacts(vertices, rows):
        middle = 0.5 * (vertices[a] + vertices[b])
        if first is not None and np.linalg.norm(middle - first) > CONTACT[1]:
            continue
        (near, towards), (far, back) = (_facing(vertices, faces, one, other) for one, other in ((a, b), (b, a)))
        if min(towards, back) < FACING:
            continue
        corners = np.concatenate([faces[near], faces[far]])
        if touched[corners].any() or len(np.unique(corners)) < 6:
            continue
        # The next tube begins farther away.
        touched |= np.linalg.norm(vertices - vertices[a], axis=1) < CONTACT[0]
        touched |= np.linalg.norm(vertices - vertices[b], axis=1) < CONTACT[0]
        touched[corners] = True
        first = middle if first is None else first
        removed += [near, far]
        added.append(_tube(vertices, faces[near], faces[far]))
        if len(added) == BRIDGES:
            break
    kept = np.delete(faces, removed, axis=0)
    joined = np.concatenate([kept, *added]) if added else kept
    # All vertices of the file stay, those on no surface too.
    positions = mesh.file_positions()
    return mesh_from_arrays(positions, mesh.file_index[joined], f"{mesh.name} (touching)")


def _contacts(vertices: NDArray[np.float64], rows: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return pairs of vertices (c, 2) that are far apart on the surface, the nearest in space first."""
    tree = cKDTree(vertices)
    for reach in REACHES:
        pairs = tree.query_pairs(reach, output_type="ndarray").astype(np.int64)
        least = np.zeros(len(pairs))
        for row in rows:
            np.maximum(least, np.abs(row[pairs[:, 0]] - row[pairs[:, 1]]), out=least)
        pairs = pairs[least >= APART]
        if len(pairs):
            lengths = np.linalg.norm(vertices[pairs[:, 0]] - vertices[pairs[:, 1]], axis=1)
            return pairs[np.argsort(lengths, kind="stable")]
    return np.zeros((0, 2), dtype=np.int64)


def _facing(vertices: NDArray[np.float64], faces: NDArray[np.int64], one: int, other: int) -> tuple[int, float]:
    """Return the face around a vertex that looks most towards another vertex, and the cosine of what is missing."""
    around = np.flatnonzero((faces == one).any(axis=1))
    normals = face_normals(vertices, faces[around])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    direction = vertices[other] - vertices[one]
    cosines = normals @ direction / max(float(np.linalg.norm(direction)), 1e-300)
    return int(around[np.argmax(cosines)]), float(cosines.max())


def _tube(vertices: NDArray[np.float64], near: NDArray[np.int64], far: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the six faces (6, 3) between the borders of two faces that were taken out, in the shortest turn."""
    backwards = far[::-1]
    turns = [np.roll(backwards, turn) for turn in range(3)]
    other = min(turns, key=lambda each: float(np.linalg.norm(vertices[near] - vertices[each], axis=1).sum()))
    following, after = np.roll(near, -1), np.roll(other, -1)
    # The border of the hole runs as the face did, on its other side.
    return np.concatenate([np.stack([near, following, after], axis=1), np.stack([near, after, other], axis=1)])


@dataclass(frozen=True)
class TouchingPair:
    """A pair of which the target's nearest parts are fused, and the target shuffled.

    name : of the pair.
    pair : before.
    seed : of what is drawn.
    """

    name: str
    pair: BenchmarkPair
    seed: int = 0

    def load(self) -> LoadedPair:
        """Read the pair and fuse the target.

        Raises
        ------
        ClalignError
            The pair is not usable.
        """
        before = self.pair.load()
        changed = renumber(fused(before.target), self.seed)
        numbers = changed.truth.target_points
        mirrored = None if before.mirrored is None else before.mirrored.renumbered(numbers)
        return LoadedPair(self.name, before.source, changed.mesh, before.truth.renumbered(numbers), mirrored)
