"""From two prepared shapes to R and the maps: search, up-sampling, closed form, optimisation, read-out."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from clalign.alignment.alternation import AlignedRotation, optimise_rotation
from clalign.alignment.band import funnel_band
from clalign.alignment.dense import DenseProblem, dense_distances
from clalign.alignment.metric import choose_metric
from clalign.alignment.objective import AlignmentProblem, Evaluation
from clalign.alignment.problem_data import aligned_side, sampled_factors
from clalign.alignment.rotation import StartingRotation, random_rotation
from clalign.ctrl_c import plain_interrupts
from clalign.engine.backend import Backend
from clalign.engine.band import Band
from clalign.geometry.shape import Shape, equally_smoothed
from clalign.geometry.spectra import Spectrum
from clalign.maps.functional_maps import PointMaps, point_maps
from clalign.options import Options
from clalign.refinement.patches import piecewise_maps
from clalign.refinement.precise import SurfacePoints, closest_points
from clalign.refinement.zoomout import (
    BoundSpectra,
    best_grown,
    closed_form_rotation,
    coherent_embeddings,
    coherent_steps,
    vertex_maps,
    wavelet_steps,
)
from clalign.search import SearchResult, find_isometry

Progress = Callable[[str, float, str], None]

COARSE_DESCRIPTORS = 200
"""Functions of the closed-form steps before the alignment; more cost more and were not better."""


@dataclass(frozen=True)
class AlignedPair:
    """Everything that the alignment of two shapes found, in the compact vertex order of the meshes.

    Attributes
    ----------
    maps : the final read-out.
    alignment : R with its history and losses.
    source_descriptors, target_descriptors : d eigenfunctions each, signs folded into the source's.
    functional : (k, k) C of R (Eq. 11, 26).
    xi : exponent of the metric, chosen for this pair with the metric "auto".
    points : of the target, for every source vertex; None without the sub-vertex read-out.
    search : the search's result; None with the paper's random start.
    rivals : maps of the best different candidates.
    timings : seconds a stage.
    """

    maps: PointMaps
    alignment: AlignedRotation
    source_descriptors: Spectrum
    target_descriptors: Spectrum
    functional: NDArray[np.float64]
    xi: float
    points: SurfacePoints | None
    search: SearchResult | None
    rivals: tuple[PointMaps, ...]
    timings: dict[str, float]


@dataclass
class Clock:
    """Seconds spent in each stage, and a word to whoever watches."""

    progress: Progress | None = None
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[Callable[[float, str], None]]:
        """Time a stage; yields a function that reports its fraction and a message."""
        started = time.perf_counter()

        def report(fraction: float, message: str = "") -> None:
            if self.progress is not None:
                self.progress(name, fraction, message)

        report(0.0, "")
        try:
            yield report
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - started
        report(1.0, "")


@dataclass
class Reached:
    """How far a pair has come: what Ctrl-C keeps, and what need not be done again after it.

    Attributes
    ----------
    found, maps, rivals : of the search, up-sampled.
    metric : both shapes with the descriptors of the ξ that was chosen for them, and ξ.
    start, alignment : R before and after the optimisation.
    last : the maps of the last step of the read-out that was made.
    """

    found: SearchResult | None = None
    maps: PointMaps | None = None
    rivals: tuple[PointMaps, ...] = ()
    metric: tuple[Shape, Shape, float] | None = None
    start: StartingRotation | None = None
    alignment: AlignedRotation | None = None
    last: PointMaps | None = None

    @property
    def has_map(self) -> bool:
        """Whether there is a map to keep."""
        return self.found is not None or self.alignment is not None


def align_pair(source: Shape, target: Shape, backend: Backend, options: Options, clock: Clock) -> AlignedPair:
    """Find the correspondence of two prepared shapes.

    From the end of the search on, Ctrl-C cuts short what is left: the best so far is taken the shortest way to a whole
    result, with the status "interrupted". Ctrl-C before it, or once more, is passed on.

    Parameters
    ----------
    source, target : prepared with the same options.
    clock : collects the timings.
    """
    reached = Reached()
    if source.smoothing != target.smoothing:
        with clock.stage("metric"):
            source, target = equally_smoothed(source, target, options.spectrum)
    try:
        return _aligned(source, target, backend, options, clock, reached)
    except KeyboardInterrupt:
        if not reached.has_map:
            raise
    if clock.progress is not None:
        clock.progress("interrupted", 0.0, "ending with the best so far; Ctrl-C once more gives up")
    pair = _aligned(source, target, backend, _cut_short(options), clock, reached)
    return replace(pair, alignment=replace(pair.alignment, status="interrupted"))


def _cut_short(options: Options) -> Options:
    """Return options with which every step that has not been made yet is left out."""
    changes: dict[str, object] = {"readout.refine": "none", "readout.steps": 0, "alignment.rounds": 0}
    if options.spectrum.metric == "auto":
        changes["spectrum.metric"] = "power"
    return options.replace({**changes, "search.alternatives": 0})


@plain_interrupts()
def _aligned(
    source: Shape, target: Shape, backend: Backend, options: Options, clock: Clock, reached: Reached
) -> AlignedPair:
    """Do what has not been reached yet."""
    count = min(options.spectrum.descriptors, source.descriptors.count, target.descriptors.count)
    band = funnel_band(count, options.alignment)
    xi = options.spectrum.xi
    if options.search.method == "random":
        reached.start = reached.start or StartingRotation(np.ones(count), random_rotation(count, options.seed))
    else:
        if reached.found is None:
            with clock.stage("search") as report:
                reached.found = find_isometry(source, target, backend, options.search, lambda part: report(part, ""))
        maps = _grown(source, target, backend, options, clock, reached)
        if options.spectrum.metric == "auto" and reached.metric is None:
            with clock.stage("metric"):
                reached.metric = choose_metric(backend, source, target, maps, band, options.spectrum)
        if reached.metric is not None:
            source, target, xi = reached.metric
            count = min(count, source.descriptors.count, target.descriptors.count)
            band = funnel_band(count, options.alignment)
        if reached.start is None:
            with clock.stage("closed form"):
                reached.start = _closed_form(backend, source, target, maps, band, options)
    start = reached.start
    descriptors = source.descriptors.head(count, start.signs), target.descriptors.head(count)
    with clock.stage("alignment") as report:
        problem = bind(source, target, descriptors, band, backend, options)
        reached.alignment = reached.alignment or _optimised(problem, start, options, reached.maps, report)
        functional = problem.functional_map(reached.alignment.rotation)
    with clock.stage("read-out"):
        maps, points = _final_maps(problem, reached, descriptors, target, options)
    found, rivals = reached.found, reached.rivals
    return AlignedPair(maps, reached.alignment, *descriptors, functional, xi, points, found, rivals, clock.seconds)


def _grown(
    source: Shape, target: Shape, backend: Backend, options: Options, clock: Clock, reached: Reached
) -> PointMaps:
    """Return the maps of the isometry that was found, and add those of its rivals to what was reached."""
    assert reached.found is not None
    with clock.stage("up-sampling"):
        if reached.maps is None:
            reached.maps = grown_maps(backend, source, target, reached.found.functional, options)
        for rival in reached.found.rivals[len(reached.rivals) : options.search.alternatives]:
            reached.rivals += (grown_maps(backend, source, target, rival, options),)
    return reached.maps


def _final_maps(
    problem: AlignmentProblem,
    reached: Reached,
    descriptors: tuple[Spectrum, Spectrum],
    target: Shape,
    options: Options,
) -> tuple[PointMaps, SurfacePoints | None]:
    """Return the maps after the last steps, and with the sub-vertex read-out the points that they stand for."""
    assert reached.alignment is not None
    backend, maps = problem.backend, reached.last or reached.alignment.maps
    masses = (backend.array(side.mass) for side in descriptors)
    spectra = BoundSpectra(*problem.descriptors, *masses)
    embedded = None
    for _ in range(options.readout.steps):
        # Let go of the last ones before there are more.
        embedded = None
        embedded = coherent_embeddings(backend, spectra, maps)
        reached.last = maps = point_maps(backend, *embedded, problem.orders, maps)
    if not options.readout.subvertex:
        return maps, None
    queries, points = (backend.numpy(each) for each in embedded or problem.embeddings(reached.alignment.rotation))
    return maps, closest_points(queries, points, target.mesh.faces, maps.target_of_source)


def grown_maps(
    backend: Backend, source: Shape, target: Shape, functional: NDArray[np.float64], options: Options
) -> PointMaps:
    """Return the vertex maps of a functional map from the search, up-sampled as the options say."""
    if options.readout.refine == "none":
        return vertex_maps(backend, source, target, functional)
    if options.readout.refine == "pieces":
        count = min(options.spectrum.descriptors, source.descriptors.count, target.descriptors.count)
        descriptors = source.descriptors.head(count), target.descriptors.head(count)
        return piecewise_maps(backend, source, target, descriptors, functional, options.spectrum.refinement)
    functional = best_grown(backend, source, target, functional, options.spectrum.refinement)
    maps = vertex_maps(backend, source, target, functional)
    if options.readout.refine == "wavelet":
        maps = wavelet_steps(backend, source, target, maps, 2)
    return maps


def steps_before_alignment(options: Options) -> int:
    """Return how many two-way steps come before R; maps from pieces have had enough of them."""
    return 0 if options.readout.refine == "pieces" else options.readout.steps


def bind(
    source: Shape,
    target: Shape,
    descriptors: tuple[Spectrum, Spectrum],
    band: Band,
    backend: Backend,
    options: Options,
) -> AlignmentProblem:
    """Return the alignment problem of a pair."""
    # With more functions than descriptors, α αᵀ has no inverse.
    size = min(options.spectrum.basis, source.basis.count, target.basis.count, descriptors[0].count)
    sides = (
        aligned_side(source, size, descriptors[0].functions, options.alignment),
        aligned_side(target, size, descriptors[1].functions, options.alignment),
    )
    factors = sampled_factors(source, options.alignment)
    if options.alignment.distances == "dense":
        distances = dense_distances(source, target, options.geodesics.dense_below)
        return DenseProblem(*sides, factors, distances, band, backend, options.alignment)
    return AlignmentProblem(*sides, factors, band, backend, options.alignment)


def _closed_form(
    backend: Backend, source: Shape, target: Shape, maps: PointMaps, band: Band, options: Options
) -> StartingRotation:
    """Return R from the maps after closed-form steps among the lower scale-invariant eigenfunctions."""
    steps = steps_before_alignment(options)
    if steps:
        coarse = max(min(COARSE_DESCRIPTORS, band.size), band.size // 2)
        maps = coherent_steps(backend, source.descriptors.head(coarse), target.descriptors.head(coarse), maps, steps)
    one_sided = options.alignment.sides == "one"
    return closed_form_rotation(backend, source.descriptors, target.descriptors, maps, band, one_sided)


def _optimised(
    problem: AlignmentProblem,
    start: StartingRotation,
    options: Options,
    guess: PointMaps | None,
    report: Callable[[float, str], None],
) -> AlignedRotation:
    budget = max(1, options.alignment.rounds * options.alignment.iterations)
    done = 0

    def watch(number: int, evaluation: Evaluation) -> None:
        nonlocal done
        done += 1
        report(min(done / budget, 1.0), f"round {number + 1}, loss {evaluation.total:.5f}")

    return optimise_rotation(problem, start.rotation, options.readout.readout, watch, guess)
