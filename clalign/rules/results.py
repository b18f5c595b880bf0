"""Numbers by which results are judged, corrected, related and laid on each other; see `clalign.rules`."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class JudgementRules:
    """When a result says that it is in doubt.

    low_confidence : a best different map whose score is within this share of the chosen one's is worth a warning.
    low_orientation : an orientation nearer to zero is worth a warning: below are maps with parts turned inside out, as
        between half a body and a whole one (0.4 to 0.7); near-isometries reach 0.95.
    """

    low_confidence: float = 0.15
    low_orientation: float = 0.9


@dataclass(frozen=True)
class CollectionRules:
    """The network of a collection's maps.

    wrong : a map that deviates from the network's by more than this is a different one: a flip of left and right has
        about 1.
    worse : a repaired map that distorts distances by this much more than the matched one is not taken.
    smallest_spread : deviations below are taken for those of right maps.
    least_weight : what the most doubtful map still weighs, so that a shape with none but such stays in the network.
    least_confidence : a map of less weighs as one of this.
    reweightings : of the maps, at most.
    """

    wrong: float = 0.5
    worse: float = 1.5
    smallest_spread: float = 0.25
    least_weight: float = 1e-6
    least_confidence: float = 0.05
    reweightings: int = 12


@dataclass(frozen=True)
class LandmarkRules:
    """What known landmarks decide.

    most : candidates of the search that they choose among.
    cap : a landmark that a candidate sends farther away counts as this far, in sqrt(area): one wrong landmark of five
        must not decide.
    worse : candidates whose landmarks are off by this much more than the best one's, in sqrt(area), are no rivals.
    contradicted : the final map contradicts a landmark that it sends farther away than this, in sqrt(area).
    """

    most: int = 12
    cap: float = 0.4
    worse: float = 0.04
    contradicted: float = 0.15


@dataclass(frozen=True)
class RelationRules:
    """How maps that are equally good are told apart in words.

    most : candidates of the search that are looked at.
    functions, samples : of the source, in which the map between them is looked at.
    moved, everything : a point moves if it goes farther; a map that moves so much of the area moves all but the middle.
    back, nearly_back : all is back if points are at most so far away on average, or so many times what one step moves,
    highest_order : after at most so many steps.
    equal : a map is as good as the chosen one if its score is at most so many times that.
    one_way, one_way_only : two sides are exchanged if so much of the movement goes one way (half turns have much).
    no_way : a turn is about an axis along which no more of it goes.
    """

    most: int = 12
    functions: int = 40
    samples: int = 400
    moved: float = 0.1
    everything: float = 0.5
    back: float = 0.05
    nearly_back: float = 0.25
    highest_order: int = 12
    equal: float = 2.0
    one_way: float = 0.7
    one_way_only: float = 0.97
    no_way: float = 0.12


@dataclass(frozen=True)
class RegistrationRules:
    """How the source is laid on the target.

    match : edges over which the pull to the matches gives way to stiffness; 1.5 and 8 were less near to the truth.
    surface, solves : the same of the pull to the surface, ever closer, and how many solves there are with each.
    rim : vertices of the source's boundary whose matches are within so many edges of the target's stay on that.
    carried_by, filling : a part that the target lacks moves along with so many vertices around it, then has solves.
    settling : solves after folds were taken out.
    least_area : moves that leave a face less of its area, relative to the whole surface, are taken back.
    """

    match: float = 3.0
    surface: tuple[float, ...] = (100.0, 1.0, 0.5)
    solves: int = 5
    rim: float = 2.0
    carried_by: int = 60
    filling: int = 10
    settling: int = 6
    least_area: float = 0.05
