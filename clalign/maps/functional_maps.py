"""Functional maps from point maps and back, in any pair of bases.

Directions: `target_of_source` (n_x,) holds for every vertex of X a vertex of Y, `source_of_target` (n_y,) the reverse.
A functional map (k_y, k_x) takes coefficients of functions on X to coefficients of functions on Y.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from clalign.engine.backend import Backend
from clalign.geometry.spectra import Spectrum
from clalign.maps.inverted_file import nearest_in_cells
from clalign.maps.nearest import Orders, VertexOrder, in_order, nearest_vertices, numbered

EXHAUSTIVE = 400_000_000
"""Pairs of rows up to which every pair is compared; about 20,000 vertices on each side."""


@dataclass(frozen=True)
class PointMaps:
    """A map and its reverse, each found on its own.

    Attributes
    ----------
    target_of_source : (n_x,) int64.
    source_of_target : (n_y,) int64.
    """

    target_of_source: NDArray[np.int64]
    source_of_target: NDArray[np.int64]


def nearest_rows(backend: Backend, queries: NDArray[np.floating], points: NDArray[np.floating]) -> NDArray[np.int64]:
    """Return for each row of `queries` (m, k) the nearest row of `points` (p, k), as (m,) int64.

    Exhaustive, m p k operations, up to `EXHAUSTIVE` pairs; beyond, among cells of close points (see
    `near_cells.nearest_in_cells`), which misses the nearest for about one row in a thousand, and then by little.
    """
    if queries.shape[0] * points.shape[0] > EXHAUSTIVE:
        return nearest_in_cells(backend, queries, points)
    places = backend.array(np.ascontiguousarray(points))
    index, _ = backend.nearest(backend.array(np.ascontiguousarray(queries)), places, backend.half_squares(places))
    return backend.numpy(index).astype(np.int64)


def point_maps(
    backend: Backend,
    source_embedding: Any,
    target_embedding: Any,
    orders: Orders | None = None,
    guess: PointMaps | None = None,
) -> PointMaps:
    """Return nearest neighbours both ways between two aligned embeddings.

    Parameters
    ----------
    source_embedding, target_embedding : (n_x, d) and (n_y, d), arrays of the backend.
    orders : of the vertices of both shapes; the better, the faster; None takes them as they are numbered.
    guess : maps that are nearly right, or None.
    """
    if orders is None:
        orders = VertexOrder.given(source_embedding.shape[0]), VertexOrder.given(target_embedding.shape[0])
        return point_maps_in_order(backend, source_embedding, target_embedding, orders, guess)
    turned = in_order(backend, source_embedding, orders[0]), in_order(backend, target_embedding, orders[1])
    return point_maps_in_order(backend, *turned, orders, guess)


def point_maps_in_order(
    backend: Backend, source_embedding: Any, target_embedding: Any, orders: Orders, guess: PointMaps | None = None
) -> PointMaps:
    """Return what `point_maps` does from embeddings whose rows are in the orders that are given."""
    forward, backward = both_directions(guess)
    return PointMaps(
        matched(backend, source_embedding, target_embedding, orders, forward),
        matched(backend, target_embedding, source_embedding, orders[::-1], backward),
    )


class TwoWay(Protocol):
    """Maps in both directions, of all vertices or of some."""

    @property
    def target_of_source(self) -> NDArray[np.int64]:
        """A vertex of Y for every one of X."""

    @property
    def source_of_target(self) -> NDArray[np.int64]:
        """A vertex of X for every one of Y."""


def both_directions(maps: TwoWay | None) -> tuple[NDArray[np.int64] | None, NDArray[np.int64] | None]:
    """Return target_of_source and source_of_target of maps that may be missing."""
    return (None, None) if maps is None else (maps.target_of_source, maps.source_of_target)


def matched(
    backend: Backend, queries: Any, points: Any, orders: Orders, guess: NDArray[np.int64] | None = None
) -> NDArray[np.int64]:
    """Return for each vertex of one shape the nearest of the other, as (m,) int64; see `nearest_rows`.

    Parameters
    ----------
    queries, points : (m, d) and (p, d), arrays of the backend with rows in the orders of their shapes.
    orders : of the shape of the queries and of that of the points.
    guess : (m,) vertices that are nearly right, or None.
    """
    if queries.shape[0] * points.shape[0] > EXHAUSTIVE:
        return numbered(nearest_in_cells(backend, backend.numpy(queries), backend.numpy(points)), orders)
    return nearest_vertices(backend, queries, points, orders, guess)


def functional_point_maps(
    backend: Backend, functional: NDArray[np.floating], source: NDArray[np.floating], target: NDArray[np.floating]
) -> PointMaps:
    """Return the point maps of a functional map: nearest neighbours both ways between the rows of Ψ C and of Φ.

    C pulls functions on X back to Y, so row i of Ψ C is close to φ at the vertex of X that i is matched with. Using one
    embedding for both directions keeps them consistent where C is not orthogonal (there C φ_j is shrunk, and drawn to
    vertices of small norm).

    Parameters
    ----------
    functional : (k_y, k_x).
    source, target : (n_x, k_x) and (n_y, k_y) basis functions at vertices.
    """
    return point_maps(
        backend, backend.array(np.ascontiguousarray(source)), backend.array(np.ascontiguousarray(target @ functional))
    )


def argmax_map(
    backend: Backend,
    functional: NDArray[np.floating],
    source: NDArray[np.floating],
    target: NDArray[np.floating],
    weights: NDArray[np.floating],
) -> NDArray[np.int64]:
    """Return target_of_source as the arg-max of each column of the soft map (Eq. 16, 28).

    Parameters
    ----------
    weights : (n_y,) row weights of P; ones give the paper's form.
    """
    index, _ = backend.soft_map_argmax(
        backend.array(np.ascontiguousarray(source @ functional.T)),
        backend.array(np.ascontiguousarray(target)),
        backend.array(weights),
    )
    return backend.numpy(index).astype(np.int64)


def functional_map(
    source: Spectrum, target: Spectrum, source_of_target: NDArray[np.int64], size: int | None = None
) -> NDArray[np.float64]:
    """Return ΨᵀA_Y Φ[source_of_target], the functional map of a point map.

    Parameters
    ----------
    size : number of functions used on both sides (default all).
    """
    pulled = source.functions[source_of_target, :size]
    return target.functions[:, :size].T @ (target.mass[:, None] * pulled)


def two_way_functional_map(
    backend: Backend, source: Spectrum, target: Spectrum, maps: PointMaps, size: int | None = None
) -> NDArray[np.float64]:
    """Return the functional map that explains the maps of both directions best.

    Minimises ‖Ψ C − Φ[source_of_target]‖²_{A_Y} + ‖Ψ[target_of_source] C − Φ‖²_{A_X}:
    (I + PᵀA_X P) C = ΨᵀA_Y Φ[source_of_target] + PᵀA_X Φ with P = Ψ[target_of_source].
    """
    x, y = (backend.array(np.ascontiguousarray(side.functions[:, :size])) for side in (source, target))
    return two_way_least_squares(backend, x, y, backend.array(source.mass), backend.array(target.mass), maps)


def two_way_least_squares(
    backend: Backend, source: Any, target: Any, mass_x: Any, mass_y: Any, maps: PointMaps
) -> NDArray[np.float64]:
    """Return what `two_way_functional_map` does from functions (n_x, k), (n_y, k) and masses on the backend."""
    pulled = backend.gather(source, backend.array(maps.source_of_target.astype(np.int32)))
    carried = backend.gather(target, backend.array(maps.target_of_source.astype(np.int32)))
    forward = backend.numpy(backend.weighted_gram(target, pulled, mass_y))
    backward = backend.numpy(backend.weighted_gram(carried, source, mass_x))
    gram = backend.numpy(backend.weighted_gram(carried, carried, mass_x)).astype(np.float64)
    gram[np.diag_indices(len(gram))] += 1.0
    both = forward.astype(np.float64) + backward.astype(np.float64)
    return np.asarray(np.linalg.solve(gram, both), dtype=np.float64)


def wavelet_filtered(
    functional: NDArray[np.float64], source: NDArray[np.float64], target: NDArray[np.float64], bands: int = 6
) -> NDArray[np.float64]:
    """Return Σ_s g_s(Λ_Y) C g_s(Λ_X) with Meyer filters g_s over log₂ λ (Hu et al., multiscale wavelets, 2021).

    Entries that join frequencies of different bands are damped; Σ g_s² = 1.

    Parameters
    ----------
    source, target : (k_x,) and (k_y,) eigenvalues.
    """
    filters_x, filters_y = (_meyer_filters(values, max(source[-1], target[-1]), bands) for values in (source, target))
    return np.einsum("si,ij,sj->ij", filters_y, functional, filters_x, optimize=True)


def _meyer_filters(eigenvalues: NDArray[np.float64], largest: float, bands: int) -> NDArray[np.float64]:
    """Return (bands + 1, k): one low-pass and `bands` octave filters whose squares sum to one."""
    position = np.clip(bands + np.log2(np.maximum(eigenvalues / largest, 1e-12)), 0.0, bands - 1e-9)
    octave = np.floor(position).astype(int)
    ramp = position - octave
    smooth = ramp**4 * (35 - 84 * ramp + 70 * ramp**2 - 20 * ramp**3)
    filters = np.zeros((bands + 1, eigenvalues.size))
    columns = np.arange(eigenvalues.size)
    filters[octave, columns] = np.cos(0.5 * np.pi * smooth)
    filters[octave + 1, columns] = np.sin(0.5 * np.pi * smooth)
    return filters


@dataclass(frozen=True)
class Coherence:
    """How well two shapes agree, direction by direction, as what brings their functions together.

    Attributes
    ----------
    source : (k_x, k_x), to be multiplied from the right to the source's functions.
    target : (k_y, k_x), to the target's; the products lie close together at matched vertices.
    """

    source: NDArray[np.float64]
    target: NDArray[np.float64]


def coherent_directions(functional: NDArray[np.float64]) -> Coherence:
    """Return what weights each singular direction of a two-way functional map by its singular value (at most 1).

    In the two-way least squares a singular value is the correlation, over both surfaces, between a function on X and
    its image on Y: 1 where the shapes agree, less where they are not isometric. A nearest neighbour weighted so listens
    to the directions that are known well. With all weights 1 it would be the orthogonalised functional map.

    With C = U Σ Vᵀ and W = min(Σ, 1) these are V W Vᵀ and U W Vᵀ: the last factor changes no distance, and turns back
    to the functions of the source. The low ones, which tell apart what is far from each other, come first, so that most
    pairs are told apart by them (see `nearness`).
    """
    left, values, right = np.linalg.svd(functional, full_matrices=False)
    weights = np.minimum(values, 1.0)
    return Coherence((right.T * weights) @ right, (left * weights) @ right)


def orthogonalised(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the orthogonal matrix nearest to `matrix` (its polar factor)."""
    left, _, right = np.linalg.svd(matrix, full_matrices=False)
    return left @ right
