"""The stages of a match, in their order, as pure functions over a frozen state.

    smooth → search → choose among rivals → refine → choose ξ → start R → align → read out

Every stage yields what it has reached, as often as that is worth keeping: after Ctrl-C the last of it goes on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.alignment.alternation import finished, outer_iterations
from clalign.alignment.band import funnel_band
from clalign.alignment.objective import Evaluation, Objective
from clalign.alignment.problem_data import sampled_factors, shape_data
from clalign.alignment.readout import hard_map
from clalign.alignment.rotation import StartingRotation, least_squares_start, random_rotation
from clalign.engine.backend import Backend
from clalign.geometry.shape import Shape, equally_smoothed
from clalign.geometry.spectra import Spectrum
from clalign.maps.point_maps import PointMaps
from clalign.matching.metric import choose_metric
from clalign.matching.start import started
from clalign.matching.state import MatchState, aligned_count, required, wanted_sign
from clalign.options import Options
from clalign.refinement.anchors import anchored, relative_distortion
from clalign.refinement.landmarks import choose_by_landmarks
from clalign.refinement.patches import patchwise_maps
from clalign.refinement.precise import SurfacePoints, closest_points
from clalign.refinement.rivals import choose_grown, in_doubt
from clalign.refinement.zoomout import (
    BoundSpectra,
    best_grown_map,
    joint_step,
    two_way_step,
    two_way_steps,
    vertex_maps,
)
from clalign.search.find import find_isometry

Report = Callable[[float, str], None]


@dataclass(frozen=True)
class Stage:
    """One stage.

    Attributes
    ----------
    name : in timings and progress.
    needed : whether there is something left to do for it.
    run : yields states.
    """

    name: str
    needed: Callable[[MatchState], bool]
    run: Callable[[MatchState, Backend, Report], Iterator[MatchState]]


def smooth(state: MatchState, backend: Backend, report: Report) -> Iterator[MatchState]:
    """Smooth the curvature of both shapes where one of them is noisy."""
    source, target = equally_smoothed(state.source, state.target, state.options.spectrum)
    yield replace(state, source=source, target=target)


def search(state: MatchState, backend: Backend, report: Report) -> Iterator[MatchState]:
    """Search for the isometry."""
    options = state.options
    yield replace(
        state,
        found=find_isometry(
            state.source,
            state.target,
            options.search.orientation,
            options.rules.search,
            backend,
            lambda part: report(part, ""),
        ),
    )


def use_start(state: MatchState, backend: Backend, report: Report) -> Iterator[MatchState]:
    """Take the map that the user gave instead of a search."""
    matches = required(state.start_map)
    yield replace(state, found=started(state.source, state.target, matches, state.options.rules, backend))


def use_landmarks(state: MatchState, backend: Backend, report: Report) -> Iterator[MatchState]:
    """Choose among the candidates of the search, and one that starts from the landmarks, by these."""
    found, options = required(state.found), state.options
    chosen = choose_by_landmarks(
        state.source, state.target, found, required(state.landmarks), wanted_sign(state), options.rules, backend
    )
    yield replace(state, found=chosen, landmarks_used=True)


def choose(state: MatchState, backend: Backend, report: Report) -> Iterator[MatchState]:
    """Choose anew among the candidates of a search in doubt, by what they are grown to."""
    found, options = required(state.found), state.options
    chosen = choose_grown(state.source, state.target, found, wanted_sign(state), options.rules, backend)
    yield replace(state, found=chosen, rivals_grown=True)


def anchor(state: MatchState, backend: Backend, report: Report) -> Iterator[MatchState]:
    """Put distances to anchors beside the eigenfunctions of bodies that are not isometric."""
    functional, rules = required(state.found).chosen.functional, state.options.rules
    source, target = state.source, state.target
    if relative_distortion(source, target, functional, rules, backend) >= rules.anchors.distorted:
        source, target = anchored(source, target, functional, rules, backend)
    yield replace(state, source=source, target=target, anchored=True)


def refine(state: MatchState, backend: Backend, report: Report) -> Iterator[MatchState]:
    """Refine the chosen map to all vertices, then its alternatives."""
    found, pair = required(state.found), (state.source, state.target)
    if state.maps is None:
        state = replace(state, maps=refined_maps(*pair, found.chosen.functional, state.options, backend))
        yield state
    for other in found.alternatives[len(state.alternatives) : state.options.search.alternatives]:
        refined = refined_maps(*pair, other.functional, state.options, backend)
        state = replace(state, alternatives=(*state.alternatives, refined))
        yield state


def choose_xi(state: MatchState, backend: Backend, report: Report) -> Iterator[MatchState]:
    """Choose the exponent of the metric for this pair."""
    options, maps = state.options, required(state.maps)
    source, target, xi = choose_metric(
        state.source, state.target, maps, state.band, options.spectrum, options.rules.alignment, backend
    )
    yield replace(state, source=source, target=target, xi=xi, metric_chosen=True)


def start_rotation(state: MatchState, backend: Backend, report: Report) -> Iterator[MatchState]:
    """Start R from the maps after two-way steps among the lower scale-invariant eigenfunctions, or at random."""
    options, band, maps = state.options, state.band, state.maps
    if maps is None:
        start = StartingRotation(np.ones(state.count), random_rotation(state.count, options.seed))
        yield replace(state, start=start)
        return
    source, target = state.source, state.target
    steps = steps_before_alignment(options)
    if steps:
        low = max(min(options.rules.refinement.closed_form, band.size), band.size // 2)
        spectra = BoundSpectra.of(source.scale_invariant.head(low), target.scale_invariant.head(low), backend)
        maps = two_way_steps(spectra, maps, steps, (source.order, target.order), backend)
    one_sided = options.alignment.sides == "one"
    spectra_pair = source.scale_invariant, target.scale_invariant
    yield replace(state, start=least_squares_start(*spectra_pair, maps, band, backend, one_sided=one_sided))


def align(state: MatchState, backend: Backend, report: Report) -> Iterator[MatchState]:
    """Optimise R."""
    options, start = state.options, required(state.start)
    readout, guess = options.readout.readout, state.maps
    if state.objective is None:
        bound = bind(state.source, state.target, state.scale_invariant(start.signs), backend, options)
        state = replace(state, objective=bound)
    objective = required(state.objective)
    budget, done = max(1, options.alignment.outer_iterations * options.alignment.iterations), 0

    def watch(number: int, evaluation: Evaluation) -> None:
        nonlocal done
        done += 1
        report(min(done / budget, 1.0), f"outer iteration {number + 1}, loss {evaluation.total:.5f}")

    if not state.interrupted or state.alignment is None:
        for reached in outer_iterations(objective, start.rotation, readout, watch, guess):
            state = replace(state, alignment=reached)
            yield state
    aligned = finished(objective, required(state.alignment), readout, guess)
    functional = objective.functional_map(aligned.rotation)
    yield replace(state, aligned=aligned, maps=aligned.maps, functional_map=functional)


def read_out(state: MatchState, backend: Backend, report: Report) -> Iterator[MatchState]:
    """Take the maps of R through the last two-way steps, and, if asked, to points in faces."""
    objective, aligned, maps = required(state.objective), required(state.aligned), required(state.maps)
    spectra = BoundSpectra(
        *objective.scale_invariant,
        *(backend.array(side.mass) for side in (state.source.scale_invariant, state.target.scale_invariant)),
    ).with_given(state.source, state.target)
    embedded = None
    for step in range(state.steps, state.options.readout.steps):
        # Let go of the last ones before there are more.
        embedded = None
        maps, embedded = two_way_step(spectra, maps, objective.orders, backend)
        state = replace(state, maps=maps, steps=step + 1)
        yield state
    if joint_after(state.options) and not state.joined:
        embedded = None
        size = state.options.spectrum.refinement
        maps, embedded = joint_step(state.source, state.target, spectra, size, maps, backend)
        state = replace(state, maps=maps, joined=True)
        yield state
    if state.options.readout.subvertex:
        yield replace(state, points=_points(state, objective, aligned.rotation, embedded, maps, backend))


def _points(
    state: MatchState,
    objective: Objective,
    rotation: NDArray[np.float64],
    embedded: tuple[Any, Any] | None,
    maps: PointMaps,
    backend: Backend,
) -> SurfacePoints:
    """Return the matches as points in faces, in the embeddings that `maps` were read from, else in those of R."""
    nearest = maps.target_of_source
    if embedded is None:
        embedded = objective.embeddings(rotation)
        nearest = hard_map(objective, rotation, "aligned", nearest)
    queries, points = (backend.numpy(each) for each in embedded)
    return closest_points(queries, points, state.target.mesh.faces, nearest)


STAGES = (
    Stage("metric", lambda state: state.source.smoothing != state.target.smoothing, smooth),
    Stage("search", lambda state: state.found is None and state.start_map is not None, use_start),
    Stage("search", lambda state: state.found is None and state.options.search.method != "random", search),
    Stage(
        "choice",
        lambda state: state.found is not None and state.landmarks is not None and not state.landmarks_used,
        use_landmarks,
    ),
    Stage(
        "choice",
        lambda state: (
            not (state.rivals_grown or state.interrupted or state.landmarks is not None)
            and state.found is not None
            and in_doubt(state.found, wanted_sign(state), state.options.rules)
        ),
        choose,
    ),
    Stage("choice", lambda state: state.found is not None and not (state.anchored or state.interrupted), anchor),
    Stage("refinement", lambda state: state.found is not None, refine),
    Stage(
        "metric",
        lambda state: state.options.spectrum.metric == "auto" and state.maps is not None and not state.metric_chosen,
        choose_xi,
    ),
    Stage("start of R", lambda state: state.start is None, start_rotation),
    Stage("alignment", lambda state: state.aligned is None, align),
    Stage("read-out", lambda state: True, read_out),
)


def refined_maps(
    source: Shape, target: Shape, functional: NDArray[np.float64], options: Options, backend: Backend
) -> PointMaps:
    """Return the maps between all vertices that a functional map of the search leads to, refined as the options say."""
    size, rules = options.spectrum.refinement, options.rules
    if options.readout.refine == "patches":
        count = aligned_count(source, target, options)
        high = source.scale_invariant.head(count), target.scale_invariant.head(count)
        return patchwise_maps(source, target, high, functional, size, rules.refinement, backend)
    if options.readout.refine == "zoomout":
        functional = best_grown_map(source, target, functional, size, rules, backend)
    return vertex_maps(source, target, functional, backend)


def steps_before_alignment(options: Options) -> int:
    """Return how many two-way steps come before R; maps from patches have had enough of them."""
    return 0 if options.readout.refine == "patches" else options.readout.steps


def joint_after(options: Options) -> bool:
    """Return whether the last steps end with one in both bases."""
    return options.readout.joint and options.readout.steps > 0


def bind(
    source: Shape, target: Shape, scale_invariant: tuple[Spectrum, Spectrum], backend: Backend, options: Options
) -> Objective:
    """Return the objective of a pair, for as many eigenfunctions as `scale_invariant` has."""
    # With more functions than scale-invariant ones, α αᵀ has no inverse.
    size = min(options.spectrum.basis, source.basis.count, target.basis.count, scale_invariant[0].count)
    x, y = (
        shape_data(shape, size, spectrum.functions, options.alignment)
        for shape, spectrum in zip((source, target), scale_invariant, strict=True)
    )
    factors = sampled_factors(source, options.alignment)
    band = funnel_band(scale_invariant[0].count, options.alignment)
    return Objective(x, y, factors, band, backend, options.alignment, options.rules.alignment)
