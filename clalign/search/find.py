"""The whole search: trees, compositions with self-maps, unfolding once more, tips, a fine step, and the choice."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clalign.engine.backend import Backend
from clalign.geometry.shape import Shape
from clalign.options import Orientation
from clalign.rules import SearchRules
from clalign.search.batch import Batch, SampledShape, SamplePair, different, least_distorted, map_distances, up_sample
from clalign.search.score import margin_over, over, ranked
from clalign.search.symmetries import composed, self_maps, unfolded_again, widened
from clalign.search.tips import given_candidates, tip_candidates
from clalign.search.tree import grow


@dataclass(frozen=True)
class Candidate:
    """A map between samples that the search ends with.

    Attributes
    ----------
    functional : (k, k) float64, functional map from the source to the target.
    score : see `score.map_scores`; the lower the better.
    orientation : in [−1, 1].
    distance : mean geodesic distance to the chosen map, 0 for that itself, in units of sqrt(area).
    """

    functional: NDArray[np.float64]
    score: float
    orientation: float
    distance: float


@dataclass(frozen=True)
class SearchResult:
    """What the search has found.

    Attributes
    ----------
    chosen : the best map.
    alternatives : the best different maps, best first.
    margin : ln of the first alternative's score over the chosen one's; infinite without one.
    """

    chosen: Candidate
    alternatives: tuple[Candidate, ...]
    margin: float

    @property
    def confidence(self) -> float:
        """In [0, 1], by how much the chosen map beats the best different one: 1 − exp(−margin)."""
        return 1.0 - math.exp(-self.margin)


def find_isometry(
    source: Shape,
    target: Shape,
    orientation: Orientation,
    rules: SearchRules,
    backend: Backend,
    progress: Callable[[float], None] | None = None,
) -> SearchResult:
    """Search for the (near-)isometry between two shapes.

    Parameters
    ----------
    source, target : prepared shapes.
    orientation : "preserving", "reversing" or "any", which takes the better of both.
    rules : of the search.
    backend : where the batches of candidates are evaluated.
    progress : called with a fraction in [0, 1].
    """
    report = progress or (lambda fraction: None)
    samples_x, samples_y = SampledShape.of(source), SampledShape.of(target)
    results = []
    if orientation in ("preserving", "any"):
        results.append(_search(SamplePair(samples_x, samples_y, backend), rules, report))
    if orientation in ("reversing", "any"):
        found = _search(SamplePair(samples_x, samples_y.mirrored(), backend), rules, report)
        mirrored = tuple(_mirrored(each) for each in found.alternatives)
        results.append(replace(found, chosen=_mirrored(found.chosen), alternatives=mirrored))
    if len(results) == 1:
        return results[0]
    return _either(SamplePair(samples_x, samples_y, backend), results, rules)


def _either(pair: SamplePair, results: Sequence[SearchResult], rules: SearchRules) -> SearchResult:
    """Return the results of both orientations as one: the best map, and what differs from it in either."""
    every = [each for result in results for each in (result.chosen, *result.alternatives)]
    every.sort(key=lambda each: (abs(each.orientation) <= rules.least_orientation, each.score))
    size = min(len(each.functional) for each in every)
    level = pair.fitted(rules.fine.last)
    batch = up_sample(pair, np.stack([each.functional[:size, :size] for each in every]), [level])
    between = map_distances(pair, batch.index, level.points)
    distinct = different(between, np.arange(len(every)), rules.distinct)
    chosen, *others = (replace(every[number], distance=float(between[0, number])) for number in distinct)
    passed = [each.score for each in others if abs(each.orientation) > rules.least_orientation]
    return SearchResult(chosen, tuple(others), margin_over(over(np.array(passed), chosen.score)))


def _mirrored(candidate: Candidate) -> Candidate:
    return replace(candidate, orientation=-candidate.orientation)


def _search(pair: SamplePair, rules: SearchRules, report: Callable[[float], None]) -> SearchResult:
    of_trees = _tree_candidates(pair, rules, report)
    report(0.75)
    beside = [each for each in (tip_candidates(pair, rules), given_candidates(pair, rules)) if len(each)]
    report(0.8)
    fine = up_sample(pair, _joined([of_trees, *beside]) if beside else of_trees, rules.fine)
    points = pair.fitted(rules.fine.last).points
    ranking = ranked(pair, _first_found(pair, fine, len(of_trees), points, rules), points, rules)
    report(1.0)
    chosen, *others = (
        Candidate(
            ranking.batch.functional[index].astype(np.float64),
            float(ranking.scores[index]),
            float(ranking.orientation[index]),
            distance,
        )
        for index, distance in zip(ranking.distinct, ranking.distances, strict=True)
    )
    return SearchResult(chosen, tuple(others), ranking.margin)


def _tree_candidates(pair: SamplePair, rules: SearchRules, report: Callable[[float], None]) -> NDArray[np.float32]:
    """Return candidates of both trees, composed with self-maps and unfolded once more."""
    oriented = grow(pair, rules.oriented, rules)
    report(0.15)
    plain = grow(pair, rules.plain, rules)
    report(0.3)
    wide = widened(pair, _joined([oriented.functional, plain.functional]), rules.wide_most, rules)
    own_source = self_maps(SamplePair(pair.source, pair.source, pair.backend), rules)
    own_target = self_maps(SamplePair(pair.target, pair.target, pair.backend), rules)
    report(0.5)
    compositions = composed(wide.functional[: rules.composed], own_source, own_target)
    unfolded = unfolded_again(pair, wide.functional[: rules.unfolded_again], rules)
    grown = [up_sample(pair, batch.functional, [rules.unfold_join]).functional for batch in unfolded if batch.count]
    again = [widened(pair, _joined(grown), rules.wide_most, rules)] if grown else []
    parts = [wide, widened(pair, compositions, rules.wide_most, rules), *again]
    union = np.concatenate([part.functional for part in parts])
    report(0.65)
    final = up_sample(pair, union, [rules.joined])
    scores = pair.orientations(final, rules.scored_products)
    kept = scores > rules.joined_orientation
    final = final.take(kept if kept.any() else scores >= np.sort(scores)[-rules.finalists :][0])
    points = pair.fitted(rules.joined).points
    return least_distorted(pair, final, points, rules.wide_radius, rules.finalists).functional


def _first_found(pair: SamplePair, batch: Batch, first: int, points: int, rules: SearchRules) -> Batch:
    """Return a batch without those after the `first` candidates that are no different map from any of these.

    What the trees find does not depend on whether tips lead there too.
    """
    if batch.count == first:
        return batch
    between = map_distances(pair, batch.index, points)
    fresh = first + np.flatnonzero((between[first:, :first] > rules.distinct).all(axis=1))
    return batch.take(np.concatenate([np.arange(first), fresh]))


def _joined(functional: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
    """Return several batches of functional maps as one, cut to the smallest size among them."""
    size = min(maps.shape[1] for maps in functional)
    return np.concatenate([maps[:, :size, :size] for maps in functional])
