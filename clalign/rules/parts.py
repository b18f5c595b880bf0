"""Every number that steers the match of a part with a whole; see `clalign.rules`.

Lengths are in units of the square root of the whole's area, areas in units of that area.
"""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class PartSampleRules:
    """What a part and a whole are sampled by.

    places : samples of the whole, among which the matches of the part's samples are looked for ...
    fewest : ... and as few as this on meshes that are so large that their rows of distances would take too long.
    samples : of the part.
    margin : samples of the part lie at least so far from its boundary, where balls around them are cut off.
    boundary : samples of a boundary, between which distances on the whole may be shorter than on the part.
    functions : Laplace–Beltrami eigenfunctions of the whole.
    """

    places: int = 800
    fewest: int = 200
    samples: int = 60
    margin: float = 0.02
    boundary: int = 120
    functions: int = 400


@dataclass(frozen=True)
class PartDescriptorRules:
    """How alike a sample of the part and one of the whole look.

    radii : of the geodesic balls whose area, and mean curvature in the mean, are compared.
    soft : width of the rim of a ball, in radii, so that few triangles do not decide.
    most_area, most_curvature : logarithms of ratios count as so much at most.
    area, curvature : weights of the two terms, each over its median.
    quantile : mean curvature is cut at this quantile, against slivers and spikes.
    """

    radii: tuple[float, ...] = (0.03, 0.05, 0.075, 0.1, 0.13, 0.17, 0.22, 0.28, 0.35, 0.45)
    soft: float = 0.15
    most_area: float = 0.5
    most_curvature: float = 1.0
    area: float = 1.0
    curvature: float = 2.0
    quantile: float = 0.98


@dataclass(frozen=True)
class PartSearchRules:
    """The search for a map of the part's samples to places of the whole.

    tolerance, slope : distances d may be off by tolerance + slope · d: poses change long ones by more.
    candidates : places that look most like a sample, for each sample.
    seeds : samples, far from each other, that every start fixes one of.
    steps : of the annealing.
    coldest, hottest : inverse temperatures, from the first step to the last.
    look : weight of the look of a place against distances, in the annealing, ...
    look_last : ... in its last steps, ...
    look_score : ... and in the score.
    last : number of last steps.
    pull : weight of the fixed sample in the first steps ...
    pulled : ... and number of these.
    sweeps : over all samples, each of which takes the best of all places.
    improved : different candidates that are swept.
    apart : candidates whose maps are nearer than this on average are the same, before sweeping ...
    distinct : ... and after.
    kept : candidates.
    mirrored : best candidates that are also composed with the symmetry of the whole.
    own_floor : in the search for that symmetry, so many places look as alike as the sample itself, ...
    own_pull, own_pulled : ... and the fixed sample pulls so, for so many steps: otherwise all falls to the identity.
    own_orientation : orientation below which a self-map is a mirror symmetry.
    """

    tolerance: float = 0.025
    slope: float = 0.07
    candidates: int = 40
    seeds: int = 4
    steps: int = 14
    coldest: float = 4.0
    hottest: float = 60.0
    look: float = 1.0
    look_last: float = 0.3
    last: int = 3
    look_score: float = 0.06
    pull: float = 0.5
    pulled: int = 2
    sweeps: int = 4
    improved: int = 30
    apart: float = 0.03
    distinct: float = 0.04
    kept: int = 10
    mirrored: int = 4
    own_floor: int = 10
    own_pull: float = 2.0
    own_pulled: int = 5
    own_orientation: float = -0.4


@dataclass(frozen=True)
class PartFacingRules:
    """Which side of the surface a candidate shows.

    least : correlation of triple products of distances from which on a candidate keeps the orientation.
    slack : distances are compared whose lower bound is no further below than this, ...
    near : ... and which are longer than this.
    """

    least: float = 0.35
    slack: float = 0.02
    near: float = 0.08


@dataclass(frozen=True)
class PartStart:
    """Where ZoomOut starts.

    weight : of the pointwise descriptors beside the functions.
    functions : of the part.
    """

    weight: float
    functions: int


@dataclass(frozen=True)
class PartGrowthRules:
    """From samples to all vertices.

    anchors : vertices of the part that choose among the places by distances, for the first functional map.
    share : of these that a function of the part needs at most: functions = share · anchors.
    step : functions of the part that are added a step.
    last : functions of the part at the end.
    starts : of which the one whose map stretches least is kept.
    times : diffusion times of the mean curvature that stands beside the functions.
    torn : stretch of an edge, as (l' − l)² / l², counts as so much at most.
    ridge : of the first least squares, relative.
    """

    anchors: int = 600
    share: float = 0.25
    step: int = 8
    last: int = 160
    starts: tuple[PartStart, ...] = (PartStart(0.6, 15), PartStart(0.6, 30), PartStart(1.0, 15), PartStart(1.0, 10))
    times: tuple[float, ...] = (0.0004, 0.002)
    torn: float = 9.0
    ridge: float = 1e-3


@dataclass(frozen=True)
class PartCoverageRules:
    """What a part covers of the whole.

    edges : the area that it brings is diffused over so many mean edges of the coarser mesh.
    least : share of a vertex's area that covers it.
    """

    edges: float = 2.0
    least: float = 0.5


@dataclass(frozen=True)
class PartJudgementRules:
    """How far a map of a part is trusted.

    score : of the samples' map, from which on it explains nothing.
    stretch : of the grown map, from which on it is torn.
    """

    score: float = 0.3
    stretch: float = 0.7


@dataclass(frozen=True)
class PartExtentRules:
    """Which meshes are looked at as parts without being asked.

    open : area of the caps that would close a mesh, as a part of its own, from which on it may be a part. Ten small
        holes of a scan are below; a hand cut off at the wrist has 0.05.
    same_area : two open meshes whose areas differ by no more than this factor are both wholes.
    whole : what has so much of the other mesh's area, at the scale that explains it best, is no part of it.
    """

    open: float = 0.01
    same_area: float = 1.1
    whole: float = 0.9


@dataclass(frozen=True)
class PartScaleRules:
    """The search for the scale of a part.

    least, most : lengths of the part that are tried, as a factor of those with which its area is that of the whole.
    step : from one factor to the next.
    candidates, seeds, improved, sweeps, mirrored : of the quick search at each factor.
    known : the unit of the files is right where the score there is below ...
    close : ... and distances on the whole are those on the part up to this.
    settled : changes of the scale below this are none.
    rounds : of the correction by the distances that are matched.
    """

    least: float = 0.25
    most: float = 1.05
    step: float = 1.1
    candidates: int = 20
    seeds: int = 2
    improved: int = 6
    sweeps: int = 2
    mirrored: int = 2
    known: float = 0.2
    close: float = 0.05
    settled: float = 0.02
    rounds: int = 2


@dataclass(frozen=True)
class PartRules:
    """All rules of parts; see each group."""

    samples: PartSampleRules = field(default_factory=PartSampleRules)
    descriptors: PartDescriptorRules = field(default_factory=PartDescriptorRules)
    search: PartSearchRules = field(default_factory=PartSearchRules)
    facing: PartFacingRules = field(default_factory=PartFacingRules)
    growth: PartGrowthRules = field(default_factory=PartGrowthRules)
    coverage: PartCoverageRules = field(default_factory=PartCoverageRules)
    judgement: PartJudgementRules = field(default_factory=PartJudgementRules)
    extent: PartExtentRules = field(default_factory=PartExtentRules)
    scale: PartScaleRules = field(default_factory=PartScaleRules)
