"""Functional maps from point maps, and what is read from them, in any pair of bases.

A functional map (k_y, k_x) takes coefficients of functions on X to coefficients of functions on Y. It pulls functions
on X back to Y: row i of Ψ C is close to φ at the vertex of X that vertex i of Y is matched with.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clalign.engine import HOST
from clalign.engine.backend import Backend
from clalign.geometry.spectra import Spectrum
from clalign.maps.nearest import point_maps, uploaded
from clalign.maps.point_maps import PointMaps

EQUATIONS_A_FUNCTION = 2
"""Least squares on samples have at least so many equations for every function."""


def told_apart(equations: int) -> int:
    """Return how many functions least squares with so many equations can tell apart."""
    return equations // EQUATIONS_A_FUNCTION


class MatchedRows(NamedTuple):
    """Basis functions at matched points: row i of both belongs to the same match.

    target, source : (m, k_y) and (m, k_x), Ψ and Φ, arrays of the host or of a backend.
    weights : (m,), what each match counts.
    """

    target: Any
    source: Any
    weights: Any


def functional_map(
    matches: Sequence[MatchedRows],
    gram: NDArray[np.floating] | None = None,
    ridge: float = 0.0,
    backend: Backend = HOST,
) -> NDArray[np.float64]:
    """Return the functional map that explains matches best, C = argmin Σ_i w_i |ψ_i C − φ_i|².

    Parameters
    ----------
    matches : of one direction or of both.
    gram : (k_y, k_y), Ψᵀ diag(w) Ψ of the first of the matches where it is known: the identity for all vertices of Y,
        weighted by their mass.
    ridge : added to the diagonal of the normal equations, relative to its mean.

    Returns
    -------
    (k_y, k_x) float64.
    """
    normal, cross = np.zeros(()), np.zeros(())
    if gram is not None:
        normal = np.asarray(gram, dtype=np.float64)
    for number, rows in enumerate(matches):
        target, source, weights = (uploaded(backend, each) for each in rows)
        if number or gram is None:
            normal = normal + backend.numpy(backend.weighted_gram(target, target, weights)).astype(np.float64)
        cross = cross + backend.numpy(backend.weighted_gram(target, source, weights)).astype(np.float64)
    if ridge:
        normal = normal + ridge * np.trace(normal) / len(normal) * np.eye(len(normal))
    return np.asarray(np.linalg.solve(normal, cross), dtype=np.float64)


def two_way_functional_map(
    source: Spectrum, target: Spectrum, maps: PointMaps, size: int | None = None, backend: Backend = HOST
) -> NDArray[np.float64]:
    """Return the functional map (size, size) of the first functions that explains maps of all vertices best."""
    x, y = (backend.array(side.functions[:, :size]) for side in (source, target))
    return two_way_least_squares(x, y, backend.array(source.mass), backend.array(target.mass), maps, backend)


def two_way_least_squares(
    source: Any, target: Any, source_mass: Any, target_mass: Any, maps: PointMaps, backend: Backend = HOST
) -> NDArray[np.float64]:
    """Return what `two_way_functional_map` does from functions (n_x, k), (n_y, k) and masses on the backend.

    (I + PᵀA_X P) C = ΨᵀA_Y Φ[source_of_target] + PᵀA_X Φ with P = Ψ[target_of_source]; Ψ is orthonormal in A_Y.
    """
    pulled = backend.gather(source, backend.array(maps.source_of_target.astype(np.int32)))
    carried = backend.gather(target, backend.array(maps.target_of_source.astype(np.int32)))
    matches = MatchedRows(target, pulled, target_mass), MatchedRows(carried, source, source_mass)
    return functional_map(matches, np.eye(target.shape[1]), backend=backend)


def polar_factor(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the orthogonal matrices nearest to matrices (…, k, k): U Vᵀ of their decompositions U Σ Vᵀ.

    From the eigenvectors of CᵀC, which cost a third of the decomposition; from the decomposition itself where a matrix
    is so nearly singular that its square would lose what the factor needs.
    """
    squares, right = np.linalg.eigh(np.swapaxes(matrices, -1, -2) @ matrices)
    if np.any(squares[..., 0] <= 1e-4 * squares[..., -1]):
        left, _, transposed = np.linalg.svd(matrices, full_matrices=False)
        return np.asarray(left @ transposed)
    return np.asarray(matrices @ ((right / np.sqrt(squares)[..., None, :]) @ np.swapaxes(right, -1, -2)))


def singular_value_weighting(functional: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return what weights each singular direction of a two-way functional map by its singular value (at most 1).

    In the two-way least squares a singular value is the correlation, over both surfaces, between a function on X and
    its image on Y: 1 where the shapes agree, less where they are not isometric. A nearest neighbour weighted so listens
    to the directions that are known well. With all weights 1 it would be the orthogonalised functional map.

    With C = U Σ Vᵀ and W = min(Σ, 1) these are V W Vᵀ and U W Vᵀ: the last factor changes no distance, and turns back
    to the functions of the source. The low ones, which tell apart what is far from each other, come first, so that most
    pairs are told apart by them (see `nearest`).

    Returns
    -------
    (k_x, k_x) and (k_y, k_x), to be multiplied from the right to the functions of source and target; the products lie
    close together at matched vertices.
    """
    squares, right = np.linalg.eigh(functional.T @ functional)
    values = np.sqrt(np.maximum(squares, 0.0))
    source = (right * np.minimum(values, 1.0)) @ right.T
    return source, functional @ ((right * np.minimum(1.0, 1.0 / np.maximum(values, 1e-12))) @ right.T)


def functional_point_maps(
    functional: NDArray[np.floating],
    source: NDArray[np.floating],
    target: NDArray[np.floating],
    backend: Backend = HOST,
) -> PointMaps:
    """Return the point maps of a functional map: nearest neighbours both ways between the rows of Ψ C and of Φ.

    Using one embedding for both directions keeps them consistent where C is not orthogonal (there C φ_j is shrunk, and
    drawn to vertices of small norm).

    Parameters
    ----------
    functional : (k_y, k_x).
    source, target : (n_x, k_x) and (n_y, k_y) basis functions at vertices.
    """
    return point_maps(np.asarray(source), np.asarray(target @ functional), backend=backend)
