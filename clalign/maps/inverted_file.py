"""Nearest points among very many, searched cell by cell instead of everywhere.

Points are sorted into cells around some of them; a query looks only into the cells of its own nearest centres. With
about sqrt(p · probes) cells that costs m sqrt(p · probes) products of vectors instead of m p. Vertices embedded by
eigenfunctions lie on a surface, where a cell has few neighbours, so that the nearest point is hardly ever missed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clalign.engine.backend import Backend
from clalign.errors import InputError

PROBES = 16
"""Cells that a query looks into."""

BLOCK = 4096
"""Queries whose centres are ranked at once."""


def nearest_in_cells(
    backend: Backend, queries: NDArray[np.floating], points: NDArray[np.floating], probes: int = PROBES
) -> NDArray[np.int64]:
    """Return for each row of `queries` (m, k) the nearest row of `points` (p, k) in the cells around it, as (m,) int64.

    Ties go to the lowest index. The result is the same from run to run on one device.

    Parameters
    ----------
    probes : cells to look into: fewer cost less and miss more. With as many as there are cells, p, nothing is missed.

    Raises
    ------
    InputError
        A query or a point is not finite: it is near to nothing.
    """
    _require_finite(queries=queries, points=points)
    count = max(1, min(len(points), round((len(points) * probes) ** 0.5)))
    half = 0.5 * np.einsum("pk,pk->p", points, points)
    # Any choice will do that spreads over the points, however they are numbered.
    chosen = np.linspace(0, len(points) - 1, count).round().astype(np.int64)
    sought, places, penalty = backend.array(queries), backend.array(points), backend.array(half[:, None])
    centres = backend.gather(places, backend.array(chosen)), backend.array(half[chosen])
    points_of_cells = _grouped(backend.numpy(backend.nearest(places, *centres)[0]), count)
    near = _nearest_centres(queries, points[chosen], half[chosen], min(probes, count))
    queries_of_cells = [positions // near.shape[1] for positions in _grouped(near.reshape(-1), count)]
    found = np.full(len(queries), len(points), dtype=np.int64)
    best = np.full(len(queries), -np.inf)
    for rows, cell in zip(queries_of_cells, points_of_cells, strict=True):
        if not rows.size or not cell.size:
            continue
        inside = backend.array(cell)
        index, score = backend.nearest(
            backend.gather(sought, backend.array(rows)),
            backend.gather(places, inside),
            backend.gather(penalty, inside).reshape(-1),
        )
        fresh, candidate = backend.numpy(score), cell[backend.numpy(index)]
        better = (fresh > best[rows]) | ((fresh == best[rows]) & (candidate < found[rows]))
        best[rows[better]], found[rows[better]] = fresh[better], candidate[better]
    return found


def _require_finite(**rows: NDArray[np.floating]) -> None:
    """Refuse arrays (n, k) with a row that is not finite, naming the first one."""
    for name, values in rows.items():
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if bad.size:
            raise InputError(
                f"nearest_in_cells: {bad.size} of {len(values)} {name} are not finite, the first is row {bad[0]}"
            )


def _nearest_centres(
    queries: NDArray[np.floating], centres: NDArray[np.floating], half: NDArray[np.floating], count: int
) -> NDArray[np.int32]:
    """Return for each query (m, k) the `count` nearest of the centres (c, k) in no order: (m, count)."""
    near = np.empty((len(queries), count), dtype=np.int32)
    transposed, penalty = centres.T.astype(np.float32), half.astype(np.float32)
    for start in range(0, len(queries), BLOCK):
        scores = penalty - queries[start : start + BLOCK].astype(np.float32) @ transposed
        near[start : start + BLOCK] = np.argpartition(scores, count - 1, axis=1)[:, :count]
    return near


def _grouped(cells: NDArray[np.int32], count: int) -> list[NDArray[np.int64]]:
    """Return the positions of every cell, ascending."""
    order = np.argsort(cells, kind="stable")
    return np.split(order, np.searchsorted(cells[order], np.arange(1, count)))
