"""From the functional map of the search to maps between all vertices: ZoomOut by schedules, and two-way steps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.engine.backend import Backend
from clalign.geometry.sampling import Samples
from clalign.geometry.shape import Shape
from clalign.geometry.spectra import Spectrum
from clalign.maps.functional_maps import (
    MatchedRows,
    functional_map,
    functional_point_maps,
    polar_factor,
    singular_value_weighting,
    told_apart,
    two_way_least_squares,
)
from clalign.maps.nearest import Orders, beside, nearest_rows, permuted, point_maps
from clalign.maps.point_maps import PointMaps
from clalign.maps.sampling import SampledBasis
from clalign.maps.zoomout import zoomout
from clalign.refinement.pointwise import pointwise_descriptors
from clalign.rules import RefinementRules, Rules, ZoomOutSchedule
from clalign.search.batch import SamplePair, up_sample
from clalign.search.score import map_scores


def grown_map(
    source: Shape,
    target: Shape,
    functional: NDArray[np.float64],
    size: int,
    schedule: ZoomOutSchedule,
    rules: RefinementRules,
    backend: Backend,
) -> NDArray[np.float64]:
    """Return the functional map grown to `size` functions (ZoomOut on samples of Y against all vertices of X).

    Every point map is read from the polar factor of the functional map: an isometry's is orthogonal. Pointwise
    descriptors, those of the user too, stand beside the eigenfunctions with a strength that grows with their number.

    Parameters
    ----------
    functional : (k, k), where to start.
    """
    queried = _in_order(target.samples(rules.queries), target)
    order = source.order.vertices
    largest = min(size, source.basis.count, target.basis.count, told_apart(queried.vertices.size))
    basis, functions = target.basis.functions[queried.vertices, :largest], source.basis.functions[order, :largest]
    gram = basis.T @ (basis * queried.weights[:, None])
    kept = min(schedule.start or len(functional), len(functional), largest)
    sizes = [*range(kept + schedule.step, largest, schedule.step), largest]
    if schedule.start is not None:
        sizes = [*schedule.repeats * [kept], *sizes]
    functional = functional[:kept, :kept]
    beside_x, beside_y = pointwise_descriptors(source, target, functional, schedule.descriptors, rules)
    beside_x, beside_y = beside_x[order], beside_y[queried.vertices]
    given_x, given_y = _weighted(source, order), _weighted(target, queried.vertices)

    def read(current: NDArray[np.float64], guess: NDArray[np.int64] | None, _: int) -> NDArray[np.int64]:
        count = len(current)
        scale = np.sqrt(schedule.strength * count / beside_x.shape[1])
        queries = np.concatenate(
            [basis[:, :count] @ polar_factor(current), scale * beside_y, np.sqrt(count) * given_y], axis=1
        )
        own = functions[:, :count], scale * beside_x, np.sqrt(count) * given_x
        points = np.concatenate(own, axis=1, dtype=backend.dtype)
        return nearest_rows(queries, points, guess, backend)

    def fit(index: NDArray[np.int64], wanted: int) -> NDArray[np.float64]:
        rows = MatchedRows(basis[:, :wanted], functions[index, :wanted], queried.weights)
        return functional_map([rows], gram[:wanted, :wanted])

    return zoomout(sizes, read, fit, functional=functional)[0]


def _weighted(shape: Shape, vertices: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the user's descriptors of some vertices (m,), with their weight; (m, 0) without."""
    return np.zeros((len(vertices), 0)) if shape.given is None else shape.given.weighted[vertices]


def _in_order(samples: Samples, shape: Shape) -> Samples:
    """Return samples in the order of the shape's vertices."""
    order = np.argsort(shape.order.inverse[samples.vertices])
    return Samples(samples.vertices[order], samples.weights[order])


def best_grown_map(
    source: Shape, target: Shape, functional: NDArray[np.float64], size: int, rules: Rules, backend: Backend
) -> NDArray[np.float64]:
    """Return the best of the functional maps that the schedules give, by the score that also chose among candidates.

    Where the low functions leave a part open, different schedules turn it differently; the score tells them apart.
    """
    inside = rules.refinement
    grown = [grown_map(source, target, functional, size, each, inside, backend) for each in inside.schedules]
    pair = SamplePair.of(source, target, backend)
    level = pair.fit(len(grown[0]), inside.queries, inside.queries)
    cut = np.array([each[: level.size, : level.size] for each in grown], dtype=np.float32)
    scores = map_scores(pair, up_sample(pair, cut, [level]), level.points, rules.search)
    return grown[int(np.argmin(scores))]


def vertex_maps(source: Shape, target: Shape, functional: NDArray[np.float64], backend: Backend) -> PointMaps:
    """Return the maps between all vertices of a functional map in the Laplace–Beltrami bases, by its polar factor."""
    size = len(functional)
    return functional_point_maps(
        polar_factor(functional), source.basis.functions[:, :size], target.basis.functions[:, :size], backend
    )


def sampled_bases(
    source: Shape, target: Shape, spectra: tuple[Spectrum, Spectrum], rules: RefinementRules, backend: Backend
) -> tuple[SampledBasis, SampledBasis]:
    """Return eigenfunctions of both shapes bound to the samples that the rules ask for."""
    x, y = (
        SampledBasis.of(spectrum, shape.samples(rules.samples), shape.order, backend, shape.given)
        for shape, spectrum in zip((source, target), spectra, strict=True)
    )
    return x, y


@dataclass(frozen=True, eq=False)
class BoundSpectra:
    """Eigenfunctions of both shapes on a backend.

    Attributes
    ----------
    source, target : (n_x, d) and (n_y, d).
    source_mass, target_mass : (n_x,) and (n_y,), in which they are orthonormal.
    source_given, target_given : (n_x, f) and (n_y, f) on the host, weighted descriptors of the user; None without.
    """

    source: Any
    target: Any
    source_mass: Any
    target_mass: Any
    source_given: NDArray[np.float64] | None = None
    target_given: NDArray[np.float64] | None = None

    @staticmethod
    def of(source: Spectrum, target: Spectrum, backend: Backend) -> BoundSpectra:
        """Bring the functions of two spectra to a backend."""
        functions = backend.array(source.functions), backend.array(target.functions)
        return BoundSpectra(*functions, backend.array(source.mass), backend.array(target.mass))

    def with_given(self, source: Shape, target: Shape) -> BoundSpectra:
        """Return the same with the user's descriptors of both shapes, if there are any, beside the functions."""
        x, y = (None if shape.given is None else shape.given.weighted for shape in (source, target))
        return replace(self, source_given=x, target_given=y)

    def functional_map(self, maps: PointMaps, backend: Backend) -> NDArray[np.float64]:
        """Return the functional map (d, d) that explains maps of all vertices best."""
        return two_way_least_squares(self.source, self.target, self.source_mass, self.target_mass, maps, backend)

    def weighted(self, functional: NDArray[np.float64], backend: Backend) -> tuple[Any, Any]:
        """Return (n_x, d) and (n_y, d): the functions turned onto each other and weighted by singular values.

        With descriptors there are so many columns more.
        """
        x, y = singular_value_weighting(functional)
        source, target = backend.product(self.source, backend.array(x)), backend.product(self.target, backend.array(y))
        return beside(source, self.source_given, x, backend), beside(target, self.target_given, y, backend)


def two_way_step(
    spectra: BoundSpectra, maps: PointMaps, orders: Orders, backend: Backend
) -> tuple[PointMaps, tuple[Any, Any]]:
    """Return the maps after one two-way step, weighted by singular values, and the embeddings they are read from."""
    embedded = spectra.weighted(spectra.functional_map(maps, backend), backend)
    x, y = (permuted(rows, order, backend) for rows, order in zip(embedded, orders, strict=True))
    return point_maps(x, y, orders, maps, backend), embedded


def joint_step(
    source: Shape, target: Shape, spectra: BoundSpectra, size: int, maps: PointMaps, backend: Backend
) -> tuple[PointMaps, tuple[NDArray[np.floating], NDArray[np.floating]]]:
    """Return the maps after a two-way step in two bases side by side, and the embeddings, on the host.

    What the metric of one basis passes over the other sees: thin parts have many scale-invariant functions, broad ones
    few. Each basis has a functional map and singular values of its own.

    Parameters
    ----------
    source, target : shapes with as many Laplace–Beltrami functions as there are.
    spectra : the scale-invariant functions.
    size : at most so many Laplace–Beltrami functions are used.
    """
    count = min(size, source.basis.count, target.basis.count)
    embedded = [_on_host(spectra, maps, backend)]
    # Brought to the backend when the other basis is embedded, and let go of before matches are looked for.
    low = BoundSpectra.of(source.basis.head(count), target.basis.head(count), backend).with_given(source, target)
    embedded.append(_on_host(low, maps, backend))
    del low
    x, y = (np.concatenate(sides, axis=1) for sides in zip(*embedded, strict=True))
    orders = source.order, target.order
    first, second = (backend.array(side[order.vertices]) for side, order in zip((x, y), orders, strict=True))
    return point_maps(first, second, orders, maps, backend), (x, y)


def _on_host(
    spectra: BoundSpectra, maps: PointMaps, backend: Backend
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Return the embeddings of a two-way step, (n_x, d) and (n_y, d)."""
    x, y = spectra.weighted(spectra.functional_map(maps, backend), backend)
    return backend.numpy(x), backend.numpy(y)


def two_way_steps(spectra: BoundSpectra, maps: PointMaps, steps: int, orders: Orders, backend: Backend) -> PointMaps:
    """Return the maps after `steps` two-way steps among all vertices."""
    for _ in range(steps):
        maps, _ = two_way_step(spectra, maps, orders, backend)
    return maps
