"""From a map of samples to a map of all vertices of a part, by ZoomOut between bases of different sizes.

By Weyl's law eigenfunction k of a part of area a has the wavelength of eigenfunction k / a of the whole, so the
functional map is rectangular, and its entries lie along a line of that slope (Rodolà, Cosmo, Bronstein, Torsello &
Cremers 2017, "Partial functional correspondence"). It takes functions on the whole to their restrictions, and is not
made orthogonal: what lies outside the part is lost.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clalign.engine import HOST
from clalign.engine.backend import Backend
from clalign.geometry.sampling import VertexOrder
from clalign.maps.functional_maps import MatchedRows, functional_map
from clalign.maps.nearest import Orders, nearest_rows, nearest_vertices
from clalign.mesh.topology import edge_table
from clalign.partial.intervals import Intervals, misfits, tolerances
from clalign.partial.surface import SampledSurface
from clalign.rules.parts import PartGrowthRules, PartSearchRules, PartStart

Fields = tuple[NDArray[np.float64], NDArray[np.float64]]

_VERTICES_AT_ONCE = 200


@dataclass(frozen=True, eq=False)
class GrownMap:
    """A map of all vertices of a part.

    Attributes
    ----------
    whole_of_part : (n,) int64, a vertex of the whole for every vertex of the part.
    functional : (k_part, k_whole), coefficients of a function on the whole to those of its restriction.
    weight : of the fields beside the functions.
    stretch : mean of (l' − l)² / l² over the edges of the part, what is torn cut.
    """

    whole_of_part: NDArray[np.int64]
    functional: NDArray[np.float64]
    weight: float
    stretch: float


def anchored(
    part: SampledSurface,
    whole: SampledSurface,
    lower_rows: NDArray[np.float32],
    places: NDArray[np.int64],
    vertices: NDArray[np.int64],
    rules: PartSearchRules,
) -> NDArray[np.int64]:
    """Return for some vertices of the part (q,) the vertices of the whole whose distances to all matches fit best.

    Parameters
    ----------
    lower_rows : (S, n) lower bounds of distances from the part's samples.
    places : (S,) of the samples.
    """
    distances = np.ascontiguousarray(whole.rows[places][:, whole.samples].T)
    whole_bounds = Intervals(distances[None], distances[None])
    found = np.empty(len(vertices), dtype=np.int64)
    for start in range(0, len(vertices), _VERTICES_AT_ONCE):
        some = vertices[start : start + _VERTICES_AT_ONCE]
        upper, lower = (np.ascontiguousarray(rows[:, some].T)[:, None] for rows in (part.rows, lower_rows))
        wrong = misfits(Intervals(lower, upper), whole_bounds, tolerances(upper, rules))
        found[start : start + len(some)] = wrong.mean(axis=2).argmin(axis=1)
    return whole.samples[found]


def stretch(part: SampledSurface, whole: SampledSurface, whole_of_part: NDArray[np.int64], torn: float) -> float:
    """Return the mean of (l' − l)² / l² over the edges of a part, at most `torn` each: what a good map keeps small."""
    low, high = edge_table(part.mesh.faces, part.mesh.n_vertices).edges.T
    length = np.maximum(np.linalg.norm(part.vertices[low] - part.vertices[high], axis=1), np.finfo(np.float64).tiny)
    images = whole.vertices[whole_of_part]
    there = np.linalg.norm(images[low] - images[high], axis=1)
    return float(np.minimum(((there - length) / length) ** 2, torn).mean())


def grown(
    part: SampledSurface,
    whole: SampledSurface,
    fields: Fields,
    anchors: tuple[NDArray[np.int64], NDArray[np.int64]],
    start: PartStart,
    rules: PartGrowthRules,
    backend: Backend = HOST,
) -> GrownMap:
    """Return the map that rectangular ZoomOut leads to.

    Parameters
    ----------
    fields : (n_part, f) and (n_whole, f) pointwise descriptors that stand beside the functions.
    anchors : (q,) vertices of the part and of the whole that are matched to begin with.
    start : weight of the fields, and functions to begin with.
    """
    weight, size = start.weight, start.functions
    ratio, orders = part.area / whole.area, vertex_orders(part, whole)
    size = min(size, int(rules.share * len(anchors[0])), part.basis.count)
    last = min(rules.last, part.basis.count)
    vertices, matches = anchors
    weights = np.full(len(vertices), 1.0 / len(vertices))
    ridge, guess = rules.ridge, None
    while True:
        wide = min(max(round(size / ratio), 1), whole.basis.count)
        x, y = part.basis.functions[:, :size], whole.basis.functions[:, :wide]
        # The functions are orthonormal over all vertices, but not over some of them.
        gram = None if guess is None else np.eye(size)
        functional = functional_map([MatchedRows(x[vertices], y[matches], weights)], gram, ridge, backend)
        queries, points = embeddings(part, whole, fields, functional, weight)
        found = nearest_vertices(queries[orders[0].vertices], points[orders[1].vertices], orders, guess, backend)
        if size >= last or wide >= whole.basis.count:
            return GrownMap(found, functional, weight, stretch(part, whole, found, rules.torn))
        size = min(size + rules.step, last)
        vertices, matches, weights, guess, ridge = np.arange(len(found)), found, part.mass, found, 0.0


def vertex_orders(part: SampledSurface, whole: SampledSurface) -> Orders:
    """Return the vertices of both in orders in which neighbours follow each other."""
    return VertexOrder.spatial(part.vertices), VertexOrder.spatial(whole.vertices)


def embeddings(
    part: SampledSurface, whole: SampledSurface, fields: Fields, functional: NDArray[np.float64], weight: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return (n_part, k + f) and (n_whole, k + f) rows that lie close together at matched vertices.

    Φ and Ψ Cᵀ, and beside them the fields, weighted as if they were functions of the part.
    """
    size, wide = functional.shape
    scale = weight * np.sqrt(size / part.area / fields[0].shape[1])
    functions = part.basis.functions[:, :size], whole.basis.functions[:, :wide] @ functional.T
    x, y = (np.concatenate([f, scale * g], axis=1).astype(np.float32) for f, g in zip(functions, fields, strict=True))
    return x, y


def back_map(
    part: SampledSurface,
    whole: SampledSurface,
    fields: Fields,
    found: GrownMap,
    region: NDArray[np.int64],
    backend: Backend = HOST,
) -> NDArray[np.int64]:
    """Return a vertex of the part for every vertex of a region (r,) of the whole; (n_whole,), -1 outside of it."""
    points, queries = embeddings(part, whole, fields, found.functional, found.weight)
    order = VertexOrder.spatial(part.vertices)
    back = np.full(len(whole.vertices), -1, dtype=np.int64)
    if region.size:
        back[region] = order.vertices[nearest_rows(queries[region], points[order.vertices], backend=backend)]
    return back
