"""The whole that parts are looked for on: what is computed of it once."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clalign.partial.descriptors import BallProfiles, ball_profiles, curvature_fields, look_costs
from clalign.partial.facing import orientation
from clalign.partial.growth import anchored
from clalign.partial.intervals import Intervals
from clalign.partial.search import Assignment, search
from clalign.partial.surface import SampledSurface
from clalign.rules.parts import PartRules


@dataclass(frozen=True, eq=False)
class Whole:
    """A surface with its places.

    Attributes
    ----------
    surface : its samples are the places.
    bounds : (P, P) of the distances among the places.
    profiles : of the places.
    fields : (n, f) pointwise descriptors; see `curvature_fields`.
    mirror : (P,) int64, the place that each place is exchanged with by the mirror symmetry of the whole, or None.
    """

    surface: SampledSurface
    bounds: Intervals
    profiles: BallProfiles
    fields: NDArray[np.float64]
    mirror: NDArray[np.int64] | None

    @staticmethod
    def of(surface: SampledSurface, rules: PartRules) -> Whole:
        """Compute what a search reads of a whole."""
        bounds, profiles = sample_bounds(surface), ball_profiles(surface, rules.descriptors)
        fields = curvature_fields(surface, rules.growth.times)
        without = Whole(surface, bounds, profiles, fields, None)
        return replace(without, mirror=_mirror_symmetry(without, rules))


def sample_bounds(surface: SampledSurface, lower_rows: NDArray[np.float32] | None = None) -> Intervals:
    """Return the bounds of the distances among the samples of a surface, symmetric.

    lower_rows : `SampledSurface.lower_rows`, if they are there already.
    """
    upper = surface.rows[:, surface.samples]
    lower = (surface.lower_rows() if lower_rows is None else lower_rows)[:, surface.samples]
    return Intervals(np.minimum(lower, lower.T), np.minimum(upper, upper.T))


def _mirror_symmetry(whole: Whole, rules: PartRules) -> NDArray[np.int64] | None:
    """Return the best map of a whole to itself that reverses its orientation, found as a part of it would be.

    Its own samples are the part's: the first of them are as far from each other as those of a part.
    """
    surface, search_rules = whole.surface, rules.search
    count = min(rules.samples.samples, len(surface.samples))
    own = replace(surface, samples=surface.samples[:count], rows=surface.rows[:count])
    few = np.arange(count)
    look = look_costs(ball_profiles(own, rules.descriptors), whole.profiles, rules.descriptors)
    floor = min(search_rules.own_floor, look.shape[1] - 1)
    look = np.maximum(look, np.sort(look, axis=1)[:, floor, None])
    pulled = replace(search_rules, pull=search_rules.own_pull, pulled=search_rules.own_pulled)
    bounds = whole.bounds.at(few, few)
    found = search(Assignment(bounds, whole.bounds, look, pulled))
    facing = orientation(own, surface, bounds, found.places, rules.facing)
    mirrored = np.flatnonzero(facing < search_rules.own_orientation)
    if not mirrored.size:
        return None
    lower = whole.bounds.lower[:count]
    rows = np.zeros_like(own.rows)
    rows[:, surface.samples] = lower
    places = anchored(own, surface, rows, found.places[mirrored[0]], surface.samples, search_rules)
    number = np.zeros(len(surface.vertices), dtype=np.int64)
    number[surface.samples] = np.arange(len(surface.samples))
    return number[places]
