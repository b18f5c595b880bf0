"""Choosing among candidates: a product of unit-free scores, with orientation as a gate."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.rules import SearchRules
from clalign.search.batch import Batch, SamplePair, different, distortions, map_distances


@dataclass(frozen=True)
class Ranking:
    """Candidates from best to worst.

    Attributes
    ----------
    batch : the candidates, in order.
    scores : (B,) the products; lower is better.
    orientation : (B,) in [−1, 1].
    distinct : indices of the candidates that are different maps (mean geodesic distance above `rules.distinct` from
        every better one), the chosen one first.
    distances : (len(distinct),) mean geodesic distance of each to the chosen one.
    """

    batch: Batch
    scores: NDArray[np.float64]
    orientation: NDArray[np.float64]
    distinct: tuple[int, ...]
    distances: tuple[float, ...]

    @property
    def margin(self) -> float:
        """Ln of the best different map's score over the chosen one's; infinite without one."""
        if len(self.distinct) < 2:
            return float("inf")
        chosen, next_best = self.distinct[:2]
        return float(np.log(over(self.scores[next_best], self.scores[chosen])))


def descriptor_differences(
    of_source: NDArray[np.float64],
    of_target: NDArray[np.float64],
    index: NDArray[np.int32],
    weights: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return (B, fields): weighted mean |difference| of pulled-back descriptors, in units of each one's spread on Y."""
    mean = weights @ of_target
    spread = np.sqrt(weights @ (of_target - mean) ** 2)
    differences = np.abs(of_source[index] - of_target[:, None, :])
    return np.einsum("m,mbf->bf", weights, differences) / np.maximum(spread, 1e-12)


def given_factors(pair: SamplePair, batch: Batch, rules: SearchRules) -> NDArray[np.float64]:
    """Return (B,) root mean square differences of pulled-back descriptors of the user, to a power of their weight.

    They are relative to the spread of the descriptors; without any, 1.
    """
    source, target = pair.source.given, pair.target.given
    if source is None or target is None:
        return np.ones(batch.count)
    weights = pair.target.prefix_weights(batch.index.shape[0])
    own = target.values[: len(weights)]
    squares = [weights @ np.square(source.values[column] - own).sum(axis=1) for column in batch.index.T]
    return np.asarray((np.sqrt(squares) + rules.given_floor) ** (rules.given_power * target.weight), dtype=np.float64)


def commutativity(batch: Batch, source: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ‖C Λ_X − Λ_Y C‖² / ‖Λ_Y‖² of each candidate (an isometry commutes with the Laplacian)."""
    size = batch.functional.shape[1]
    gap = source[None, :size] - target[:size, None]
    return np.sum((batch.functional * gap) ** 2, axis=(1, 2)) / np.sum(target[:size] ** 2)


def map_scores(pair: SamplePair, batch: Batch, points: int, rules: SearchRules) -> NDArray[np.float64]:
    """Return each candidate's score, a product of five unit-free ones without weights; lower is better.

    Relative distortion · mean curvature · Gaussian curvature · log-HKS · commutativity with the Laplacian, times the
    difference of the user's descriptors where there are any.
    """
    weights = pair.target.prefix_weights(batch.index.shape[0])
    queries = len(weights)
    source, target = pair.source, pair.target
    curvature = descriptor_differences(source.curvatures, target.curvatures[:queries], batch.index, weights)
    signature = descriptor_differences(source.signatures, target.signatures[:queries], batch.index, weights).sum(axis=1)
    return np.asarray(
        distortions(pair, batch.index, points, rules.distance_floor)
        * np.prod(curvature, axis=1)
        * signature
        * commutativity(batch, source.eigenvalues, target.eigenvalues)
        * given_factors(pair, batch, rules),
        dtype=np.float64,
    )


def over(scores: Any, chosen: float) -> Any:
    """Return scores over that of the chosen map.

    A shape matched with itself has the score 0, and so have all its maps if it is symmetric: 0 over 0 is 1 here.
    """
    smallest = np.finfo(np.float64).tiny
    with np.errstate(over="ignore"):
        return np.maximum(scores, smallest) / max(float(chosen), smallest)


def margin_over(ratios: NDArray[np.float64]) -> float:
    """Return ln of the smallest ratio of a rival to the chosen map, at least 0; infinite without rivals."""
    return float(np.log(np.maximum(ratios, 1.0)).min(initial=math.inf))


def facing(orientation: NDArray[np.float64], sign: float) -> NDArray[np.float64]:
    """Return orientations as the wanted one counts them: kept for the sign 1, reversed for -1, either for 0."""
    return np.abs(orientation) if sign == 0 else sign * orientation


def ranked(pair: SamplePair, batch: Batch, points: int, rules: SearchRules) -> Ranking:
    """Rank candidates by `map_scores`, those with an orientation above the least one before the others."""
    scores = map_scores(pair, batch, points, rules)
    orientation = pair.orientations(batch, rules.scored_products)
    order = np.lexsort((scores, orientation <= rules.least_orientation))
    batch, scores, orientation = batch.take(order), scores[order], orientation[order]
    between = map_distances(pair, batch.index, points)
    passed = orientation > rules.least_orientation
    # Where none passes, the best of those that failed has the others that failed to beat.
    eligible = passed if passed.any() else ~passed
    distinct = different(between, np.flatnonzero(eligible), rules.distinct)
    return Ranking(batch, scores, orientation, tuple(distinct), tuple(float(between[0, each]) for each in distinct))
