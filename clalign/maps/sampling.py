"""Two-way steps on samples of two shapes.

A two-way step on all vertices compares every vertex with every other. On samples of both sides against all vertices it
costs a tenth, so that many variants of a map can be tried.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.engine.backend import Backend
from clalign.engine.reference import Reference
from clalign.geometry.sampling import Samples, VertexOrder
from clalign.geometry.spectra import Spectrum
from clalign.maps.functional_maps import MatchedRows, functional_map, singular_value_weighting
from clalign.maps.nearest import beside, nearest_vertices
from clalign.maps.point_maps import PointMaps
from clalign.maps.zoomout import zoomout
from clalign.mesh.descriptors import PointDescriptors

SINGLE = Reference(np.float32)
"""Where the small least squares of samples are summed."""

Factors = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class SampledBasis:
    """Eigenfunctions of a shape with its samples.

    Attributes
    ----------
    functions : (n, k) float32, enough for what only guides a choice.
    samples : S of the vertices.
    order : of the vertices.
    uploaded : the functions on a backend, rows in that order.
    given : (n, f) descriptors that stand beside every embedding, rows in that order; None without. See `beside`.
    """

    functions: NDArray[np.float32]
    samples: Samples
    order: VertexOrder
    uploaded: Any
    given: NDArray[np.float64] | None = None

    @staticmethod
    def of(
        spectrum: Spectrum,
        samples: Samples,
        order: VertexOrder,
        backend: Backend,
        given: PointDescriptors | None = None,
    ) -> SampledBasis:
        """Bind eigenfunctions to samples, and bring them to the backend once."""
        functions = spectrum.functions.astype(np.float32)
        descriptors = None if given is None else given.weighted[order.vertices]
        return SampledBasis(functions, samples, order, backend.array(functions[order.vertices]), descriptors)

    @property
    def count(self) -> int:
        """Number of functions."""
        return self.functions.shape[1]

    @cached_property
    def sampled(self) -> NDArray[np.float32]:
        """The functions at the samples (S, k)."""
        return self.functions[self.samples.vertices]

    @cached_property
    def gram(self) -> NDArray[np.float32]:
        """Products of the functions, summed over the samples with their weights: (k, k)."""
        return self.sampled.T @ (self.sampled * self.samples.weights[:, None].astype(np.float32))

    @cached_property
    def sample_order(self) -> VertexOrder:
        """The samples in the order of their vertices."""
        return VertexOrder.of(np.argsort(self.order.inverse[self.samples.vertices]))

    def at_samples(self, size: int) -> NDArray[np.float32]:
        """Return the first `size` functions at the samples (S, size)."""
        return self.sampled[:, :size]

    def embedded(self, factor: NDArray[np.float64], backend: Backend) -> Any:
        """Return the first k functions times a factor (k, r), at all vertices in their order, on the backend.

        Descriptors of the user stand beside them.
        """
        functions = backend.product(self.uploaded, backend.array(factor), leading=True)
        return beside(functions, self.given, factor, backend)


def sample_functional_map(
    source: SampledBasis, target: SampledBasis, maps: PointMaps, size: int, ridge: float
) -> NDArray[np.float64]:
    """Return the functional map (size, size) that explains maps of samples in both directions best.

    Samples weigh by the area of the surface around them, whatever the metric of the functions: a choice among patches
    should not care more for what is strongly curved.
    """
    pulled = source.functions[maps.source_of_target, :size]
    carried = target.functions[maps.target_of_source, :size]
    matches = (
        MatchedRows(target.at_samples(size), pulled, target.samples.weights),
        MatchedRows(carried, source.at_samples(size), source.samples.weights),
    )
    return functional_map(matches, target.gram[:size, :size], ridge, SINGLE)


def nearest_samples(
    source: SampledBasis, target: SampledBasis, factors: Factors, guess: PointMaps | None, backend: Backend
) -> PointMaps:
    """Return for every sample the nearest vertex of the other shape among the functions that `factors` align.

    Parameters
    ----------
    factors : (k, r) for each side, of its first k functions.
    guess : maps that are nearly right: they save time and do not change the result; see `nearest`.
    """
    x, y = source.embedded(factors[0], backend), target.embedded(factors[1], backend)

    def matched(
        own: SampledBasis, embedded: Any, other: SampledBasis, points: Any, guessed: NDArray[np.int64] | None
    ) -> NDArray[np.int64]:
        order = own.sample_order
        rows = own.order.inverse[own.samples.vertices[order.vertices]].astype(np.int32)
        queries = backend.gather(embedded, backend.array(rows))
        return nearest_vertices(queries, points, (order, other.order), guessed, backend)

    return PointMaps(
        matched(source, x, target, y, None if guess is None else guess.target_of_source),
        matched(target, y, source, x, None if guess is None else guess.source_of_target),
    )


def two_way_sample_steps(
    source: SampledBasis,
    target: SampledBasis,
    maps: PointMaps,
    sizes: Sequence[int],
    ridge: float,
    backend: Backend,
) -> PointMaps:
    """Return the maps after one two-way step, weighted by singular values, with each number of functions."""

    def read(functional: NDArray[np.float64], guess: PointMaps | None, _: int | None = None) -> PointMaps:
        return nearest_samples(source, target, singular_value_weighting(functional), guess, backend)

    def fit(found: PointMaps, size: int) -> NDArray[np.float64]:
        return sample_functional_map(source, target, found, size, ridge)

    functional, before = zoomout(sizes, read, fit, maps=maps)
    return read(functional, before)
