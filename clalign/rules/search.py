"""Numbers of prepared shapes and of the search for the isometry; see `clalign.rules`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass


@dataclass(frozen=True)
class Level:
    """One ZoomOut step among samples.

    size : functions.
    queries, points : samples of Y that are matched, and of X that they may be matched with.
    """

    size: int
    queries: int
    points: int


@dataclass(frozen=True)
class Levels:
    """ZoomOut steps among the same samples.

    sizes : functions of each step.
    queries, points : samples of Y that are matched, and of X that they may be matched with.
    """

    sizes: tuple[int, ...]
    queries: int
    points: int

    def __iter__(self) -> Iterator[Level]:
        return (Level(size, self.queries, self.points) for size in self.sizes)

    @property
    def last(self) -> Level:
        """The step with which it ends."""
        return Level(self.sizes[-1], self.queries, self.points)


@dataclass(frozen=True)
class ShapeRules:
    """Descriptors of one shape.

    oriented_functions : functions that the orientation tensor is computed for: more than any step looks at would only
        cost.
    signatures : heat kernel signatures, at times in equal ratios ...
    first_time, last_time : ... from one to the other, in units of area: before the first they tell triangulations
        apart, after the last all points of a body are alike.
    curvature_quantile : larger curvatures, of slivers and spikes, are cut to this quantile of their size ...
    curvature_time : ... before curvature is diffused for so long, in units of area, which forgets what is finer than
        about a twentieth of the size of a body.
    """

    oriented_functions: int = 30
    signatures: int = 6
    first_time: float = 0.002
    last_time: float = 0.05
    curvature_quantile: float = 0.98
    curvature_time: float = 0.001


@dataclass(frozen=True)
class StartRules:
    """The map that shapes show as they lie in space.

    normals : two vertices at one place whose normals are at right angles count as sqrt(2) times this far apart, in
        sqrt(area).
    rigid_steps : of iterated closest points, at most.
    trimmed : share of the vertices, the closest ones, that a rigid motion is fitted to: what moved otherwise is left
        out.
    """

    normals: float = 0.1
    rigid_steps: int = 50
    trimmed: float = 0.7


@dataclass(frozen=True)
class TreeRules:
    """How the candidates of one tree are made, branched and thinned.

    functions : the sign patterns of this many functions are the initial maps.
    sizes : the numbers of functions at which the tree branches.
    strengths : of the triple products in the oriented unfolding; none starts from bare sign patterns.
    carried : a column (row) of C with a smaller squared norm counts as not carried (not reached).
    lookahead : functions beyond a size in which what is not carried is looked for.
    queries, points : samples of Y and X of every step.
    least_orientation : candidates below are dropped at every size; -1 keeps all.
    slack, margin : candidates with distortion above slack · least + margin are dropped.
    radius : candidates closer than this (mean geodesic distance) are duplicates; at twice as much the front-back
        variant of a body would be merged with the truth.
    among : so many times `most` of least distortion are searched for duplicates.
    most : at most so many candidates go on.
    """

    functions: int
    sizes: tuple[int, ...]
    strengths: tuple[float, ...] = ()
    carried: float = 0.55
    lookahead: int = 6
    queries: int = 150
    points: int = 300
    least_orientation: float = -1.0
    slack: float = 3.0
    margin: float = 0.01
    radius: float = 0.03
    among: int = 4
    most: int = 80


@dataclass(frozen=True)
class TipRules:
    """Candidates from matched extremities.

    radius : a tip has no sample with a larger mean distance within so many sqrt(area): a hand is one tip, a finger is
        none; ...
    most : ... at most so many of a shape, the farthest out ones.
    assigned : tips that are matched at a time; one of six may lack a counterpart.
    least_distance : what is nearer, in units of the mean distance, counts as so far.
    tried : assignments of least cost, from which maps are read.
    first : functions of the first map, and the samples that it is read from.
    kept : candidates of least distortion that go on.
    """

    radius: float = 0.2
    most: int = 6
    assigned: int = 5
    least_distance: float = 0.05
    tried: int = 400
    first: Level = Level(16, 200, 600)
    kept: int = 24


@dataclass(frozen=True)
class SearchRules:
    """The search for the isometry.

    oriented, plain : the two trees; each finds pairs that the other misses, and the second the mirrored maps that
        become self-maps.
    unfold : functions of the first map of an unfolded candidate, and the samples that it is read from; with 12
        functions instead of 16 five of six hard pairs are missed.
    settle : ZoomOut steps of an unfolded candidate, before its orientation is looked at; ...
    settled_orientation : ... below it is dropped.
    triple_products : products n·(∇φ_a × ∇φ_b) of the first so many functions unfold a candidate.
    scored_products : products of so many functions tell the orientation of a map.
    wide : ZoomOut steps that bring candidates of all trees to the same size.
    wide_radius : mean geodesic distance of duplicates from then on.
    wide_among : so many times `wide_most` of least distortion are searched for duplicates.
    wide_most : candidates kept of each source.
    self_maps : maps of each shape to itself that candidates are composed with, ...
    self_maps_among : ... out of so many.
    not_identity : a self-map moves its samples farther than this on average.
    composed : candidates that are composed with self-maps.
    unfolded_again : candidates whose leading blocks are unfolded once more ...
    unfold_sizes : ... at these sizes, which repairs parts that are folded to different sides; ...
    unfold_join : ... and the step that joins them.
    joined : the step at which all candidates are compared.
    joined_orientation : below it a candidate is dropped there.
    finalists : candidates that go to the fine steps.
    fine : the fine ZoomOut steps.
    least_orientation : a map below is ranked behind every one above.
    distinct : mean geodesic distance from which on two maps are different ones, in units of sqrt(area).
    distance_floor : added to the sum of two distances that a difference of distances is compared with, in units of
        sqrt(area): about the spacing of the samples that distances lead to.
    given_floor : added to the difference of a user's descriptors, relative to their spread: less is noise, and a map
        without any must not have a score of 0.
    given_power : times their weight, the power of that difference in the score: at the usual weight of 0.25 it counts
        as two of the shapes' own differences do.
    first_given : functions of the map that sends samples to those with the most similar descriptors of the user, and
        the samples.
    """

    oriented: TreeRules = TreeRules(9, (16, 18, 20), strengths=(0.5, 1.0), least_orientation=0.2, most=120)
    plain: TreeRules = TreeRules(7, (8, 9, 10, 11, 12, 14, 16, 18, 20), carried=0.6)
    tips: TipRules = TipRules()
    unfold: Level = Level(16, 200, 400)
    settle: Levels = Levels((16, 16), 150, 300)
    settled_orientation: float = 0.0
    triple_products: int = 6
    scored_products: int = 7
    wide: Levels = Levels((22, 25, 28, 32, 36, 40, 40), 200, 600)
    wide_radius: float = 0.02
    wide_among: int = 3
    wide_most: int = 60
    self_maps: int = 4
    self_maps_among: int = 16
    not_identity: float = 0.1
    composed: int = 8
    unfolded_again: int = 24
    unfold_sizes: tuple[int, ...] = (9, 12, 16)
    unfold_join: Level = Level(20, 150, 300)
    joined: Level = Level(40, 200, 600)
    joined_orientation: float = 0.4
    finalists: int = 24
    fine: Levels = Levels((45, 50, 56, 63, 71, 80, 90, 100, 110, 120), 500, 1000)
    least_orientation: float = 0.5
    distinct: float = 0.05
    distance_floor: float = 0.05
    given_floor: float = 0.05
    given_power: float = 8.0
    first_given: Level = Level(16, 200, 600)


@dataclass(frozen=True)
class RivalRules:
    """The choice among the best candidates of a search in doubt, after they are grown.

    doubtful : rivals are grown where the chosen map's orientation fails, or where the confidence of the search is
        below: of 40 warped pairs the search was wrong on six, always below 0.3.
    exact : or where its score is below, which only an exact copy of the source reaches. Its samples are images of each
        other under the identity, but not under a symmetry that is as exact, so that the scores cannot be compared.
    rounded : or where even a rival's score is below, as only symmetries of a body reach: five differences of a few per
        cent each, which is what samples round them to. A person's left and right have 1e-6.
    exact_score, exact_energy : what a map of an exact copy counts as where it has less: what symmetries of a body have
        between two triangulations of it. That the triangles are the same says nothing of the shape.
    slack : candidates with a score above so many times the least ...
    resolution : ... or so many times this, where that is more, are no rivals: scores of exact maps that samples round.
    most : rivals grown at most.
    sizes : functions of the two-way steps of each rival, from the first size on. They start over from few functions,
        which forgets how limbs came about: of 8 hard pairs 8 were chosen rightly after it, 6 before.
    largest_stretch : edges stretched by more count as by so much: torn is torn.
    least_energy : energies of this size are rounding, ...
    same_energy : ... and of two that differ by less, relatively, none is the lesser.
    """

    doubtful: float = 0.5
    exact: float = 1e-12
    rounded: float = 1e-7
    exact_score: float = 5e-6
    exact_energy: float = 0.25
    slack: float = 4.0
    resolution: float = 1e-6
    most: int = 6
    sizes: tuple[int, ...] = (40, 60, 90, 130, 170, 20, 30, 40, 60, 90, 130, 170)
    largest_stretch: float = 10.0
    least_energy: float = 1e-4
    same_energy: float = 1e-3
