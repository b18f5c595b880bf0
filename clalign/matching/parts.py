"""Matching a part with a whole: what it decides, its stages, and its result."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clalign.correspondence import Correspondence
from clalign.engine.backend import Backend
from clalign.geometry.cache import ShapeCache
from clalign.geometry.heat_process import HeatProcess
from clalign.geometry.workers import single_threaded_blas, thread_pool
from clalign.matching.loop import Clock
from clalign.matching.part_result import part_result
from clalign.matching.state import orientation_sign
from clalign.mesh.mesh import Mesh
from clalign.options import Options
from clalign.partial.extent import Side, suspected_part
from clalign.partial.find import Placement, cover
from clalign.partial.partiality import Partiality
from clalign.partial.scale import placed, scanned
from clalign.partial.surface import SampledSurface, part_surface, whole_surface
from clalign.partial.whole import Whole
from clalign.rules.parts import PartRules


@dataclass(frozen=True)
class Roles:
    """Which of two meshes is the part of the other.

    side : the part.
    asked : a user said so; otherwise the meshes look so, and the search may find that they are two wholes.
    """

    side: Side
    asked: bool


def roles(source: Mesh, target: Mesh, options: Options) -> Roles | None:
    """Return which mesh is matched as a part of the other; None for two wholes."""
    asked = options.partial.part
    if asked == "none" or (asked == "auto" and options.search.method == "random"):
        return None
    if asked != "auto":
        return Roles(asked, True)
    suspected = suspected_part(source, target, options.rules.parts.extent)
    return None if suspected is None else Roles(suspected, False)


def match_part(
    source: Mesh, target: Mesh, roles: Roles, backend: Backend, options: Options, clock: Clock, cache: ShapeCache | None
) -> Correspondence | None:
    """Match a part with a whole; None where the search finds that both are wholes, or nothing.

    Raises
    ------
    MeshError, ConvergenceError
        See `clalign.matching.match`.
    """
    part, whole = (source, target) if roles.side == "source" else (target, source)
    rules, factor = options.rules.parts, part.scale / whole.scale
    with single_threaded_blas(), np.errstate(over="ignore", under="ignore"):
        with clock.stage("prepare"):
            prepared, places = _prepared(part, whole, factor, rules, cache)
        with clock.stage("search") as report:
            sign = orientation_sign(options)
            same = options.partial.scale == "same"
            found = placed(prepared, places, factor, sign, rules, same_unit=same, report=lambda done: report(done, ""))
        if not (roles.asked or _is_part(found, rules)):
            return None
        with clock.stage("refinement"):
            chosen = cover(found, places, rules, backend)
        if chosen.grown.stretch > rules.judgement.stretch and not same and found.factor == factor:
            # Samples could not tell that the scale of the files is wrong; torn edges do.
            with clock.stage("search") as report:
                again = scanned(prepared, places, sign, rules, lambda done: report(done, ""))
            with clock.stage("refinement"):
                chosen = min(chosen, cover(again, places, rules, backend), key=lambda each: each.grown.stretch)
        found = chosen.placement
        if not (roles.asked or _is_part(found, rules)):
            return None
        with clock.stage("refinement"):
            rivals = found.rivals(rules.facing.least)[: options.search.alternatives]
            others = [cover(replace(found, chosen=int(each)), places, rules, backend) for each in rivals]
        partiality = Partiality(roles.side, found.factor / factor, found.part.area, roles.asked)
        with clock.stage("result"):
            return part_result(source, target, partiality, places, chosen, others, backend, options, clock.seconds)


def _prepared(
    part: Mesh, whole: Mesh, factor: float, rules: PartRules, cache: ShapeCache | None
) -> tuple[SampledSurface, Whole]:
    """Prepare both, the whole's distances in another process meanwhile."""
    margin = rules.samples.margin / float(np.clip(factor, rules.scale.least, 1.0))
    process = HeatProcess()
    try:
        with thread_pool(1) as pool:
            surface = pool.submit(whole_surface, whole, rules, process.farthest_points, cache)
            prepared = part_surface(part, margin, rules.growth.last, rules, cache)
            return prepared, Whole.of(surface.result(), rules)
    finally:
        process.stop()


def _is_part(found: Placement, rules: PartRules) -> bool:
    """Whether a placement makes sense, and is not that of a whole."""
    return found.passed and found.score < rules.judgement.score and found.part.area < rules.extent.whole
