"""Nearest neighbours both ways between the embedded vertices of two shapes, in an order that saves most of the work.

A backend gives up a group of points early when none of them can be the nearest of a group of queries any more; that
happens the sooner the more alike the members of a group are, and the better the match that is known already. So the
vertices of each shape are taken in an order in which neighbours follow each other, and every query starts from a guess:
its match of the step before, or its nearest among a few of the points. Neither changes what is found, but that of
points at exactly the same distance the first in that order is taken.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.engine.backend import Backend
from clalign.geometry.sampling import VertexOrder

COARSE = 8
"""Without a guess, every so many points are searched first ..."""

WORTH_A_GUESS = 4096
"""... if there are so many, below which the search itself is as quick."""


Orders = tuple[VertexOrder, VertexOrder]


def nearest_in_order(
    backend: Backend, queries: Any, points: Any, penalty: Any, guess: NDArray[np.integer] | None = None
) -> NDArray[np.int32]:
    """Return for each row of `queries` (m, k) the nearest row of `points` (p, k), both in a good order, as (m,) int32.

    Parameters
    ----------
    queries, points : arrays of the backend.
    penalty : half the squared norms of the points, on the backend.
    guess : (m,) rows of `points`, or None to find guesses first.
    """
    if guess is not None:
        guessed = backend.array(guess.astype(np.int32))
    elif points.shape[0] < WORTH_A_GUESS:
        guessed = None
    else:
        some = np.arange(0, points.shape[0], COARSE, dtype=np.int32)
        few = backend.gather(points, backend.array(some))
        found, _ = backend.nearest(queries, few, backend.half_squares(few))
        guessed = backend.array(some[backend.numpy(found)])
    index, _ = backend.nearest(queries, points, penalty, guess=guessed)
    return np.asarray(backend.numpy(index), dtype=np.int32)


def nearest_vertices(
    backend: Backend, queries: Any, points: Any, orders: Orders, guess: NDArray[np.int64] | None = None
) -> NDArray[np.int64]:
    """Return for each vertex of one shape the nearest of the other, (m,) int64, from embeddings in order.

    Parameters
    ----------
    queries, points : (m, k) and (p, k), arrays of the backend; row i belongs to the vertex at place i of its order.
    orders : of the shape of the queries and of that of the points.
    guess : (m,) vertices, for every vertex in its number.
    """
    here, there = orders
    placed = None if guess is None else there.inverse[guess[here.vertices]]
    return numbered(nearest_in_order(backend, queries, points, backend.half_squares(points), placed), orders)


def numbered(index: NDArray[np.integer], orders: Orders) -> NDArray[np.int64]:
    """Return a map between places (m,) as one between vertices: of the shape of the queries and that of the points."""
    here, there = orders
    found = np.empty(index.size, dtype=np.int64)
    found[here.vertices] = there.vertices[index]
    return found


def in_order(backend: Backend, embedding: Any, order: VertexOrder) -> Any:
    """Return the rows of an array of the backend (n, k) in an order of its vertices."""
    return backend.gather(embedding, backend.array(order.vertices.astype(np.int32)))
