"""Maps between samples of two shapes in both directions, and two-way steps on them.

A two-way step on all vertices compares every vertex with every other. On samples of both sides against all vertices it
costs a tenth, so that many variants of a map can be tried; see `pieces`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from clalign.engine.backend import Backend
from clalign.geometry.sampling import Samples, VertexOrder
from clalign.geometry.spectra import Spectrum
from clalign.maps.functional_maps import both_directions
from clalign.maps.nearest import nearest_in_order

RIDGE = 1e-5
"""Of the two-way least squares, relative to the mean diagonal entry.

Functions that live between the samples make the Gram matrix singular, which single precision may turn negative: its
largest eigenvalue is some thirty times the mean, and rounds to a few millionths of it.
"""


@dataclass(frozen=True, eq=False)
class SampledBasis:
    """Eigenfunctions of a shape with its samples.

    Attributes
    ----------
    functions : (n, k) float32, enough for what only guides a choice.
    samples : S of the vertices.
    order : of the vertices.
    uploaded : the functions on a backend, rows in that order.
    """

    functions: NDArray[np.float32]
    samples: Samples
    order: VertexOrder
    uploaded: Any

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

    def at_samples(self, size: int) -> NDArray[np.float32]:
        """Return the first `size` functions at the samples (S, size)."""
        return self.sampled[:, :size]


@dataclass(frozen=True)
class SampleMaps:
    """For every sample a vertex of the other shape.

    Attributes
    ----------
    target_of_source : (S_x,) int64, for the samples of X.
    source_of_target : (S_y,) int64, for the samples of Y.
    """

    target_of_source: NDArray[np.int64]
    source_of_target: NDArray[np.int64]


def sampled_basis(
    backend: Backend, spectrum: Spectrum, samples: Samples, order: VertexOrder | None = None
) -> SampledBasis:
    """Bind eigenfunctions to samples, and bring them to the backend once, in the order given or as they are."""
    functions = spectrum.functions.astype(np.float32)
    if order is None:
        order = VertexOrder.identity(len(functions))
    return SampledBasis(functions, samples, order, backend.array(functions[order.vertices]))


def sample_functional_map(
    source: SampledBasis, target: SampledBasis, maps: SampleMaps, size: int
) -> NDArray[np.float64]:
    """Return the functional map (size, size) that explains the maps of both directions best; see `maps`.

    The least squares of `maps.two_way_functional_map` with sums over samples instead of all vertices. Samples weigh by
    the area of the surface around them, whatever the metric of the functions: a choice among pieces should not care
    more for what is strongly curved.
    """
    pulled = source.functions[maps.source_of_target, :size]
    carried = target.functions[maps.target_of_source, :size]
    own_x, own_y = source.at_samples(size), target.at_samples(size)
    weighted_y = (own_y * target.samples.weights[:, None].astype(np.float32)).T
    weighted_x = (carried * source.samples.weights[:, None].astype(np.float32)).T
    gram = (target.gram[:size, :size] + weighted_x @ carried).astype(np.float64)
    gram[np.diag_indices(size)] += RIDGE * np.trace(gram) / size
    both = (weighted_y @ pulled + weighted_x @ own_x).astype(np.float64)
    return np.asarray(scipy.linalg.solve(gram, both, assume_a="pos", check_finite=False), dtype=np.float64)


def coherent_factors(functional: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return matrices for source and target functions whose products lie close together at matched vertices.

    They are `maps.coherent_directions`, made from the eigenvectors of CᵀC, which cost a tenth of a singular value
    decomposition.
    """
    squares, right = np.linalg.eigh(functional.T @ functional)
    values = np.sqrt(np.maximum(squares, 0.0))
    source = (right * np.minimum(values, 1.0)) @ right.T
    return source, functional @ ((right * np.minimum(1.0, 1.0 / np.maximum(values, 1e-12))) @ right.T)


def quickly_orthogonalised(functional: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return `maps.orthogonalised` of an invertible functional map, for a third of its time."""
    squares, right = np.linalg.eigh(functional.T @ functional)
    inverse = 1.0 / np.sqrt(np.maximum(squares, 1e-12 * max(float(squares[-1]), 1e-300)))
    return functional @ ((right * inverse) @ right.T)


def nearest_samples(
    backend: Backend,
    source: SampledBasis,
    target: SampledBasis,
    factors: tuple[NDArray[np.float64], NDArray[np.float64]],
    guess: SampleMaps | None = None,
) -> SampleMaps:
    """Return for every sample the nearest vertex of the other shape among the functions that `factors` align.

    Parameters
    ----------
    factors : (k, r) for each side, of its first k functions.
    guess : maps that are nearly right: they save time and do not change the result; see `nearness`.
    """
    embedded = [
        backend.product(basis.uploaded, backend.array(factor), leading=True)
        for basis, factor in zip((source, target), factors, strict=True)
    ]
    guesses = both_directions(guess)
    bases, found = (source, target), []
    for here, there in ((0, 1), (1, 0)):
        own, matches = bases[here], guesses[here]
        places = own.order.inverse[own.samples.vertices]
        order = np.argsort(places)
        queries = backend.gather(embedded[here], backend.array(places[order].astype(np.int32)))
        guessed = None if matches is None else bases[there].order.inverse[matches[order]]
        points = embedded[there]
        index = nearest_in_order(backend, queries, points, backend.half_squares(points), guessed)
        nearest = np.empty(places.size, dtype=np.int64)
        nearest[order] = bases[there].order.vertices[index]
        found.append(nearest)
    return SampleMaps(*found)


def coherent_sample_steps(
    backend: Backend, source: SampledBasis, target: SampledBasis, maps: SampleMaps, sizes: tuple[int, ...]
) -> SampleMaps:
    """Return the maps after one two-way step, weighted by coherence, with each number of functions."""
    for size in sizes:
        functional = sample_functional_map(source, target, maps, size)
        maps = nearest_samples(backend, source, target, coherent_factors(functional), maps)
    return maps
