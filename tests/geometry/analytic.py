"""Surfaces whose spectra, curvatures or distances are known in closed form."""

from __future__ import annotations

import numpy as np
import shapes
from numpy.typing import NDArray

from clalign.mesh.mesh import Mesh, mesh_from_arrays

Surface = tuple[NDArray[np.float64], NDArray[np.int32]]


def _cells(
    corner: NDArray[np.int64], along: NDArray[np.int64], across: NDArray[np.int64], far: NDArray[np.int64]
) -> NDArray[np.int32]:
    a, b, c, d = (part.ravel() for part in (corner, along, far, across))
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]).astype(np.int32)


def sphere(subdivisions: int) -> Surface:
    vertices, faces = shapes.icosphere(subdivisions)
    return vertices, faces.astype(np.int32)


def bumpy(subdivisions: int) -> Surface:
    vertices, faces = shapes.bumpy_sphere(subdivisions)
    return vertices, faces.astype(np.int32)


def rectangle(columns: int, rows: int, width: float, height: float) -> Surface:
    """Flat, with boundary, facing +z."""
    x, y = np.meshgrid(np.linspace(0, width, columns), np.linspace(0, height, rows), indexing="ij")
    number = np.arange(columns * rows).reshape(columns, rows)
    faces = _cells(number[:-1, :-1], number[1:, :-1], number[:-1, 1:], number[1:, 1:])
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1), faces


def cylinder(around: int, along: int, radius: float, length: float) -> Surface:
    """Open at both ends, facing outward."""
    angle, z = np.meshgrid(np.arange(around) * 2 * np.pi / around, np.linspace(0, length, along), indexing="ij")
    vertices = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1).reshape(-1, 3)
    number = np.arange(around * along).reshape(around, along)
    after = np.roll(number, -1, axis=0)
    return vertices, _cells(number[:, :-1], after[:, :-1], number[:, 1:], after[:, 1:])


def torus(around: int, along: int, inner: float) -> Surface:
    """Closed, of genus one, facing outward; the middle circle has radius 1."""
    u, v = np.meshgrid(np.arange(around) * 2 * np.pi / around, np.arange(along) * 2 * np.pi / along, indexing="ij")
    ring = 1 + inner * np.cos(v)
    vertices = np.stack([ring * np.cos(u), ring * np.sin(u), inner * np.sin(v)], axis=-1).reshape(-1, 3)
    number = np.arange(around * along).reshape(around, along)
    after, beside = np.roll(number, -1, axis=0), np.roll(number, -1, axis=1)
    return vertices, _cells(number, after, beside, np.roll(after, -1, axis=1))


def folded(vertices: NDArray[np.float64], at: float, angle: float) -> NDArray[np.float64]:
    """Fold a flat sheet along the line x = at; an isometry where that is a line of edges."""
    beyond = np.maximum(vertices[:, 0] - at, 0.0)
    x = np.minimum(vertices[:, 0], at) + beyond * np.cos(angle)
    return np.stack([x, vertices[:, 1], beyond * np.sin(angle)], axis=1)


def slivered(subdivisions: int) -> Surface:
    """A bumpy sphere with some edges shrunk by 1e-9, so that faces beside them degenerate."""
    vertices, faces = bumpy(subdivisions)
    broken = vertices.copy()
    for first, second, _ in faces[::50]:
        broken[first] = broken[second] + 1e-9 * (broken[first] - broken[second])
    return broken, faces


def as_unit_mesh(surface: Surface, name: str = "mesh") -> Mesh:
    return mesh_from_arrays(*surface, name=name)
