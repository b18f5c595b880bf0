"""The choice among candidates that the search can hardly tell apart, by what their maps do to the surface.

Samples and low functions see little of a leg that went to the other hip: distances change by a few per cent. Grown to
all vertices such a map *tears* at the root of the leg, where neighbours come to lie far apart.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from clalign.engine.backend import Backend
from clalign.geometry.shape import Shape
from clalign.maps.functional_maps import polar_factor, singular_value_weighting, two_way_functional_map
from clalign.maps.nearest import point_maps
from clalign.maps.point_maps import PointMaps
from clalign.maps.sampling import SampledBasis, nearest_samples, sample_functional_map, two_way_sample_steps
from clalign.mesh.topology import face_areas
from clalign.refinement.zoomout import sampled_bases
from clalign.rules import RivalRules, Rules
from clalign.search.batch import SamplePair, different, map_distances, up_sample
from clalign.search.find import Candidate, SearchResult
from clalign.search.score import facing, given_factors, map_scores, margin_over, over


def in_doubt(found: SearchResult, sign: float, rules: Rules) -> bool:
    """Return whether the search has found rivals that it cannot tell from the chosen map.

    sign : +1 where the orientation is to be kept, −1 where it is to be reversed, 0 where it is free.
    """
    if not found.alternatives:
        return False
    limits, chosen = rules.rivals, found.chosen
    failed = bool(facing(np.array(chosen.orientation), sign) <= rules.search.least_orientation)
    as_exact = min(each.score for each in found.alternatives) < limits.rounded
    return failed or as_exact or chosen.score < limits.exact or found.confidence < limits.doubtful


def stretch_energy(source: Shape, target: Shape, target_of_source: NDArray[np.int64], rules: RivalRules) -> float:
    """Return the mean over the surface of ln of the stretch of edges, those that are not stretched counting 0.

    The stretch of an edge is the distance in space of its images over its length, at least the spacing of the vertices
    of the coarser mesh, since images are rounded to vertices. An isometry has about 0; the logarithm keeps what is torn
    from deciding alone. A map that collapses a part does not stretch it, but its inverse does: both ways are wanted.

    Parameters
    ----------
    target_of_source : (n_x,), a vertex of Y for every vertex of X.
    """
    faces, points, images = source.mesh.faces, source.mesh.vertices, target.mesh.vertices[target_of_source]
    area = face_areas(points, faces)
    spacing = 1.0 / math.sqrt(min(source.mesh.n_vertices, target.mesh.n_vertices))
    total = 0.0
    for first, second in ((0, 1), (1, 2), (2, 0)):
        a, b = faces[:, first], faces[:, second]
        before = np.maximum(np.linalg.norm(points[a] - points[b], axis=1), spacing)
        after = np.linalg.norm(images[a] - images[b], axis=1)
        total += float(area @ np.log(np.clip(after / before, 1.0, rules.largest_stretch)))
    return total / (3.0 * float(area.sum()))


def grown(
    bases: tuple[SampledBasis, SampledBasis],
    functional: NDArray[np.float64],
    ridge: float,
    rules: RivalRules,
    backend: Backend,
) -> PointMaps:
    """Return the maps between all vertices that a candidate leads to by two-way steps among samples.

    Parameters
    ----------
    bases : Laplace–Beltrami functions of both shapes with samples.
    functional : (k, k) of the candidate.
    ridge : of the least squares on samples.
    """
    most = min(basis.count for basis in bases)
    sizes = [min(size, most) for size in rules.sizes]
    low = min(sizes[0], len(functional))
    started = nearest_samples(*bases, (np.eye(low), polar_factor(functional[:low, :low])), None, backend)
    maps = two_way_sample_steps(*bases, started, sizes, ridge, backend)
    factors = singular_value_weighting(sample_functional_map(*bases, maps, sizes[-1], ridge))
    x, y = (basis.embedded(factor, backend) for basis, factor in zip(bases, factors, strict=True))
    return point_maps(x, y, (bases[0].order, bases[1].order), backend=backend)


def choose_grown(
    source: Shape, target: Shape, found: SearchResult, sign: float, rules: Rules, backend: Backend
) -> SearchResult:
    """Return the result of a search with its best candidates grown, told apart again, and put in order.

    The map whose stretch energy, both ways, is least is chosen, among those whose orientation passes as it does in the
    search. Candidates that have grown into one map are one. The confidence is 1 − J / J', J the product of the search's
    score of the grown map and its energy, J' the least of a different map; it is 0 where a rival has less, as energy
    and score then contradict each other, and where a rival has the same energy, as under an exact symmetry.

    Parameters
    ----------
    found : candidates, more than one.
    sign : +1 where the orientation is to be kept, −1 where it is to be reversed, 0 where it is free.
    """
    limits, every = rules.rivals, (found.chosen, *found.alternatives)
    largest = limits.slack * max(found.chosen.score, limits.resolution)
    count = min(sum(each.score <= largest for each in every), limits.most)
    bases = sampled_bases(source, target, (source.basis, target.basis), rules.refinement, backend)
    pair = SamplePair.of(source, target, backend)
    level = pair.fitted(rules.search.fine.last)
    energies, functional = np.zeros(count), np.stack([each.functional for each in every])
    for number in range(count):
        maps = grown(bases, functional[number], rules.refinement.ridge, limits, backend)
        functional[number] = two_way_functional_map(source.basis, target.basis, maps, level.size, backend)
        ways = (source, target, maps.target_of_source), (target, source, maps.source_of_target)
        energies[number] = limits.least_energy + sum(stretch_energy(*way, limits) for way in ways)
    batch = up_sample(pair, functional, [level])
    scores, given = map_scores(pair, batch, level.points, rules.search), given_factors(pair, batch, rules.search)
    # What a user knows of the points counts like a tear; it is in the score already.
    energies *= given[:count]
    orientation = pair.orientations(batch, rules.search.scored_products)
    failed = facing(orientation, sign) <= rules.search.least_orientation
    order = [*np.lexsort((energies, failed[:count])), *range(count, len(every))]
    distances = map_distances(pair, batch.index, level.points)
    alike = [number for number in order if failed[number] == failed[order[0]]]
    distinct = different(distances, np.array(alike), rules.search.distinct)
    # Of what was not grown only the ratio of the search's scores is known.
    exact = float(found.chosen.score < limits.exact)
    least_energy, least_score = exact * limits.exact_energy, exact * limits.exact_score
    searched = np.maximum([each.score for each in every], least_score)
    energies, compared = np.maximum(energies, least_energy), np.maximum(scores / given, least_score)[:count]
    ratios = np.concatenate([_ratios(energies, compared, order[0], limits), over(searched, searched[0])[count:]])
    chosen, *others = (
        Candidate(functional[each], float(scores[each]), float(orientation[each]), float(distances[order[0], each]))
        for each in distinct
    )
    return SearchResult(chosen, tuple(others), margin_over(ratios[distinct[1:]]))


def _ratios(
    energies: NDArray[np.float64], scores: NDArray[np.float64], chosen: int, rules: RivalRules
) -> NDArray[np.float64]:
    """Return J' / J of every rival; where the energies are the same, so are the maps as far as anyone can tell."""
    of_energies = energies / energies[chosen]
    ratios = of_energies * over(scores, scores[chosen])
    return np.where(np.abs(of_energies - 1.0) < rules.same_energy, 1.0, ratios)
