"""Every number that steers a result and that no user needs to know, with its reason.

Rules are passed down as arguments, written to ``result.json`` with the options, and varied by the study like options:
``--set rules.search.finalists=32``. What is not here guards floating-point arithmetic, or chooses between ways to
compute the same; ``maps/nearest.py`` and ``maps/inverted_file.py`` say from which size on, and how, nearest neighbours
are approximated, ``geometry/heat.py`` from which on distances are marched, and the modules of ``mesh/`` how damaged
files are read.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

from clalign.part_rules import PartRules

PointwiseKind = Literal["curvatures", "signatures", "oriented"]


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


@dataclass(frozen=True)
class AnchorRules:
    """Distances to anchors beside the eigenfunctions of bodies that are not isometric.

    distorted : relative distortion of the chosen map from which on they are used: people and animals in other poses are
        below 0.04, bodies with limbs of another size above.
    looked_at : farthest-point samples that may be anchors ...
    returned : ... which the map, there and back, brings this near to where they were, in sqrt(area), ...
    most : ... so many of them at most ...
    least : ... and at least; fewer say too little.
    weight : of the descriptors; see `PointDescriptors`. A fifth left hands of an ape on its feet, a half did not.
    """

    distorted: float = 0.045
    looked_at: int = 60
    returned: float = 0.08
    most: int = 40
    least: int = 10
    weight: float = 1.0


@dataclass(frozen=True)
class ZoomOutSchedule:
    """How a functional map is grown by ZoomOut.

    start : functions that are kept of it; None keeps all, and adds at once.
    step : functions added at a time.
    strength : variance of the pointwise descriptors beside the eigenfunctions, relative to theirs.
    descriptors : which; see `pointwise_descriptors`.
    repeats : steps with the functions that were kept, before any are added.
    """

    start: int | None = None
    step: int = 20
    strength: float = 0.0
    descriptors: PointwiseKind = "curvatures"
    repeats: int = 2


@dataclass(frozen=True)
class RefinementRules:
    """From the map of the search to the vertices.

    schedules : ways to grow the map; where the low functions leave a part open, each turns it differently. Starts,
        strengths and descriptors were picked on two animals and looked at on ten pairs of humans.
    queries : samples of Y that ZoomOut matches with all vertices of X; more cost more and were not better.
    samples, patches : of each shape, that maps are compared on.
    grown : Laplace-Beltrami functions that a map is grown to at first, before ...
    settle : ... steps with so many scale-invariant ones.
    regrow : functions of the steps that grow a map again in the scale-invariant basis, ...
    regrow_low : ... and in the Laplace-Beltrami basis, before `settle`.
    generations : how often that is done.
    oriented_products : last function whose triple products tell the orientation of a patch.
    compared : functions that patches are compared with.
    ridge : of the two-way least squares on samples, relative to the mean diagonal entry. Functions that live between
        the samples make the Gram matrix singular, which single precision may turn negative: its largest eigenvalue is
        some thirty times the mean, and rounds to a few millionths of it.
    closed_form : functions of the two-way steps before the alignment, half of all where that is more; more cost more
        and were not better.
    largest_descriptor : pointwise descriptors are cut at so many standard deviations.
    oriented_functions : low functions whose products with each other and with heat kernel signatures are oriented
        descriptors.
    oriented_signatures : signatures among them, by their place in `Shape.signatures`.
    oriented_time : diffusion time of the products, in units of area.
    """

    schedules: tuple[ZoomOutSchedule, ...] = (
        ZoomOutSchedule(),
        ZoomOutSchedule(40, strength=0.2, descriptors="signatures"),
        ZoomOutSchedule(30, strength=0.1, descriptors="curvatures"),
        ZoomOutSchedule(15, strength=0.5, descriptors="oriented"),
        ZoomOutSchedule(25, strength=0.25, descriptors="oriented"),
    )
    queries: int = 1000
    samples: int = 1000
    patches: int = 100
    grown: int = 140
    settle: tuple[int, ...] = (200,)
    regrow: tuple[int, ...] = (60, 80, 110, 150, 200, 250)
    regrow_low: tuple[int, ...] = (60, 90, 130, 170)
    generations: int = 2
    oriented_products: int = 11
    compared: int = 250
    ridge: float = 1e-5
    closed_form: int = 200
    largest_descriptor: float = 3.0
    oriented_functions: int = 8
    oriented_signatures: tuple[int, ...] = (1, 4)
    oriented_time: float = 5e-4


@dataclass(frozen=True)
class AlignmentRules:
    """The alignment of R.

    ridge : of the least squares for C (Eq. 11), relative to the mean of the diagonal of α αᵀ.
    memory : steps that L-BFGS remembers.
    exponents : ξ that the metric "auto" tries, from the most to the least scale-invariant; outside this range the error
        grew on every pair tried.
    least_singular_value, quantile : the first ξ is taken at which this quantile of the singular values of C̃ inside the
        funnel is at least so large.
    """

    ridge: float = 1e-6
    memory: int = 50
    exponents: tuple[float, ...] = (0.5, 0.3, 0.15)
    least_singular_value: float = 0.6
    quantile: float = 0.1


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
class Rules:
    """All rules; see each group."""

    shape: ShapeRules = field(default_factory=ShapeRules)
    start: StartRules = field(default_factory=StartRules)
    search: SearchRules = field(default_factory=SearchRules)
    rivals: RivalRules = field(default_factory=RivalRules)
    landmarks: LandmarkRules = field(default_factory=LandmarkRules)
    anchors: AnchorRules = field(default_factory=AnchorRules)
    refinement: RefinementRules = field(default_factory=RefinementRules)
    alignment: AlignmentRules = field(default_factory=AlignmentRules)
    judgement: JudgementRules = field(default_factory=JudgementRules)
    collection: CollectionRules = field(default_factory=CollectionRules)
    parts: PartRules = field(default_factory=PartRules)
