"""A part on a whole: candidates, the choice by the side that they show, scale, growth, and what is covered."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clalign.engine import HOST
from clalign.engine.backend import Backend
from clalign.geometry.sampling import VertexOrder
from clalign.partial.coverage import covered
from clalign.partial.descriptors import ball_profiles, curvature_fields, look_costs
from clalign.partial.facing import orientation
from clalign.partial.growth import GrownMap, anchored, back_map, grown
from clalign.partial.intervals import Intervals
from clalign.partial.search import Assignment, Assignments, search
from clalign.partial.surface import SampledSurface
from clalign.partial.whole import Whole, sample_bounds
from clalign.rules.parts import PartRules


@dataclass(frozen=True, eq=False)
class Placement:
    """A part with the maps of its samples that were found, at one scale.

    Attributes
    ----------
    part : in the unit of the whole.
    factor : by which its lengths were multiplied.
    lower_rows : see `SampledSurface.lower_rows`.
    bounds : (S, S) of the distances among the samples.
    candidates : best first.
    facing : (B,) orientation of each, 1 as wanted.
    chosen : number of the best one that shows the wanted side, of all if none does.
    passed : whether one does.
    """

    part: SampledSurface
    factor: float
    lower_rows: NDArray[np.float32]
    bounds: Intervals
    candidates: Assignments
    facing: NDArray[np.float64]
    chosen: int
    passed: bool

    @property
    def score(self) -> float:
        """Score of the chosen candidate; the lower the better."""
        return float(self.candidates.scores[self.chosen])

    @property
    def places(self) -> NDArray[np.int64]:
        """(S,) the places of the chosen candidate."""
        return self.candidates.places[self.chosen]

    def rivals(self, least: float) -> NDArray[np.int64]:
        """Return the other candidates that show a side as the chosen one does, best first."""
        alike = (self.facing > least) == self.passed
        alike[self.chosen] = False
        return np.flatnonzero(alike)


@dataclass(frozen=True, eq=False)
class PartMatch:
    """A part on a whole.

    Attributes
    ----------
    placement : the candidates.
    grown : the map of all vertices of the part.
    part_of_whole : (n_whole,) int64, -1 where the part does not cover the whole.
    confidence : in [0, 1].
    """

    placement: Placement
    grown: GrownMap
    part_of_whole: NDArray[np.int64]
    confidence: float


def place(part: SampledSurface, whole: Whole, factor: float, sign: float, rules: PartRules) -> Placement:
    """Search for a part, with all its lengths multiplied by a factor, on a whole.

    sign : 1 to keep the orientation, -1 to reverse it, 0 for either.
    """
    scaled = part.scaled(factor)
    lower_rows = scaled.lower_rows()
    bounds = sample_bounds(scaled, lower_rows)
    look = look_costs(ball_profiles(scaled, rules.descriptors), whole.profiles, rules.descriptors)
    problem = Assignment(bounds, whole.bounds, look, rules.search)
    found = search(problem)
    if whole.mirror is not None:
        # A cut often leaves the search only the mirrored one of two maps that are nearly as good.
        mirrored = problem.swept(whole.mirror[found.places[: rules.search.mirrored]])
        every = np.concatenate([found.places, mirrored])
        found = problem.ranked(every, rules.search.distinct, rules.search.kept)
    facing = orientation(scaled, whole.surface, bounds, found.places, rules.facing)
    facing = np.abs(facing) if sign == 0 else sign * facing
    passed = np.flatnonzero(facing > rules.facing.least)
    chosen = int(passed[0]) if passed.size else int(facing.argmax())
    return Placement(scaled, factor, lower_rows, bounds, found, facing, chosen, bool(passed.size))


def cover(placement: Placement, whole: Whole, rules: PartRules, backend: Backend = HOST) -> PartMatch:
    """Grow the chosen map of a part to all its vertices, and find what it covers."""
    part, growth = placement.part, rules.growth
    order = VertexOrder.spatial(part.vertices).vertices
    drawn = order[:: max(len(order) // growth.anchors, 1)]
    matched = anchored(part, whole.surface, placement.lower_rows, placement.places, drawn, rules.search)
    mean, spread = whole.fields.mean(axis=0), np.maximum(whole.fields.std(axis=0), 1e-9)
    fields = (curvature_fields(part, growth.times) - mean) / spread, (whole.fields - mean) / spread
    maps = [grown(part, whole.surface, fields, (drawn, matched), start, growth, backend) for start in growth.starts]
    best = min(maps, key=lambda each: each.stretch)
    region = covered(part, whole.surface, best.whole_of_part, rules.coverage)
    back = back_map(part, whole.surface, fields, best, np.flatnonzero(region), backend)
    return PartMatch(placement, best, back, confidence(placement, best, rules))


def confidence(placement: Placement, found: GrownMap, rules: PartRules) -> float:
    """Return by how much a map beats the best different one, as for whole shapes, and no more than its quality allows.

    1 − J / J' with the scores J of the samples' maps; without a rival the map is compared with one that is as bad as
    `rules.judgement.score`.
    """
    judgement, rivals = rules.judgement, placement.rivals(rules.facing.least)
    other = float(placement.candidates.scores[rivals[0]]) if rivals.size else judgement.score
    if not placement.passed or found.stretch > judgement.stretch:
        return 0.0
    return float(np.clip(1.0 - placement.score / max(min(other, judgement.score), 1e-12), 0.0, 1.0))
