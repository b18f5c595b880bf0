"""One colouring for all shapes of a collection, carried by the maps from the shape that has most of them."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clalign.collection.result import Collection
from clalign.errors import InputError
from clalign.mesh.front import front_view
from clalign.mesh.mesh import Mesh, load_mesh
from clalign.presentation.camera import facing_rotation
from clalign.presentation.picture import draw_row
from clalign.transfer.colours import UNMATCHED, position_colours
from clalign.transfer.surface_map import vertex_map

_HEIGHT = 300


@dataclass(frozen=True)
class _Reached:
    """A shape whose vertices are known on the reference: (n,) int64, -1 where there is none."""

    name: str
    mesh: Mesh
    reference: NDArray[np.int64]
    way: tuple[str, ...]


def shape_pictures(collection: Collection) -> Iterator[tuple[str, NDArray[np.uint8], tuple[str, ...]]]:
    """Yield the name of every shape that can be loaded, its picture, and the shapes over which its colours came.

    The reference comes first, then others outwards along the maps; pictures are (height, width, 3). Shapes that no
    chain of maps joins to the reference are grey. At any time only the shapes at the rim of what is reached are in
    memory.
    """
    neighbours = _neighbours(collection)
    meshes = {row.name: row.path for row in collection.shapes if row.ok}
    order = sorted(meshes, key=lambda name: -len(neighbours.get(name, ())))
    if not order:
        return
    mesh = load_mesh(meshes[order[0]])
    view = front_view(mesh.vertices)
    colours = position_colours(mesh.vertices, view)
    rim = deque([_Reached(order[0], mesh, np.arange(mesh.n_vertices), ())])
    seen = {order[0]}
    while rim:
        here = rim.popleft()
        yield here.name, _drawn(here, mesh, view, colours), here.way
        for name in neighbours.get(here.name, ()):
            if name not in seen and name in meshes:
                reached = _reached(collection, here, name, meshes[name])
                if reached is not None:
                    seen.add(name)
                    rim.append(reached)
    for name in order:
        if name not in seen:
            try:
                alone = load_mesh(meshes[name])
            except InputError:
                continue
            nowhere = _Reached(name, alone, np.full(alone.n_vertices, -1), ())
            yield name, _drawn(nowhere, mesh, view, colours), ()


def _neighbours(collection: Collection) -> dict[str, list[str]]:
    """Return the shapes that each has a map with, the most trusted map first."""
    found: dict[str, list[tuple[float, str]]] = {}
    for row in collection.pairs:
        if row.ok:
            doubt = 1.0 if row.network_error is None else row.network_error
            found.setdefault(row.source, []).append((doubt, row.target))
            found.setdefault(row.target, []).append((doubt, row.source))
    return {name: [other for _, other in sorted(others)] for name, others in found.items()}


def _reached(collection: Collection, here: _Reached, name: str, path: str) -> _Reached | None:
    try:
        mesh = load_mesh(path)
        vertex = vertex_map(collection.maps(name, here.name).target_of_source, mesh, here.mesh).vertex
    except InputError:
        return None
    reference = np.where(vertex >= 0, here.reference[vertex], -1)
    return _Reached(name, mesh, reference, (*here.way, here.name))


def _drawn(
    shape: _Reached, reference: Mesh, view: NDArray[np.float64], colours: NDArray[np.float64]
) -> NDArray[np.uint8]:
    known = shape.reference >= 0
    painted = np.where(known[:, None], colours[shape.reference], UNMATCHED)
    if np.count_nonzero(known) > 2:
        rotated = view @ facing_rotation(shape.mesh.vertices[known], reference.vertices[shape.reference[known]])
    else:
        rotated = front_view(shape.mesh.vertices)
    return draw_row([(shape.mesh.vertices @ rotated.T, shape.mesh.faces, painted)], _HEIGHT)
