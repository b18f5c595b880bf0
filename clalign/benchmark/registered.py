"""How registered meshes come out over pairs with a truth: folds, distance, and errors beside the map's."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clalign.benchmark.pairs import BenchmarkPair
from clalign.errors import ClalignWarning
from clalign.evaluation.errors import error_curve, evaluate
from clalign.geometry.cache import ShapeCache
from clalign.matching.pair import match
from clalign.options import Options
from clalign.registration.quality import Quality
from clalign.registration.register import register


@dataclass(frozen=True)
class RegisteredPair:
    """One pair.

    Attributes
    ----------
    name : of the pair.
    faces : of the source.
    quality : of the registered mesh.
    map_errors, place_errors : (p,) geodesic errors of the matched vertices, and of the places of the registered ones,
        in sqrt(area).
    seconds : of the registration, without the match.
    """

    name: str
    faces: int
    quality: Quality
    map_errors: NDArray[np.float64]
    place_errors: NDArray[np.float64]
    seconds: float


def registered_pairs(
    pairs: Sequence[BenchmarkPair], options: Options, *, points: int | None = None, seed: int = 0
) -> Iterator[RegisteredPair]:
    """Match each pair, lay its source on its target, and measure both against the truth.

    Parameters
    ----------
    points : of the truth that are measured; None as in `evaluate`.
    """
    chosen, cache = options.replace({"readout.subvertex": True}), ShapeCache()
    for each in pairs:
        pair = each.load()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ClalignWarning)
            result = match(pair.source, pair.target, chosen, cache=cache)
        started = time.perf_counter()
        found = register(result)
        seconds = time.perf_counter() - started
        places = np.maximum(found.target_faces, 0), found.barycentric
        measured = evaluate(
            result, pair.truth, barycentric=places, points=points, seed=seed, method="bounded", name=pair.name
        )
        registered = np.asarray(measured.subvertex_errors)
        yield RegisteredPair(pair.name, pair.source.n_faces, found.quality, measured.errors, registered, seconds)


def registered_curves(pairs: Sequence[RegisteredPair]) -> dict[str, NDArray[np.float64]]:
    """Return mean curves (251,) of both kinds of errors over the pairs."""
    return {
        "vertices of the map": np.mean([error_curve(pair.map_errors) for pair in pairs], axis=0),
        "registered vertices": np.mean([error_curve(pair.place_errors) for pair in pairs], axis=0),
    }


def registered_table(pairs: Sequence[RegisteredPair]) -> str:
    """Return a Markdown table, with a last row of means."""
    names = (
        "pair",
        "turned over",
        "collapsed",
        "distance",
        "of middles",
        "error of the map",
        "95 %",
        "registered",
        "95 %",
    )
    head = f"| {' | '.join((*names, 'shear', 'seconds'))} |"
    rows = [_row(pair.name, [pair]) for pair in pairs]
    return "\n".join([head, "|---|" + "---:|" * 10, *rows, _row("**all**", pairs)])


def _row(name: str, pairs: Sequence[RegisteredPair]) -> str:
    turned = sum(round(pair.quality.flipped * pair.faces) for pair in pairs)
    collapsed = sum(round(pair.quality.collapsed * pair.faces) for pair in pairs)
    means = [np.mean([getattr(pair.quality, name) for pair in pairs]) for name in ("distance", "middles", "shear")]
    errors = [
        100 * np.mean([of(getattr(pair, kind)) for pair in pairs])
        for kind in ("map_errors", "place_errors")
        for of in (np.mean, lambda values: np.quantile(values, 0.95))
    ]
    seconds = np.mean([pair.seconds for pair in pairs])
    said = [f"{turned}", f"{collapsed}", f"{means[0]:.4f}", f"{means[1]:.3f}", *(f"{each:.3f}" for each in errors)]
    return f"| {name} | {' | '.join([*said, f'{means[2]:.2f}', f'{seconds:.1f}'])} |"
