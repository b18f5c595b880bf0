"""What the page shows, as plain facts for JSON and as named arrays in few bits."""

from __future__ import annotations

import math
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.correspondence import Alternative, Correspondence, finite_or_none
from clalign.evaluation.errors import Evaluation
from clalign.mesh.front import Up
from clalign.option_values import leaves
from clalign.options import Options
from clalign.presentation.picture import pair_views
from clalign.transfer.colours import RAMPS, UNMATCHED, position_colours
from clalign.transfer.surface_map import SurfaceMap, surface_map

_FUNCTION_BYTES = 8_000_000
_MOST_FUNCTIONS = 120
_PROVENANCE = (
    *("device", "confidence", "orientation", "losses", "timings", "warnings", "options", "versions", "equally_good"),
)


def build_payload(
    correspondence: Correspondence,
    *,
    evaluation: Evaluation | None = None,
    functions: int | None = None,
    up: Up | None = None,
) -> tuple[dict[str, Any], dict[str, NDArray[np.generic]]]:
    """Return the facts and the arrays (uint8, uint16, uint32, int32 or float32) that the page of a match shows.

    The arguments are those of `clalign.presentation.report.write_report`.
    """
    source, target = correspondence.source, correspondence.target
    views = pair_views(correspondence, up)
    arrays: dict[str, NDArray[np.generic]] = {}
    shapes = {}
    for side, mesh, view in zip(("source", "target"), (source, target), views, strict=True):
        placed = mesh.vertices @ view.T
        low, span = placed.min(axis=0), float(np.ptp(placed, axis=0).max()) or 1.0
        arrays[f"{side}-positions"] = np.rint((placed - low) / span * 65535).astype(np.uint16)
        arrays[f"{side}-faces"] = mesh.faces.astype(np.uint16 if mesh.n_vertices < 1 << 16 else np.uint32)
        arrays[f"{side}-numbers"] = mesh.file_index.astype(np.uint32)
        shapes[side] = {
            "name": mesh.name,
            "file": Path(mesh.path).name if mesh.path else None,
            "path": mesh.path and str(Path(mesh.path).absolute()),
            "vertices": mesh.n_vertices,
            "faces": mesh.n_faces,
            "scale": finite_or_none(mesh.scale),
            "notes": list(mesh.notes),
            "low": low.tolist(),
            "span": span,
        }
    arrays["colours"] = np.rint(255 * position_colours(target.vertices, views[1])).astype(np.uint8)
    arrays["distortion"] = correspondence.distortion.astype(np.float32)
    arrays["rotation"] = correspondence.rotation.astype(np.float32)
    arrays["functional-map"] = correspondence.functional_map.astype(np.float32)
    maps = _add_maps(correspondence, arrays)
    shown = _add_functions(correspondence, functions, arrays)
    provenance = correspondence.facts()
    facts = {
        **shapes,
        "maps": maps,
        "functions": shown,
        "ramps": {name: stops.tolist() for name, stops in RAMPS.items()},
        "unmatched": (UNMATCHED * 255).round().astype(int).tolist(),
        "history": _history(correspondence),
        "evaluation": None if evaluation is None else _evaluation(evaluation),
        "changed": changed_options(correspondence.options),
        **{name: provenance[name] for name in _PROVENANCE},
    }
    return facts, arrays


def changed_options(options: Options) -> list[str]:
    """Return what follows ``--set`` on a command line that matches with the same options, orientation apart."""
    # Schedules are records, which have no text; no preset changes them.
    own = ("search.orientation", "search.alternatives", "rules.refinement.schedules")
    values = {name: attrgetter(name) for name, _ in leaves(options) if name not in own}
    return [f"{name}={read(options)}" for name, read in values.items() if read(options) != read(Options())]


def _add_maps(correspondence: Correspondence, arrays: dict[str, NDArray[np.generic]]) -> list[dict[str, Any]]:
    source, target = correspondence.source, correspondence.target
    every_map: tuple[Correspondence | Alternative, ...] = (correspondence, *correspondence.alternatives)
    described = []
    for rank, maps in enumerate(every_map):
        forward = source.map_from_file(target, maps.target_of_source)
        backward = target.map_from_file(source, maps.source_of_target)
        arrays[f"map-{rank}-target-of-source"] = forward.astype(np.int32)
        arrays[f"map-{rank}-source-of-target"] = backward.astype(np.int32)
        described.append(
            {
                "label": f"alternative {rank}" if rank else "the chosen map",
                "orientation": finite_or_none(maps.orientation),
                "score": finite_or_none(maps.score),
                "distance": finite_or_none(maps.distance) if isinstance(maps, Alternative) else 0.0,
                "relation": maps.relation if isinstance(maps, Alternative) else "",
            }
        )
    return described


def _add_functions(
    correspondence: Correspondence, wanted: int | None, arrays: dict[str, NDArray[np.generic]]
) -> dict[str, Any]:
    to_target, available = surface_map(correspondence), min(correspondence.rotation.shape)
    vertices = correspondence.source.n_vertices + correspondence.target.n_vertices
    fitting = min(_MOST_FUNCTIONS, _FUNCTION_BYTES // (2 * vertices))
    shown = min(available, max(1, fitting) if wanted is None else max(1, wanted))
    stages = {
        "before": (correspondence.source_scale_invariant.functions, correspondence.target_scale_invariant.functions),
        "after": (correspondence.source_aligned, correspondence.target_aligned),
    }
    agreement = {}
    for stage, (on_source, on_target) in stages.items():
        on_source, on_target = on_source[:, :shown], on_target[:, :shown]
        # One scale a function and stage, so that equal colours on both shapes are equal values.
        limits = np.maximum(np.abs(on_source).max(axis=0), np.abs(on_target).max(axis=0))
        limits = np.where(limits > 0, limits, 1.0)
        for side, values in (("source", on_source), ("target", on_target)):
            arrays[f"{side}-{stage}"] = np.rint(127.5 + 127.5 * (values / limits).T).astype(np.uint8)
        agreement[stage] = _agreement(on_source, on_target, to_target, correspondence.source_basis.mass)
    return {"available": available, "shown": shown, "agreement": agreement}


def _agreement(
    on_source: NDArray[np.float64], on_target: NDArray[np.float64], to_target: SurfaceMap, mass: NDArray[np.float64]
) -> list[float | None]:
    """Cosine between each source function and its target function pulled back by the map, in area weights."""
    weight = np.where(to_target.matched, mass, 0.0)[:, None]
    pulled = to_target.pull(on_target)
    inner = (weight * on_source * pulled).sum(axis=0)
    norms = np.sqrt((weight * on_source**2).sum(axis=0) * (weight * pulled**2).sum(axis=0))
    return [finite_or_none(value) for value in inner / np.where(norms > 0, norms, 1.0)]


def _history(correspondence: Correspondence) -> dict[str, list[float | None]]:
    columns = {"outer_iteration": [finite_or_none(entry.get("outer_iteration", 0)) for entry in correspondence.history]}
    every = dict.fromkeys(name for entry in correspondence.history for name in entry)
    for name in (name for name in every if name not in ("outer_iteration", "evaluation")):
        values = [finite_or_none(entry.get(name, math.nan)) for entry in correspondence.history]
        if any(value is not None and value != 0 for value in values):
            columns[name] = values
    return columns


def _evaluation(evaluation: Evaluation) -> dict[str, Any]:
    values = evaluation.as_dict()
    measured = {name: getattr(evaluation, name) for name in ("exact", "mean", "median", "mirrored_mean")}
    measured["area_under_curve"] = evaluation.area_under_curve()
    return {
        "points": values["points"],
        "distances": values["distances"],
        **{name: None if value is None else finite_or_none(value) for name, value in measured.items()},
        "threshold": values["curve"]["threshold"],
        "share": values["curve"]["per_sqrt_area"],
    }
