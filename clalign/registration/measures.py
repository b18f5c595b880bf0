"""How faces have changed from one position of the vertices to another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clalign.mesh.topology import face_areas


def relative_areas(
    positions: NDArray[np.float64], rest: NDArray[np.float64], faces: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Return (m,) by what factor each face has grown, relative to the whole surface."""
    now, before = face_areas(positions, faces), face_areas(rest, faces)
    ratio = np.divide(now, before, out=np.ones(len(faces)), where=before > 0)
    return np.asarray(ratio * (before.sum() / now.sum()))


def stretches(
    positions: NDArray[np.float64], rest: NDArray[np.float64], faces: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Return (m, 2) the singular values of the map of each face, the larger one first."""
    frames = []
    for points in (rest, positions):
        first, second = (points[faces[:, k]] - points[faces[:, 0]] for k in (1, 2))
        along = np.linalg.norm(first, axis=1)
        unit = first / np.maximum(along, 1e-300)[:, None]
        across = np.einsum("mk,mk->m", second, unit)
        height = np.linalg.norm(second - across[:, None] * unit, axis=1)
        frames.append((along, across, height))
    (a, b, c), (d, e, f) = frames
    # [[d, e], [0, f]] times the inverse of [[a, b], [0, c]].
    a, c = np.maximum(a, 1e-300), np.maximum(c, 1e-300)
    upper, corner, lower = d / a, (e - d * b / a) / c, f / c
    squares = upper**2 + corner**2 + lower**2
    product = np.abs(upper * lower)
    root = np.sqrt(np.maximum(squares**2 - 4 * product**2, 0.0))
    largest = np.sqrt((squares + root) / 2)
    return np.stack([largest, product / np.maximum(largest, 1e-300)], axis=1)
