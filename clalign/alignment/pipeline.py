"""From two prepared shapes to R and the maps: search, up-sampling, closed form, optimisation, read-out."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from clalign.alignment.dense import DenseProblem, dense_distances
from clalign.alignment.funnel import funnel_band
from clalign.alignment.maps import PointMaps, point_maps
from clalign.alignment.metric import choose_metric
from clalign.alignment.pieces import piecewise_maps
from clalign.alignment.problem import AlignmentProblem, Evaluation
from clalign.alignment.refine import (
    best_grown,
    closed_form_rotation,
    coherent_embeddings,
    coherent_steps,
    vertex_maps,
    wavelet_steps,
)
from clalign.alignment.rotation import StartingRotation, random_rotation
from clalign.alignment.rounds import AlignedRotation, embeddings, optimise_rotation
from clalign.alignment.search import SearchResult, find_isometry
from clalign.alignment.subvertex import SurfacePoints, closest_points
from clalign.alignment.views import aligned_side, sampled_factors
from clalign.engine.backend import Backend, Band
from clalign.geometry.shape import Shape
from clalign.geometry.spectra import Spectrum
from clalign.options import Options

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


def align_pair(source: Shape, target: Shape, backend: Backend, options: Options, clock: Clock) -> AlignedPair:
    """Find the correspondence of two prepared shapes.

    Parameters
    ----------
    source, target : prepared with the same options.
    clock : collects the timings.
    """
    count = min(options.spectrum.descriptors, source.descriptors.count, target.descriptors.count)
    band = funnel_band(count, options.alignment)
    found: SearchResult | None = None
    rivals: tuple[PointMaps, ...] = ()
    xi = options.spectrum.xi
    if options.search.method == "random":
        start = StartingRotation(np.ones(count), random_rotation(count, options.seed))
    else:
        with clock.stage("search") as report:
            found = find_isometry(source, target, backend, options.search, lambda fraction: report(fraction, ""))
        with clock.stage("up-sampling"):
            maps = grown_maps(backend, source, target, found.functional, options)
            rivals = tuple(
                grown_maps(backend, source, target, rival, options)
                for rival in found.rivals[: options.search.alternatives]
            )
        if options.spectrum.metric == "auto":
            with clock.stage("metric"):
                source, target, xi = choose_metric(backend, source, target, maps, band, options.spectrum)
                count = min(count, source.descriptors.count, target.descriptors.count)
                band = funnel_band(count, options.alignment)
        with clock.stage("closed form"):
            start = _closed_form(backend, source, target, maps, band, options)
    descriptors = source.descriptors.head(count, start.signs), target.descriptors.head(count)
    with clock.stage("alignment") as report:
        problem = bind(source, target, descriptors, band, backend, options)
        alignment = _optimised(problem, start, options, report)
        functional = problem.functional_map(alignment.rotation)
    with clock.stage("read-out"):
        maps, points = _final_maps(problem, alignment, descriptors, target, options)
    return AlignedPair(maps, alignment, *descriptors, functional, xi, points, found, rivals, clock.seconds)


def _final_maps(
    problem: AlignmentProblem,
    alignment: AlignedRotation,
    descriptors: tuple[Spectrum, Spectrum],
    target: Shape,
    options: Options,
) -> tuple[PointMaps, SurfacePoints | None]:
    """Return the maps after the last steps, and with the sub-vertex read-out the points that they stand for."""
    backend, maps = problem.backend, alignment.maps
    queries, embedding = embeddings(problem, alignment.rotation)
    for _ in range(options.readout.steps):
        queries, embedding = coherent_embeddings(backend, *descriptors, maps)
        maps = point_maps(backend, queries, embedding)
    if not options.readout.subvertex:
        return maps, None
    return maps, closest_points(queries, embedding, target.mesh.faces, maps.target_of_source)


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


def bind(
    source: Shape,
    target: Shape,
    descriptors: tuple[Spectrum, Spectrum],
    band: Band,
    backend: Backend,
    options: Options,
) -> AlignmentProblem:
    """Return the alignment problem of a pair."""
    size = min(options.spectrum.basis, source.basis.count, target.basis.count)
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
    if options.readout.refine != "pieces":
        coarse = max(min(COARSE_DESCRIPTORS, band.size), band.size // 2)
        maps = coherent_steps(
            backend, source.descriptors.head(coarse), target.descriptors.head(coarse), maps, options.readout.steps
        )
    one_sided = options.alignment.sides == "one"
    return closed_form_rotation(backend, source.descriptors, target.descriptors, maps, band, one_sided)


def _optimised(
    problem: AlignmentProblem,
    start: StartingRotation,
    options: Options,
    report: Callable[[float, str], None],
) -> AlignedRotation:
    budget = max(1, options.alignment.rounds * options.alignment.iterations)
    done = 0

    def watch(number: int, evaluation: Evaluation) -> None:
        nonlocal done
        done += 1
        report(min(done / budget, 1.0), f"round {number + 1}, loss {evaluation.total:.5f}")

    return optimise_rotation(problem, start.rotation, options.readout.readout, watch)
