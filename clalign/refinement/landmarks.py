"""What known landmarks say of the candidates of a search, and of the final maps.

A landmark that all good maps contradict is more likely a slip of the hand than a discovery, so every landmark's say is
bounded: candidates are compared by the mean of capped distances, and landmarks that the chosen map sends far away are
named and left aside.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clalign.engine.backend import Backend
from clalign.geometry.heat import distance_solver
from clalign.geometry.shape import Shape
from clalign.maps.functional_maps import polar_factor, two_way_functional_map
from clalign.maps.nearest import nearest_rows
from clalign.maps.point_maps import PointMaps
from clalign.mesh.landmarks import Landmarks
from clalign.rules import LandmarkRules, Rules
from clalign.search.batch import SamplePair, different, map_distances, up_sample
from clalign.search.find import Candidate, SearchResult
from clalign.search.score import facing, map_scores, margin_over, over

STARTED_FROM = 3
"""Distances to fewer points tell hardly any part of a surface from another."""


def landmark_distances(shape: Shape, vertices: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return (k, n) geodesic distances from vertices, in sqrt(area)."""
    mesh = shape.mesh
    solver = distance_solver(mesh.vertices, mesh.faces, mesh.name)
    return np.stack([solver.row(int(vertex)) for vertex in vertices])


def choose_by_landmarks(
    source: Shape,
    target: Shape,
    found: SearchResult,
    landmarks: Landmarks,
    sign: float,
    rules: Rules,
    backend: Backend,
) -> SearchResult:
    """Return the result of a search with its candidates put in order by landmarks, then by score.

    With three landmarks or more, and without a start, one candidate starts from them: vertices with similar distances
    to all landmarks are matched. Candidates that send landmarks farther away than the best does are no rivals, so that
    the confidence is that among maps which agree with what is known.

    Parameters
    ----------
    found : the candidates of the search.
    landmarks : pairs of vertices.
    sign : +1 where the orientation is to be kept, −1 where it is to be reversed, 0 where it is free.
    """
    limits = rules.landmarks
    pair = SamplePair.of(source, target, backend)
    level = pair.fitted(rules.search.fine.last)
    rows = landmark_distances(source, landmarks.source), landmark_distances(target, landmarks.target)
    every = [each.functional for each in (found.chosen, *found.alternatives)][: limits.most]
    size = min(len(each) for each in every)
    if len(landmarks) >= STARTED_FROM and not math.isnan(found.margin):
        start = _started(source, target, rows, size, backend)
        every.append(up_sample(pair, start[None], rules.search.settle).functional[0])
    batch = up_sample(pair, _of_one_size(every, size), [level])
    misses = np.array([_miss(source, target, landmarks, rows, each, limits) for each in batch.functional])
    scores = map_scores(pair, batch, level.points, rules.search)
    orientation = pair.orientations(batch, rules.search.scored_products)
    failed = facing(orientation, sign) <= rules.search.least_orientation
    least = misses.min() if failed.all() else misses[~failed].min()
    agreeing = misses <= least + limits.worse
    order = np.lexsort((scores, ~agreeing, failed))
    between = map_distances(pair, batch.index, level.points)
    distinct = different(between, order, rules.search.distinct)
    chosen, *others = (
        Candidate(
            batch.functional[each].astype(np.float64),
            float(scores[each]),
            float(orientation[each]),
            float(between[distinct[0], each]),
        )
        for each in distinct
    )
    rivals = [each for each in distinct[1:] if agreeing[each] and not failed[each]]
    # Where nothing but a start was looked at, nothing is known of rivals.
    unknown = math.isnan(found.margin) and not rivals
    margin = math.nan if unknown else margin_over(over(scores[rivals], chosen.score))
    return SearchResult(chosen, tuple(others), margin)


def _of_one_size(functional: Sequence[NDArray[np.floating]], size: int) -> NDArray[np.float64]:
    """Candidates as a batch (B, size, size): larger ones cut, smaller ones filled with zeros."""
    batch = np.zeros((len(functional), size, size))
    for number, each in enumerate(functional):
        low = min(size, len(each))
        batch[number, :low, :low] = each[:low, :low]
    return batch


def _started(
    source: Shape,
    target: Shape,
    rows: tuple[NDArray[np.float64], NDArray[np.float64]],
    size: int,
    backend: Backend,
) -> NDArray[np.float64]:
    """The functional map (size, size) of the maps between vertices with similar distances to all landmarks.

    Distances to each landmark count in units of their mean over the surface, which forgives a longer limb.
    """
    x, y = ((row / (row @ shape.mass)[:, None]).T for row, shape in zip(rows, (source, target), strict=True))
    maps = PointMaps(nearest_rows(x, y, backend=backend), nearest_rows(y, x, backend=backend))
    return two_way_functional_map(source.basis, target.basis, maps, size, backend)


def _miss(
    source: Shape,
    target: Shape,
    landmarks: Landmarks,
    rows: tuple[NDArray[np.float64], NDArray[np.float64]],
    functional: NDArray[np.floating],
    rules: LandmarkRules,
) -> float:
    """Mean distance between landmarks and their images under a functional map, both ways, each capped."""
    factor = polar_factor(functional[None].astype(np.float64))[0]
    size = len(factor)
    phi, psi = source.basis.functions[:, :size], target.basis.functions[:, :size]
    to_source = nearest_rows(psi[landmarks.target] @ factor, phi)
    to_target = nearest_rows(phi[landmarks.source] @ factor.T, psi)
    number = np.arange(len(landmarks))
    off = np.concatenate([rows[0][number, to_source], rows[1][number, to_target]])
    return float(np.minimum(off, rules.cap).mean())


def disagreement(source: Shape, target: Shape, maps: PointMaps, landmarks: Landmarks) -> NDArray[np.float64]:
    """Return (k,) how far each landmark is from where the map sends its counterpart, in sqrt(area).

    Of both directions the farther one: the maps may be wrong in one of them alone.
    """
    number = np.arange(len(landmarks))
    forward = landmark_distances(target, landmarks.target)[number, maps.target_of_source[landmarks.source]]
    backward = landmark_distances(source, landmarks.source)[number, maps.source_of_target[landmarks.target]]
    return np.maximum(forward, backward).astype(np.float64)


def kept_exactly(maps: PointMaps, landmarks: Landmarks, agreed: NDArray[np.bool_]) -> PointMaps:
    """Return maps that send the landmarks which agree with them (k,) exactly to each other."""
    source, target = landmarks.source[agreed], landmarks.target[agreed]
    forward, backward = maps.target_of_source.copy(), maps.source_of_target.copy()
    forward[source], backward[target] = target, source
    return replace(maps, target_of_source=forward, source_of_target=backward)
