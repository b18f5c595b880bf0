"""Nearest neighbours between embedded vertices, in an order that saves most of the work.

A backend gives up a group of points early when none of them can be the nearest of a group of queries any more; that
happens the sooner the more alike the members of a group are, and the better the match that is known already. So rows
are given in an order in which neighbours follow each other (`VertexOrder`), and every query starts from a guess: its
match of the step before, or its nearest among a few of the points. Neither changes what is found, but that of points at
exactly the same distance the first in that order is taken.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.engine import HOST
from clalign.engine.backend import Backend
from clalign.geometry.sampling import VertexOrder
from clalign.maps.inverted_file import nearest_in_cells
from clalign.maps.point_maps import PointMaps

EXHAUSTIVE = 400_000_000
"""Pairs of rows up to which every pair is compared, about 20,000 vertices on each side; ..."""

FEW = 2000
"""... so few rows are compared with every other one, however many these are."""

COARSE = 8
"""Without a guess, every so many points are searched first ..."""

WORTH_A_GUESS = 4096
"""... if there are so many, below which the search itself is as quick."""

Orders = tuple[VertexOrder, VertexOrder]


def uploaded(backend: Backend, rows: Any) -> Any:
    """Return an array of the backend from one of the host, or the array itself if it is there already."""
    return backend.array(rows) if isinstance(rows, np.ndarray) else rows


def _on_host(backend: Backend, rows: Any) -> NDArray[Any]:
    return rows if isinstance(rows, np.ndarray) else backend.numpy(rows)


def permuted(rows: Any, order: VertexOrder, backend: Backend = HOST) -> Any:
    """Return the rows of an embedding (n, k) in an order of its vertices, on the backend."""
    return backend.gather(uploaded(backend, rows), backend.array(order.vertices.astype(np.int32)))


def beside(
    embedded: Any, descriptors: NDArray[np.floating] | None, factor: NDArray[np.floating], backend: Backend
) -> Any:
    """Return an embedding (n, r) on the backend with descriptors beside it, (n, r + f); itself where there are none.

    Parameters
    ----------
    descriptors : (n, f) on the host, rows as those of the embedding, with variances that sum to their weight.
    factor : (k, r), by which orthonormal functions were turned into the embedding: it says how large that is.
    """
    if descriptors is None:
        return embedded
    scaled = (np.linalg.norm(factor) * descriptors).astype(backend.dtype)
    return backend.array(np.concatenate([backend.numpy(embedded), scaled], axis=1))


def nearest_rows(
    queries: Any, points: Any, guess: NDArray[np.integer] | None = None, backend: Backend = HOST
) -> NDArray[np.int64]:
    """Return for each row of `queries` (m, k) the nearest row of `points` (p, k), as (m,) int64.

    Exhaustive, m p k operations, up to `EXHAUSTIVE` pairs; beyond, among cells of close points (see
    `inverted_file.nearest_in_cells`), which misses the nearest for about one row in a thousand, and then by little.

    Parameters
    ----------
    queries, points : arrays of the host or of the backend.
    guess : (m,) rows of `points` that are nearly right, or None to find guesses first.
    """
    counts = queries.shape[0], points.shape[0]
    if min(counts) > FEW and counts[0] * counts[1] > EXHAUSTIVE:
        return nearest_in_cells(backend, _on_host(backend, queries), _on_host(backend, points))
    sought, places = uploaded(backend, queries), uploaded(backend, points)
    guessed = None
    if guess is not None:
        guessed = backend.array(guess.astype(np.int32))
    elif counts[1] >= WORTH_A_GUESS:
        some = np.arange(0, counts[1], COARSE, dtype=np.int32)
        few = backend.gather(places, backend.array(some))
        found, _ = backend.nearest(sought, few, backend.half_squares(few))
        guessed = backend.array(some[backend.numpy(found)])
    index, _ = backend.nearest(sought, places, backend.half_squares(places), guess=guessed)
    return np.asarray(backend.numpy(index), dtype=np.int64)


def nearest_vertices(
    queries: Any, points: Any, orders: Orders, guess: NDArray[np.int64] | None = None, backend: Backend = HOST
) -> NDArray[np.int64]:
    """Return for each vertex of one shape the nearest of the other, as (m,) int64; see `nearest_rows`.

    Parameters
    ----------
    queries, points : (m, k) and (p, k), rows in the orders of their vertices.
    orders : of the queries and of the points.
    guess : (m,) vertices that are nearly right, or None.
    """
    here, there = orders
    placed = None if guess is None else there.inverse[guess[here.vertices]]
    found = np.empty(here.vertices.size, dtype=np.int64)
    found[here.vertices] = there.vertices[nearest_rows(queries, points, placed, backend)]
    return found


def point_maps(
    source: Any, target: Any, orders: Orders | None = None, guess: PointMaps | None = None, backend: Backend = HOST
) -> PointMaps:
    """Return nearest neighbours both ways between two aligned embeddings.

    Parameters
    ----------
    source, target : (n_x, d) and (n_y, d), rows in the orders of their vertices.
    orders : of the vertices of both shapes; None as they are numbered.
    guess : maps that are nearly right, or None.
    """
    x, y = uploaded(backend, source), uploaded(backend, target)
    order_x, order_y = orders or (VertexOrder.identity(x.shape[0]), VertexOrder.identity(y.shape[0]))
    return PointMaps(
        nearest_vertices(x, y, (order_x, order_y), None if guess is None else guess.target_of_source, backend),
        nearest_vertices(y, x, (order_y, order_x), None if guess is None else guess.source_of_target, backend),
    )
