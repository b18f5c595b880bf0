"""Numbers of the refinement and of the alignment of R; see `clalign.rules`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

PointwiseKind = Literal["curvatures", "signatures", "oriented"]


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
