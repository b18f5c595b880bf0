"""From a map between samples to maps between all vertices: spectral up-sampling and closed-form steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.alignment.band import band_mask
from clalign.alignment.rotation import StartingRotation, starting_rotation
from clalign.engine.backend import Backend
from clalign.engine.band import Band
from clalign.geometry.shape import Shape
from clalign.geometry.spectra import Spectrum
from clalign.maps.functional_maps import (
    PointMaps,
    coherent_directions,
    functional_point_maps,
    orthogonalised,
    point_maps,
    two_way_functional_map,
    two_way_least_squares,
    wavelet_filtered,
)
from clalign.maps.nearest import Orders, VertexOrder, nearest_in_order
from clalign.maps.sampling import Samples, spread_samples
from clalign.refinement.pointwise import Kind, pointwise_fields
from clalign.search.batch import Level, SamplePair, up_sample
from clalign.search.sampled import sampled
from clalign.search.score import map_scores

UP_SAMPLING_QUERIES = 1000


@dataclass(frozen=True)
class Growth:
    """How a functional map is grown.

    start : functions that are kept of it; None keeps all.
    step : functions added at a time.
    strength : variance of the pointwise fields beside the eigenfunctions, relative to theirs.
    fields : which fields; see `fields.pointwise_fields`.
    """

    start: int | None = None
    step: int = 10
    strength: float = 0.0
    fields: Kind = "curvatures"


GROWTHS = (
    Growth(None, 20),
    Growth(40, 20, 0.2, "signatures"),
    Growth(30, 20, 0.1, "curvatures"),
    Growth(15, 20, 0.5, "oriented"),
    Growth(25, 20, 0.25, "oriented"),
)


def up_sampled(
    backend: Backend,
    source: Shape,
    target: Shape,
    functional: NDArray[np.float64],
    size: int,
    growth: Growth = GROWTHS[0],
    orders: Orders | None = None,
    samples: Samples | None = None,
) -> NDArray[np.float64]:
    """Return the functional map grown to `size` functions (ZoomOut on samples of Y against all vertices of X).

    Every point map is read from the orthogonalised functional map: an isometry's is orthogonal. Pointwise fields stand
    beside the eigenfunctions with a strength that grows with their number.

    Parameters
    ----------
    functional : (k, k), where to start.
    orders : of the vertices of both shapes, or None to make them.
    samples : of the target, or None to make them.
    """
    order_x, order_y = orders or (
        VertexOrder.in_space(source.mesh.vertices),
        VertexOrder.in_space(target.mesh.vertices),
    )
    spread = samples or spread_samples(target, UP_SAMPLING_QUERIES)
    placed = np.argsort(order_y.places[spread.vertices])
    queried, weights = spread.vertices[placed], spread.weights[placed]
    largest = min(size, source.basis.count, target.basis.count, queried.size // 2)
    basis, functions = target.basis.functions[queried, :largest], source.basis.functions[order_x.vertices, :largest]
    weighted = basis * weights[:, None]
    gram = basis.T @ weighted
    kept = min(growth.start or len(functional), len(functional), largest)
    sizes = [*range(kept + growth.step, largest, growth.step), largest]
    if growth.start is not None:
        sizes = [kept, kept, *sizes]
    functional = functional[:kept, :kept]
    field_x, field_y = pointwise_fields(source, target, functional, growth.fields)
    field_x, field_y = field_x[order_x.vertices], field_y[queried]
    index = None
    for wanted in sizes:
        current = len(functional)
        scale = np.sqrt(growth.strength * current / field_x.shape[1])
        queries = np.concatenate([basis[:, :current] @ orthogonalised(functional), scale * field_y], axis=1)
        rows = np.concatenate([functions[:, :current], scale * field_x], axis=1, dtype=backend.dtype)
        points = backend.array(rows)
        index = nearest_in_order(backend, backend.array(queries), points, backend.half_squares(points), index)
        pulled = weighted[:, :wanted].T @ functions[index, :wanted]
        functional = np.asarray(np.linalg.solve(gram[:wanted, :wanted], pulled), dtype=np.float64)
    return functional


def best_grown(
    backend: Backend, source: Shape, target: Shape, functional: NDArray[np.float64], size: int
) -> NDArray[np.float64]:
    """Return the best of the functional maps that `GROWTHS` give, by the score that also chose among candidates.

    Where the low functions leave a part open, different growths turn it differently; the score tells them apart.
    """
    orders = VertexOrder.in_space(source.mesh.vertices), VertexOrder.in_space(target.mesh.vertices)
    samples = spread_samples(target, UP_SAMPLING_QUERIES)
    grown = [up_sampled(backend, source, target, functional, size, growth, orders, samples) for growth in GROWTHS]
    pair = SamplePair(sampled(source), sampled(target), backend)
    level = pair.fit(Level(len(grown[0]), UP_SAMPLING_QUERIES, UP_SAMPLING_QUERIES))
    cut = np.array([each[: level.size, : level.size] for each in grown], dtype=np.float32)
    batch = up_sample(pair, cut, [level])
    return grown[int(np.argmin(map_scores(pair, batch, level.points)))]


def vertex_maps(backend: Backend, source: Shape, target: Shape, functional: NDArray[np.float64]) -> PointMaps:
    """Return the maps between all vertices of a functional map in the LBO bases, orthogonalised."""
    size = len(functional)
    return functional_point_maps(
        backend, orthogonalised(functional), source.basis.functions[:, :size], target.basis.functions[:, :size]
    )


def wavelet_steps(backend: Backend, source: Shape, target: Shape, maps: PointMaps, steps: int) -> PointMaps:
    """Return the maps after `steps` two-way steps in the whole LBO basis with Meyer wavelet filters."""
    size = min(source.basis.count, target.basis.count)
    x, y = source.basis, target.basis
    for _ in range(steps):
        functional = wavelet_filtered(
            two_way_functional_map(backend, x, y, maps, size), x.eigenvalues[:size], y.eigenvalues[:size]
        )
        maps = vertex_maps(backend, source, target, functional)
    return maps


def closed_form_rotation(
    backend: Backend, source: Spectrum, target: Spectrum, maps: PointMaps, band: Band, one_sided: bool
) -> StartingRotation:
    """Return the R that explains `maps` best, by two-way least squares, projection and square root (no losses).

    Parameters
    ----------
    source, target : scale-invariant eigenfunctions, at least as many as `band` has rows.
    """
    functional = two_way_functional_map(backend, source, target, maps, band.size)
    return starting_rotation(functional, band_mask(band), one_sided=one_sided)


@dataclass(frozen=True, eq=False)
class BoundSpectra:
    """Eigenfunctions of both shapes on a backend.

    Attributes
    ----------
    source, target : (n_x, d) and (n_y, d).
    source_mass, target_mass : (n_x,) and (n_y,), in which they are orthonormal.
    """

    source: Any
    target: Any
    source_mass: Any
    target_mass: Any

    @staticmethod
    def of(backend: Backend, source: Spectrum, target: Spectrum) -> BoundSpectra:
        """Bring the functions of two spectra to a backend."""
        functions = backend.array(source.functions), backend.array(target.functions)
        return BoundSpectra(*functions, backend.array(source.mass), backend.array(target.mass))


def coherent_embeddings(backend: Backend, spectra: BoundSpectra, maps: PointMaps) -> tuple[Any, Any]:
    """Return the eigenfunctions of both shapes turned onto each other, weighted by coherence.

    Returns
    -------
    (n_x, d) and (n_y, d), arrays of the backend.
    """
    x, y = spectra.source, spectra.target
    functional = two_way_least_squares(backend, x, y, spectra.source_mass, spectra.target_mass, maps)
    directions = coherent_directions(functional)
    return backend.product(x, backend.array(directions.source)), backend.product(y, backend.array(directions.target))


def coherent_steps(backend: Backend, source: Spectrum, target: Spectrum, maps: PointMaps, steps: int) -> PointMaps:
    """Return the maps after `steps` two-way steps among the scale-invariant eigenfunctions, weighted by coherence."""
    spectra = BoundSpectra.of(backend, source, target)
    for _ in range(steps):
        maps = point_maps(backend, *coherent_embeddings(backend, spectra, maps), guess=maps)
    return maps
