"""The whole search: trees, closure, re-unfolding, a fine step, and the choice."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clalign.engine.backend import Backend
from clalign.geometry.shape import Shape
from clalign.maps.orientation import orientation_scores
from clalign.options import SearchOptions
from clalign.search.batch import Batch, Level, SamplePair, least_distorted, up_sample
from clalign.search.initial_maps import sign_patterns
from clalign.search.sampled import SampledShape, sampled
from clalign.search.score import Ranking, ranked
from clalign.search.symmetries import composed, self_maps, unfolded_again, widened
from clalign.search.tree import ORIENTED, PLAIN, grow

LOG = logging.getLogger(__name__)

KEPT_WIDE = 60
CLOSED = 8
SELF_MAPS = 4
REFOLDED = 24
FINALISTS = 24
FINE_LEVELS = tuple(Level(size, 500, 1000) for size in (45, 50, 56, 63, 71, 80, 90, 100, 110, 120))
LEAST_ORIENTATION = 0.5


@dataclass(frozen=True)
class SearchResult:
    """The chosen map between samples, and its rivals.

    Attributes
    ----------
    functional : (k, k) float64, functional map from the source to the target.
    score, orientation, confidence : of the chosen map; see `choice.Ranking`.
    rivals : functional maps of the best different maps, best first.
    rival_scores, rival_orientations, rival_distances : of the rivals.
    mirrored : the map reverses the orientation (only with "reversing" or "any").
    """

    functional: NDArray[np.float64]
    score: float
    orientation: float
    confidence: float
    rivals: tuple[NDArray[np.float64], ...]
    rival_scores: tuple[float, ...]
    rival_orientations: tuple[float, ...]
    rival_distances: tuple[float, ...]
    mirrored: bool = False


def find_isometry(
    source: Shape,
    target: Shape,
    backend: Backend,
    options: SearchOptions,
    progress: Callable[[float], None] | None = None,
) -> SearchResult:
    """Search for the (near-)isometry between two shapes.

    Parameters
    ----------
    source, target : prepared shapes.
    backend : where the batches of candidates are evaluated.
    options : `method` "tree" or "signs"; `orientation` "preserving", "reversing" or "any".
    progress : called with a fraction in [0, 1].

    Returns
    -------
    SearchResult
    """
    source_samples, target_samples = sampled(source), sampled(target)
    results = []
    if options.orientation in ("preserving", "any"):
        results.append(_search(source_samples, target_samples, backend, options, progress))
    if options.orientation in ("reversing", "any"):
        mirrored = _search(source_samples, target_samples.mirrored(), backend, options, progress)
        results.append(replace(mirrored, orientation=-mirrored.orientation, mirrored=True))
    return min(results, key=lambda result: result.score)


def _search(
    source: SampledShape,
    target: SampledShape,
    backend: Backend,
    options: SearchOptions,
    progress: Callable[[float], None] | None,
) -> SearchResult:
    def report(fraction: float) -> None:
        if progress is not None:
            progress(fraction)

    pair = SamplePair(source, target, backend)
    if options.method == "signs":
        candidates = _sign_candidates(pair)
    else:
        candidates = _tree_candidates(pair, report)
    report(0.8)
    fine = up_sample(pair, candidates, FINE_LEVELS)
    ranking = ranked(pair, fine, pair.fit(FINE_LEVELS[-1]).points, LEAST_ORIENTATION)
    report(1.0)
    return _result(ranking)


def _sign_candidates(pair: SamplePair) -> NDArray[np.float32]:
    """Return candidates of plain sign enumeration: enough for two poses of one body."""
    size = pair.fit(Level(9, 200, 400)).size
    batch = widened(pair, sign_patterns(min(9, size)), KEPT_WIDE)
    return _best(pair, batch, FINALISTS).functional


def _tree_candidates(pair: SamplePair, report: Callable[[float], None]) -> NDArray[np.float32]:
    """Return candidates of both trees, closed under self-maps and unfolded once more."""
    backend = pair.backend
    oriented = grow(pair, ORIENTED)
    report(0.15)
    plain = grow(pair, PLAIN)
    report(0.3)
    wide = widened(pair, _joined([oriented, plain]), KEPT_WIDE)
    own_source = self_maps(SamplePair(pair.source, pair.source, backend), SELF_MAPS)
    own_target = self_maps(SamplePair(pair.target, pair.target, backend), SELF_MAPS)
    report(0.5)
    closed = composed(wide.functional[:CLOSED], own_source, own_target)
    refolded = unfolded_again(pair, wide.functional[:REFOLDED], ORIENTED.strengths)
    size = wide.functional.shape[1]
    grown = [up_sample(pair, batch.functional, [Level(20, 150, 300)]) for batch in refolded if batch.count]
    again = widened(pair, _joined(grown), KEPT_WIDE) if grown else None
    closed_wide = widened(pair, closed, KEPT_WIDE)
    parts = [wide, closed_wide] if again is None else [wide, closed_wide, again]
    union = np.concatenate([part.functional for part in parts if part.functional.shape[1] == size])
    report(0.65)
    final = up_sample(pair, union, [Level(40, 200, 600)])
    scores = orientation_scores(final.functional, pair.source.tensor, pair.target.tensor)
    kept = scores > 0.4
    final = final.take(kept if kept.any() else scores >= np.sort(scores)[-FINALISTS:][0])
    return _best(pair, final, FINALISTS).functional


def _best(pair: SamplePair, batch: Batch, most: int) -> Batch:
    """Return the candidates of least distortion, without duplicates."""
    return least_distorted(pair, batch, pair.fit(Level(40, 200, 600)).points, 0.02, most)


def _joined(batches: list[Batch]) -> NDArray[np.float32]:
    """Return the functional maps of several batches, cut to the smallest size among them."""
    size = min(batch.functional.shape[1] for batch in batches)
    return np.concatenate([batch.functional[:, :size, :size] for batch in batches])


def _result(ranking: Ranking) -> SearchResult:
    maps = ranking.batch.functional.astype(np.float64)
    rivals = ranking.rivals[1:]
    return SearchResult(
        functional=maps[0],
        score=float(ranking.scores[0]),
        orientation=float(ranking.orientation[0]),
        confidence=ranking.confidence,
        rivals=tuple(maps[rival] for rival in rivals),
        rival_scores=tuple(float(ranking.scores[rival]) for rival in rivals),
        rival_orientations=tuple(float(ranking.orientation[rival]) for rival in rivals),
        rival_distances=ranking.rival_distances[1:],
    )
