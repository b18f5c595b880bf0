"""From R to vertices: the hard map Π by arg-max (Eq. 16, 28) or by nearest aligned eigenfunctions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.alignment.objective import Objective
from clalign.engine import HOST
from clalign.engine.backend import Backend
from clalign.maps.nearest import nearest_rows, nearest_vertices, permuted
from clalign.maps.point_maps import PointMaps
from clalign.options import Readout


def argmax_map(
    functional: NDArray[np.floating],
    source: NDArray[np.floating],
    target: NDArray[np.floating],
    weights: NDArray[np.floating],
    backend: Backend = HOST,
) -> NDArray[np.int64]:
    """Return target_of_source (n_x,) as the arg-max of each column of the soft map (Eq. 16, 28).

    Parameters
    ----------
    functional : (k_y, k_x) C.
    source, target : (n_x, k_x) and (n_y, k_y), Φ and Ψ.
    weights : (n_y,) row weights of P; ones give the paper's form.
    """
    index, _ = backend.soft_map_argmax(
        backend.array(source @ functional.T), backend.array(target), backend.array(weights)
    )
    return backend.numpy(index).astype(np.int64)


def hard_map(
    objective: Objective,
    rotation: NDArray[np.float64],
    readout: Readout,
    guess: NDArray[np.int64] | None = None,
) -> NDArray[np.int64]:
    """Return target_of_source (n_x,) of R: nearest neighbours ("aligned") or Eq. 28 ("argmax").

    A map that is nearly right, as `guess`, saves time and does not change the result.
    """
    source, target, backend = objective.source, objective.target, objective.backend
    if readout == "aligned":
        return nearest_vertices(*_embeddings(objective, rotation), objective.orders, guess, backend)
    functional = objective.functional_map(rotation)
    return argmax_map(functional, source.basis, target.basis, target.soft_weights, backend)


def read_out(
    objective: Objective,
    rotation: NDArray[np.float64],
    readout: Readout,
    target_of_source: NDArray[np.int64] | None = None,
    guess: PointMaps | None = None,
) -> PointMaps:
    """Return both maps of R; `target_of_source` is taken as it is where it is known already, `guess` saves time.

    The reverse of Eq. 28, which the paper does not define, is the nearest neighbour in functional-map space.
    """
    forward = target_of_source
    if forward is None:
        forward = hard_map(objective, rotation, readout, None if guess is None else guess.target_of_source)
    if readout == "aligned":
        x, y = _embeddings(objective, rotation)
        back = None if guess is None else guess.source_of_target
        return PointMaps(forward, nearest_vertices(y, x, objective.orders[::-1], back, objective.backend))
    pulled = objective.target.basis @ objective.functional_map(rotation)
    return PointMaps(forward, nearest_rows(pulled, objective.source.basis, backend=objective.backend))


def _embeddings(objective: Objective, rotation: NDArray[np.float64]) -> tuple[Any, Any]:
    """Return the aligned eigenfunctions of both shapes with their rows in the orders of the objective."""
    x, y = objective.embeddings(rotation)
    order_x, order_y = objective.orders
    return permuted(x, order_x, objective.backend), permuted(y, order_y, objective.backend)
