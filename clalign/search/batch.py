"""Batches of candidate maps between the samples of two shapes, stepped together on a backend.

A candidate is a functional map C (k, k) from functions on X to functions on Y, or its point map: for each sample of Y a
sample of X. A batch keeps candidates in the last-but-one axis, C as (k, B, k) and point maps as (m, B), so that one
spectral up-sampling step of all candidates is one product, one nearest-neighbour search and one more product.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.engine.backend import Backend
from clalign.engine.reference import DistortionKind
from clalign.search.once import once
from clalign.search.sampled import SampledShape


@dataclass(frozen=True)
class Level:
    """Sizes of one step: `size` functions, `queries` samples of Y, `points` samples of X."""

    size: int
    queries: int
    points: int


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

    def fit(self, level: Level) -> Level:
        """Return `level` reduced to what small shapes have: no more samples than there are, at most half as many
        functions as samples.
        """
        queries = min(level.queries, self.target.count)
        points = min(level.points, self.source.count)
        largest = min(
            self.source.functions.shape[1], self.target.functions.shape[1], max(queries // 2, 4), max(points // 2, 4)
        )
        return Level(min(level.size, largest), queries, points)

    @once
    def points(self, count: int, size: int) -> tuple[Any, Any]:
        """Return the first `size` functions at the first `count` samples of X, and their halved squared norms."""
        values = np.ascontiguousarray(self.source.functions[:count, :size])
        return self.backend.array(values), self.backend.array(0.5 * np.sum(values**2, axis=1))

    @once
    def synthesis(self, count: int, size: int) -> Any:
        """Return the first `size` functions at the first `count` samples of Y."""
        return self.backend.array(np.ascontiguousarray(self.target.functions[:count, :size]))

    @once
    def analysis(self, count: int, size: int) -> Any:
        """Return the least-squares analysis of Y on the backend; see `SampledShape.analysis`."""
        return self.backend.array(self.target.analysis(count, size))

    @once
    def distances(self, queries: int, points: int) -> tuple[Any, Any, Any]:
        """Return distances among samples of X, among samples of Y, and the weights of the latter."""
        return (
            self.backend.array(np.ascontiguousarray(self.source.distances[:points, :points])),
            self.backend.array(np.ascontiguousarray(self.target.distances[:queries, :queries])),
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

    def upload(self, functional: NDArray[np.floating]) -> Any:
        """Bring (B, k, k) functional maps to the backend, as (k, B, k)."""
        return self.backend.array(np.ascontiguousarray(functional.transpose(1, 0, 2)))

    def download(self, functional: Any, index: Any) -> Batch:
        """Bring a batch back to the host."""
        values = self.backend.numpy(functional).astype(np.float32, copy=False)
        return Batch(np.ascontiguousarray(values.transpose(1, 0, 2)), self.backend.numpy(index))


def orthogonalised_batch(functional: NDArray[np.float32], steps: int = 8) -> NDArray[np.float32]:
    """Bring functional maps (B, k, k) close to orthogonal by Newton–Schulz steps, C ← C (3 I − CᵀC) / 2.

    Singular values above about 0.05 end at 1; directions that a map does not carry at all stay small, instead of being
    filled in at random as the exact polar factor would.
    """
    norms = np.linalg.norm(functional, axis=(1, 2))
    size = functional.shape[1]
    # Largest singular values stay below 2 in practice; the Frobenius norm bounds the scale of degenerate maps.
    largest = np.minimum(norms, np.maximum(2.0, 2.0 * norms / np.sqrt(size)))
    current = functional * (1.7 / np.maximum(largest, 1e-6))[:, None, None].astype(np.float32)
    for _ in range(steps):
        gram = np.matmul(current.transpose(0, 2, 1), current)
        current = 1.5 * current - 0.5 * np.matmul(current, gram)
    return current


def up_sample(
    pair: SamplePair, functional: NDArray[np.floating], levels: Sequence[Level], *, orthogonal: bool = True
) -> Batch:
    """Return the candidates after one spectral up-sampling step a level (ZoomOut, Melzi et al. 2019).

    Parameters
    ----------
    functional : (B, k, k), where to start.
    levels : at each, the point maps are read from the current functional maps and give the next ones, of its size.
    orthogonal : read point maps from the orthogonalised functional map. An isometry's map is orthogonal; without it a
        step that lets many samples fall onto few is repeated by the next, and parts stay folded.
    """
    fitted = [pair.fit(level) for level in levels]
    current = functional
    for level in fitted:
        read = orthogonalised_batch(current.astype(np.float32, copy=False)) if orthogonal else current
        index = pair.point_maps(pair.upload(read), level)
        batch = pair.download(pair.functional_maps(index, level.size, level), index)
        current = batch.functional
    return batch


def distortions(
    pair: SamplePair, index: NDArray[np.int32], points: int, kind: DistortionKind = "squared"
) -> NDArray[np.float64]:
    """Return each candidate's geodesic distortion, squared or relative, weighted over pairs of samples."""
    distances_x, distances_y, weights = pair.distances(index.shape[0], points)
    values = pair.backend.distortion_batch(
        distances_x, distances_y, weights, pair.backend.array(np.ascontiguousarray(index)), kind=kind
    )
    return pair.backend.numpy(values).astype(np.float64)


def map_distances(pair: SamplePair, index: NDArray[np.int32], points: int) -> NDArray[np.float64]:
    """Return (B, B): mean geodesic distance on X between the images under two candidates."""
    distances_x, _, weights = pair.distances(index.shape[0], points)
    values = pair.backend.map_distance(distances_x, weights, pair.backend.array(np.ascontiguousarray(index)))
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
    batch = batch.take(order[:among] if among else order)
    between = map_distances(pair, batch.index, points)
    return batch.take(np.array(without_duplicates(between, np.arange(batch.count), radius, most)))


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
