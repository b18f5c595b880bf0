"""The length on the whole of a length on the part, where the files do not tell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from clalign.partial.find import Placement, place
from clalign.partial.surface import SampledSurface
from clalign.partial.whole import Whole
from clalign.rules.parts import PartRules

Report = Callable[[float], None]


def measured_factor(placement: Placement, whole: Whole, rules: PartRules) -> float:
    """Return distances on the whole over those on the part, by least squares where the boundary has changed none."""
    bounds = placement.bounds
    trusted = (bounds.upper - bounds.lower < rules.facing.slack) & (bounds.upper > rules.facing.near)
    there = whole.bounds.upper[np.ix_(placement.places, placement.places)][trusted].astype(np.float64)
    here = bounds.upper[trusted].astype(np.float64)
    return float(there @ here / (here @ here)) if here.size else 1.0


def placed(
    part: SampledSurface,
    whole: Whole,
    factor: float,
    sign: float,
    rules: PartRules,
    *,
    same_unit: bool,
    report: Report = lambda fraction: None,
) -> Placement:
    """Search for a part at the scale of the files, and where that explains it badly, at all others.

    Parameters
    ----------
    part, whole : each in the unit of its mesh, in which its area is 1.
    factor : of the lengths of the part if both files have one unit.
    sign : see `place`.
    same_unit : they have.
    report : called with the fraction that is done.
    """
    plausible = rules.scale.least <= factor <= 1.0 / rules.scale.least
    found = place(part, whole, factor, sign, rules) if same_unit or plausible else None
    if found is not None and (same_unit or _explains(found, whole, rules)):
        return found
    best = scanned(part, whole, sign, rules, report)
    return best if found is None or _better(best, found) else found


def scanned(
    part: SampledSurface, whole: Whole, sign: float, rules: PartRules, report: Report = lambda fraction: None
) -> Placement:
    """Search for a part at all scales that are possible, quickly, and once more at the best of them; see `placed`."""
    scale = rules.scale
    search = replace(
        rules.search,
        candidates=scale.candidates,
        seeds=scale.seeds,
        improved=scale.improved,
        sweeps=scale.sweeps,
        mirrored=scale.mirrored,
    )
    quick, tried = replace(rules, search=search), []
    steps = int(np.ceil(np.log(scale.most / scale.least) / np.log(scale.step))) + 1
    for number, each in enumerate(np.geomspace(scale.most, scale.least, steps)):
        report(number / steps)
        tried.append(place(part, whole, float(each), sign, quick))
    best = max(tried, key=lambda each: (each.passed, -each.score))
    return corrected(part, whole, best, sign, rules)


def _better(one: Placement, other: Placement) -> bool:
    return (one.passed, -one.score) > (other.passed, -other.score)


def corrected(part: SampledSurface, whole: Whole, found: Placement, sign: float, rules: PartRules) -> Placement:
    """Return the placement at the scale that its own matched distances tell, if it is a better one."""
    best = found
    for _ in range(rules.scale.rounds):
        change = measured_factor(best, whole, rules)
        if abs(np.log(change)) < np.log1p(rules.scale.settled):
            break
        tried = place(part, whole, best.factor * change, sign, rules)
        if not _better(tried, best):
            break
        best = tried
    return best


def _explains(found: Placement, whole: Whole, rules: PartRules) -> bool:
    """Whether a placement is good enough, and at the right scale, to look for no other one."""
    off = abs(np.log(measured_factor(found, whole, rules)))
    return found.passed and found.score < rules.scale.known and off < np.log1p(rules.scale.close)
