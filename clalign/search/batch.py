"""Batches of candidate maps between the samples of two shapes, stepped together on a backend.

A candidate is a functional map C (k, k) from functions on X to functions on Y, or its point map: for each sample of Y a
sample of X. A batch keeps candidates in the last-but-one axis, C as (k, B, k) and point maps as (m, B), so that one
ZoomOut step of all candidates is one product, one nearest-neighbour search and one more product.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.engine.backend import Backend
from clalign.geometry.heat import prefix_shares
from clalign.geometry.shape import Shape
from clalign.maps.functional_maps import told_apart
from clalign.maps.orientation import orientation_scores
from clalign.maps.zoomout import zoomout
from clalign.memoize import memoize
from clalign.mesh.descriptors import PointDescriptors
from clalign.rules import Level


@dataclass(frozen=True, eq=False)
class SampledShape:
    """Eigenfunctions, distances and descriptors of a shape at its farthest-point samples.

    Every prefix of the samples is itself a farthest-point sample, so a coarse step uses the first ``m`` of them.

    Attributes
    ----------
    functions : (S, K) float64, LBO eigenfunctions at the samples.
    eigenvalues : (K,) float64.
    distances : (S, S) float64, geodesic, in units of sqrt(area).
    weights : (S,) float64, area of each sample's geodesic Voronoi cell; sums to 1.
    tensor : (p, p, p) float64, O[a, b, c] = <phi_c, n . (grad phi_a x grad phi_b)>.
    signatures : (S, 6) float64, log heat kernel signatures.
    curvatures : (S, 2) float64, smoothed mean and Gaussian curvature.
    given : (S, f) descriptors of the user; None without.
    """

    functions: NDArray[np.float64]
    eigenvalues: NDArray[np.float64]
    distances: NDArray[np.float64]
    weights: NDArray[np.float64]
    tensor: NDArray[np.float64]
    signatures: NDArray[np.float64]
    curvatures: NDArray[np.float64]
    given: PointDescriptors | None = None

    @staticmethod
    def of(shape: Shape) -> SampledShape:
        """Return what the search reads of a shape."""
        vertices = shape.geodesics.samples
        return SampledShape(
            functions=np.ascontiguousarray(shape.basis.functions[vertices]),
            eigenvalues=shape.basis.eigenvalues,
            distances=shape.geodesics.distances,
            weights=shape.geodesics.weights,
            tensor=shape.orientation,
            signatures=shape.signatures[vertices],
            curvatures=shape.curvatures[vertices],
            given=None if shape.given is None else shape.given.at(vertices),
        )

    @property
    def count(self) -> int:
        """Number of samples."""
        return self.weights.size

    def mirrored(self) -> SampledShape:
        """Return the same shape with its orientation reversed: only the triple products change, by their sign."""
        return replace(self, tensor=-self.tensor)

    @memoize
    def prefix_weights(self, count: int) -> NDArray[np.float64]:
        """Return the area that falls to each of the first `count` samples, from the cells of all samples."""
        return prefix_shares(self.distances, self.weights, count)

    @memoize
    def analysis(self, count: int, size: int) -> NDArray[np.float64]:
        """Return (size, count): coefficients of a function from its values at samples, by weighted least squares."""
        basis = self.functions[:count, :size]
        weighted = basis * self.prefix_weights(count)[:, None]
        gram = basis.T @ weighted
        gram[np.diag_indices(size)] += 1e-9 * np.trace(gram) / size
        return np.asarray(np.linalg.solve(gram, weighted.T), dtype=np.float64)


@dataclass(frozen=True)
class Batch:
    """Candidates: functional maps (B, k, k) float32 and the point maps (m, B) int32 that they were read from."""

    functional: NDArray[np.float32]
    index: NDArray[np.int32]

    @property
    def count(self) -> int:
        """Number of candidates."""
        return self.functional.shape[0]

    def take(self, order: NDArray[np.int64] | NDArray[np.bool_]) -> Batch:
        """Return some of the candidates."""
        return Batch(self.functional[order], self.index[:, order])


@dataclass(frozen=True, eq=False)
class SamplePair:
    """Two sampled shapes bound to a backend; arrays are uploaded once a size."""

    source: SampledShape
    target: SampledShape
    backend: Backend

    @staticmethod
    def of(source: Shape, target: Shape, backend: Backend) -> SamplePair:
        """Bind two shapes."""
        return SamplePair(SampledShape.of(source), SampledShape.of(target), backend)

    def fit(self, size: int, queries: int, points: int) -> Level:
        """Return a step reduced to what small shapes have: their samples, and functions that these can tell apart."""
        queries, points = min(queries, self.target.count), min(points, self.source.count)
        functions = min(self.source.functions.shape[1], self.target.functions.shape[1])
        return Level(min(size, functions, max(told_apart(min(queries, points)), 4)), queries, points)

    def fitted(self, level: Level) -> Level:
        """Return `fit` of a step's sizes."""
        return self.fit(level.size, level.queries, level.points)

    @memoize
    def points(self, count: int, size: int) -> tuple[Any, Any]:
        """Return the first `size` functions at the first `count` samples of X, and their halved squared norms."""
        values = self.source.functions[:count, :size]
        return self.backend.array(values), self.backend.array(0.5 * np.sum(values**2, axis=1))

    @memoize
    def synthesis(self, count: int, size: int) -> Any:
        """Return the first `size` functions at the first `count` samples of Y."""
        return self.backend.array(self.target.functions[:count, :size])

    @memoize
    def analysis(self, count: int, size: int) -> Any:
        """Return the least-squares analysis of Y on the backend; see `SampledShape.analysis`."""
        return self.backend.array(self.target.analysis(count, size))

    @memoize
    def distances(self, queries: int, points: int) -> tuple[Any, Any, Any]:
        """Return distances among samples of X, among samples of Y, and the weights of the latter."""
        return (
            self.backend.array(self.source.distances[:points, :points]),
            self.backend.array(self.target.distances[:queries, :queries]),
            self.backend.array(self.target.prefix_weights(queries)),
        )

    def point_maps(self, functional: Any, level: Level) -> Any:
        """Return (queries, B) int32: nearest sample of X in the spectral embedding, for functional (k, B, k)."""
        size, count = functional.shape[0], functional.shape[1]
        embedded = self.backend.product(
            self.synthesis(level.queries, size), functional.reshape(size, count * functional.shape[2])
        )
        points, penalty = self.points(level.points, functional.shape[2])
        index, _ = self.backend.nearest(embedded.reshape(level.queries * count, -1), points, penalty)
        return index.reshape(level.queries, count)

    def functional_maps(self, index: Any, size: int, level: Level) -> Any:
        """Return (size, B, size) functional maps of point maps (queries, B)."""
        points, _ = self.points(level.points, size)
        pulled = self.backend.gather(points, index)
        count = index.shape[1]
        maps = self.backend.product(self.analysis(level.queries, size), pulled.reshape(level.queries, count * size))
        return maps.reshape(size, count, size)

    def orientations(self, batch: Batch, products: int) -> NDArray[np.float64]:
        """Return the orientation of every candidate (B,); see `orientation_scores`."""
        return orientation_scores(batch.functional, self.source.tensor, self.target.tensor, products)

    def upload(self, functional: NDArray[np.floating]) -> Any:
        """Bring (B, k, k) functional maps to the backend, as (k, B, k)."""
        return self.backend.array(functional.transpose(1, 0, 2))

    def download(self, functional: Any, index: Any) -> Batch:
        """Bring a batch back to the host."""
        values = self.backend.numpy(functional).astype(np.float32, copy=False)
        return Batch(np.ascontiguousarray(values.transpose(1, 0, 2)), self.backend.numpy(index))


POLAR_STEPS = 8
"""Newton–Schulz steps: more of them fill in what a map hardly carries, with fewer a good map is not orthogonal."""
POLAR_START = 1.7
"""Largest singular value that the steps start from: from sqrt(3) on they diverge."""


def newton_schulz(functional: NDArray[np.float32], steps: int = POLAR_STEPS) -> NDArray[np.float32]:
    """Bring functional maps (B, k, k) close to their polar factors by Newton–Schulz steps, C ← C (3 I − CᵀC) / 2.

    Singular values above about 0.05 end at 1; directions that a map does not carry at all stay small, instead of being
    filled in at random as the exact polar factor would.
    """
    norms = np.linalg.norm(functional, axis=(1, 2))
    size = functional.shape[1]
    # Largest singular values stay below 2 in practice; the Frobenius norm bounds the scale of degenerate maps.
    largest = np.minimum(norms, np.maximum(2.0, 2.0 * norms / np.sqrt(size)))
    current = functional * (POLAR_START / np.maximum(largest, 1e-6))[:, None, None].astype(np.float32)
    for _ in range(steps):
        gram = np.matmul(current.transpose(0, 2, 1), current)
        current = 1.5 * current - 0.5 * np.matmul(current, gram)
    return current


def up_sample(pair: SamplePair, functional: NDArray[np.floating], levels: Iterable[Level]) -> Batch:
    """Return the candidates after one ZoomOut step a level.

    Point maps are read from the polar factor of a functional map. An isometry's map is orthogonal; without it a step
    that lets many samples fall onto few is repeated by the next, and parts stay folded.

    Parameters
    ----------
    functional : (B, k, k), where to start.
    levels : at each, the point maps are read from the current functional maps and give the next ones, of its size.
    """

    def read(batch: Batch, _: Any, level: Level) -> Any:
        factors = newton_schulz(batch.functional.astype(np.float32, copy=False))
        return pair.point_maps(pair.upload(factors), level)

    def fit(index: Any, level: Level) -> Batch:
        return pair.download(pair.functional_maps(index, level.size, level), index)

    start = Batch(np.asarray(functional), np.zeros((0, len(functional)), dtype=np.int32))
    return zoomout([pair.fitted(level) for level in levels], read, fit, functional=start)[0]


def distortions(
    pair: SamplePair, index: NDArray[np.int32], points: int, floor: float | None = None
) -> NDArray[np.float64]:
    """Return each candidate's geodesic distortion over pairs of samples, squared, or relative with a floor."""
    distances_x, distances_y, weights = pair.distances(index.shape[0], points)
    values = pair.backend.distortion_batch(distances_x, distances_y, weights, pair.backend.array(index), floor)
    return pair.backend.numpy(values).astype(np.float64)


def map_distances(pair: SamplePair, index: NDArray[np.int32], points: int) -> NDArray[np.float64]:
    """Return (B, B): mean geodesic distance on X between the images under two candidates."""
    distances_x, _, weights = pair.distances(index.shape[0], points)
    values = pair.backend.map_distance(distances_x, weights, pair.backend.array(index))
    return pair.backend.numpy(values).astype(np.float64)


def least_distorted(pair: SamplePair, batch: Batch, points: int, radius: float, most: int, among: int = 0) -> Batch:
    """Return at most `most` candidates without duplicates, of least distortion first.

    Parameters
    ----------
    points : samples of X that the point maps lead to.
    radius : candidates closer than this are duplicates.
    among : so many of least distortion are looked at (0: all).
    """
    order = np.argsort(distortions(pair, batch.index, points), kind="stable")
    return distinct(pair, batch.take(order[:among] if among else order), points, radius, most)


def distinct(pair: SamplePair, batch: Batch, points: int, radius: float, most: int) -> Batch:
    """Return the first `most` candidates without those within `radius` of an earlier one; see `least_distorted`."""
    between = map_distances(pair, batch.index, points)
    return batch.take(np.array(without_duplicates(between, np.arange(batch.count), radius, most)))


def different(between: NDArray[np.float64], order: NDArray[np.int64], radius: float) -> list[int]:
    """Return candidates in the given order, leaving out those that are not farther than `radius` from one taken."""
    return without_duplicates(between, order, float(np.nextafter(radius, np.inf)), len(order))


def without_duplicates(between: NDArray[np.float64], order: NDArray[np.int64], radius: float, most: int) -> list[int]:
    """Return candidates in the given order, leaving out those within `radius` of one already taken."""
    kept: list[int] = []
    blocked = np.zeros(between.shape[0], dtype=bool)
    for candidate in order:
        if blocked[candidate]:
            continue
        kept.append(int(candidate))
        if len(kept) == most:
            break
        blocked |= between[candidate] < radius
    return kept
