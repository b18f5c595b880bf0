"""Choosing among candidates: a product of unit-free scores, with orientation as a gate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clalign.maps.orientation import orientation_scores
from clalign.search.batch import Batch, SamplePair, distortions, map_distances

DIFFERENT = 0.05


@dataclass(frozen=True)
class Ranking:
    """Candidates from best to worst.

    Attributes
    ----------
    batch : the candidates, in order.
    scores : (B,) the products; lower is better.
    orientation : (B,) in [−1, 1].
    rivals : indices of the candidates that are different maps (mean geodesic distance above 0.05 from every
        better one), the chosen one first.
    rival_distances : (len(rivals),) mean geodesic distance of each to the chosen one.
    """

    batch: Batch
    scores: NDArray[np.float64]
    orientation: NDArray[np.float64]
    rivals: tuple[int, ...]
    rival_distances: tuple[float, ...]

    @property
    def confidence(self) -> float:
        """Ln of the best different map's score over the chosen one's; infinite without a rival."""
        if len(self.rivals) < 2:
            return float("inf")
        # A shape matched with itself has the score 0, and so have all its maps if it is symmetric.
        chosen, rival = np.maximum(self.scores[list(self.rivals[:2])], np.finfo(np.float64).tiny)
        return float(np.log(rival / chosen))


def field_differences(
    of_source: NDArray[np.float64],
    of_target: NDArray[np.float64],
    index: NDArray[np.int32],
    weights: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return (B, fields): weighted mean |difference| of pulled-back fields, in units of each field's spread on Y."""
    mean = weights @ of_target
    spread = np.sqrt(weights @ (of_target - mean) ** 2)
    differences = np.abs(of_source[index] - of_target[:, None, :])
    return np.einsum("m,mbf->bf", weights, differences) / np.maximum(spread, 1e-12)


def commutativity(batch: Batch, source: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ‖C Λ_X − Λ_Y C‖² / ‖Λ_Y‖² of each candidate (an isometry commutes with the Laplacian)."""
    size = batch.functional.shape[1]
    gap = source[None, :size] - target[:size, None]
    return np.sum((batch.functional * gap) ** 2, axis=(1, 2)) / np.sum(target[:size] ** 2)


def map_scores(pair: SamplePair, batch: Batch, points: int) -> NDArray[np.float64]:
    """Return each candidate's score, a product of five unit-free ones without weights; lower is better.

    Relative distortion · mean curvature · Gaussian curvature · log-HKS · commutativity with the Laplacian.
    """
    weights = pair.target.prefix_weights(batch.index.shape[0])
    queries = len(weights)
    source, target = pair.source, pair.target
    curvature = field_differences(source.curvatures, target.curvatures[:queries], batch.index, weights)
    signature = field_differences(source.signatures, target.signatures[:queries], batch.index, weights).sum(axis=1)
    return np.asarray(
        distortions(pair, batch.index, points, "relative")
        * np.prod(curvature, axis=1)
        * signature
        * commutativity(batch, source.eigenvalues, target.eigenvalues),
        dtype=np.float64,
    )


def ranked(pair: SamplePair, batch: Batch, points: int, least_orientation: float) -> Ranking:
    """Rank candidates by `map_scores`, those with an orientation above `least_orientation` before the others."""
    scores = map_scores(pair, batch, points)
    orientation = orientation_scores(batch.functional, pair.source.tensor, pair.target.tensor)
    order = np.lexsort((scores, orientation <= least_orientation))
    batch, scores, orientation = batch.take(order), scores[order], orientation[order]
    between = map_distances(pair, batch.index, points)
    rivals = [0]
    for candidate in range(1, batch.count):
        if orientation[candidate] > least_orientation and np.all(between[rivals, candidate] > DIFFERENT):
            rivals.append(candidate)
    return Ranking(batch, scores, orientation, tuple(rivals), tuple(float(between[0, rival]) for rival in rivals))
