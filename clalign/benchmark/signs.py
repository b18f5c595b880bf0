"""The paper's conditions: signs of eigenfunctions that agree by accident, and what a start without a search finds.

Two shapes of one connectivity and one numbering, whose eigenfunctions come from a solver with one start vector, have
similar matrices and a similar start: many eigenfunctions get the same sign on both. Renumbering one shape takes that
away and changes nothing else.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clalign.benchmark.layouts import SHUFFLE_SEED
from clalign.benchmark.pairs import Pair
from clalign.benchmark.table import markdown_table
from clalign.engine import open_backend
from clalign.errors import ClalignWarning
from clalign.evaluation.errors import evaluate
from clalign.evaluation.truth import Truth
from clalign.geometry.shape import Shape, prepare_pair
from clalign.geometry.spectra import arpack_spectrum
from clalign.matching.pair import match_shapes
from clalign.options import Options

TOLD = 0.5
"""Functions that correspond less than this, as a correlation, have no sign to compare."""
FIRST = 30


@dataclass(frozen=True)
class SignsRow:
    """One pair under one condition.

    Attributes
    ----------
    pair : name.
    shuffled : the target is renumbered.
    told : share of the eigenfunctions that correspond to one of the same index.
    agreeing, agreeing_first : share of these with the same sign: of all, and of the first `FIRST`.
    mean, exact : error of the best ξ in sqrt(area), and share of exact matches.
    xi : that ξ.
    """

    pair: str
    shuffled: bool
    told: float
    agreeing: float
    agreeing_first: float
    mean: float
    exact: float
    xi: float


def signs_row(
    pair: Pair, options: Options, exponents: Sequence[float], watch: Callable[[str], None], *, shuffled: bool
) -> SignsRow:
    """Match a pair from eigenfunctions with the solver's own signs, with the best ξ by the truth, as the paper does.

    Parameters
    ----------
    options : such as the preset "paper".
    exponents : ξ to try; signs are told of the first.
    watch : called after every match.
    """
    loaded = dataclasses.replace(pair, shuffle_seed=SHUFFLE_SEED if shuffled else None).load()
    compared, found = (0.0, 0.0, 0.0), []
    for xi in exponents:
        chosen = options.replace({"spectrum.xi": xi})
        source, target = (_unruled(shape, chosen) for shape in prepare_pair(loaded.source, loaded.target, chosen))
        if xi == exponents[0]:
            compared = sign_agreement(source, target, loaded.truth)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ClalignWarning)
            result = match_shapes(source, target, open_backend(chosen.engine), chosen)
        measured = evaluate(result, loaded.truth, mirrored=loaded.mirrored, name=loaded.name)
        found.append((measured.mean, measured.exact, xi))
        watch(f"{loaded.name}, {'shuffled' if shuffled else 'in order'}, xi {xi:g}: mean {100 * measured.mean:.2f}")
    return SignsRow(loaded.name, shuffled, *compared, *min(found))


def _unruled(shape: Shape, options: Options) -> Shape:
    """Return a shape with the scale-invariant eigenfunctions and signs that ARPACK gives."""
    count = min(options.spectrum.scale_invariant, shape.scale_invariant.count)
    spectrum = arpack_spectrum(shape.stiffness, shape.scale_invariant.mass, count)
    return dataclasses.replace(shape, scale_invariant=spectrum)


def sign_agreement(source: Shape, target: Shape, truth: Truth) -> tuple[float, float, float]:
    """Return `told`, `agreeing` and `agreeing_first` of `SignsRow` for the scale-invariant eigenfunctions of a pair."""
    points = source.mesh.vertex_of_file[truth.source_points]
    images = target.mesh.vertex_of_file[truth.target_points]
    known = (points >= 0) & (images >= 0)
    count = min(source.scale_invariant.count, target.scale_invariant.count)
    own = source.scale_invariant.functions[points[known], :count]
    others = target.scale_invariant.functions[images[known], :count]
    weights = source.scale_invariant.mass[points[known]]
    norms = np.sqrt((weights @ own**2) * (weights @ others**2))
    # Not the constant function, which every solver gives the same sign.
    correlation: NDArray[np.float64] = (weights @ (own * others) / norms)[1:]
    told = np.abs(correlation) >= TOLD
    same = correlation > 0
    first = told[: FIRST - 1]
    return float(told.mean()), float(same[told].mean()), float(same[: FIRST - 1][first].mean())


def signs_table(rows: Sequence[SignsRow]) -> str:
    """Return a Markdown table of the rows."""
    header = ("pair", "vertices", "told", "agree", f"agree, first {FIRST}", "error x 100", "exact", "xi")
    cells = [
        (
            row.pair,
            "shuffled" if row.shuffled else "in one order",
            *(f"{share:.0%}" for share in (row.told, row.agreeing, row.agreeing_first)),
            f"{100 * row.mean:.1f}",
            f"{row.exact:.0%}",
            f"{row.xi:g}",
        )
        for row in rows
    ]
    return markdown_table(header, cells, text_columns=2)
