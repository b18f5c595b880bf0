"""Fig. 1, 2 and 8: eigenfunctions on both shapes, before and after alignment and under variants of the method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from clalign.correspondence import Correspondence
from clalign.errors import OptionError
from clalign.evaluation import spectral
from clalign.maps.functional_maps import PointMaps
from clalign.presentation.figures.sheet import AFTER, BEFORE, PANEL_HEIGHT, Cell, Drawing, Image, panel_sheet
from clalign.presentation.figures.surfaces import Pair, PairView

#: Paper's numbers (from 1) of the functions of Fig. 1.
SHOWN = (2, 3, 4, 5, 12, 13, 14, 15, 22, 23, 24, 25)
SHOWN_INDEX = 7

_ROTATION_COLUMNS = (
    *("matrix", "first", "second", "c11", "c12", "c21", "c22"),
    *("degrees", "reflected", "kept", "error_first", "error_second"),
)


def draw_eigenfunctions(
    result: Correspondence, maps: PointMaps, shown: Sequence[int] = SHOWN, height: int = PANEL_HEIGHT
) -> Drawing:
    """Draw Fig. 1: corresponding eigenfunctions on both shapes, before (pink) and after alignment (green).

    Parameters
    ----------
    maps : what err(k) is measured by: the truth, or the found maps where there is none.
    shown : numbers of eigenfunctions, from 1; those beyond the last one are left out.
    """
    view = PairView.of(result)
    kept = [number for number in shown if number <= min(result.rotation.shape)]
    before, after = _unaligned(result), (result.source_aligned, result.target_aligned)
    grid: list[list[Image]] = []
    for functions, background in ((before, BEFORE), (after, AFTER)):
        panels = [view.function_panels(functions, number - 1, height, background) for number in kept]
        grid += [[panel[0] for panel in panels], [panel[1] for panel in panels]]
    errors = [_errors(result, functions, maps) for functions in (before, after)]
    figure = panel_sheet(
        grid,
        columns=[f"{number}" for number in kept],
        rows=["source", "target", "source, aligned", "target, aligned"],
        notes=[f"{errors[0][number - 1]:.2f} → {errors[1][number - 1]:.2f}" for number in kept],
        gaps_after=[place for place in range(len(kept) - 1) if kept[place + 1] != kept[place] + 1],
    )
    rows = tuple((number, float(errors[0][number - 1]), float(errors[1][number - 1])) for number in kept)
    return Drawing(figure, ("eigenfunction", "error_before", "error_after"), rows)


def draw_pair_rotation(
    result: Correspondence, maps: PointMaps, first: int | None = None, height: int = PANEL_HEIGHT
) -> Drawing:
    """Draw Fig. 2: two neighbouring eigenfunctions that are turned within their span, and the turn recovered.

    `maps` is the truth; `first` the number (from 1) of the first function, None for the pair that is turned most.

    Raises
    ------
    OptionError
        There is no such pair.
    """
    true = spectral.rotation_of_truth(result, maps)
    support = spectral.support_areas(result.target_scale_invariant.functions, result.target_basis.mass)
    place = spectral.most_rotated_pair(true, support) if first is None else first - 1
    if not 0 <= place < min(result.rotation.shape) - 1:
        raise OptionError(
            f"there is no pair {place + 1}, {place + 2} among {min(result.rotation.shape)} eigenfunctions"
        )
    blocks = spectral.pair_rotation(true, place), spectral.pair_rotation(spectral.recovered_rotation(result), place)
    view = PairView.of(result)
    before, after = _unaligned(result), (result.source_aligned, result.target_aligned)
    grid = []
    for number in (place, place + 1):
        left, right = (
            view.function_panels(before, number, height, BEFORE),
            view.function_panels(after, number, height, AFTER),
        )
        grid.append([*left, *right])
    errors = [_errors(result, functions, maps)[place : place + 2] for functions in (before, after)]
    notes = [f"C̃ of the truth\n{_block_text(blocks[0])}", f"C̃ recovered\n{_block_text(blocks[1])}"]
    figure = panel_sheet(
        grid,
        columns=["source", "target", "source, aligned", "target, aligned"],
        rows=[f"eigenfunction {place + 1}", f"eigenfunction {place + 2}"],
        notes=notes,
        note_span=2,
        gaps_after=[1],
    )
    return Drawing(figure, _ROTATION_COLUMNS, _rotation_rows(place, blocks, errors))


def draw_variants(
    results: Mapping[str, Correspondence], maps: PointMaps, number: int = SHOWN_INDEX, height: int = PANEL_HEIGHT
) -> Drawing:
    """Draw Fig. 8: one eigenfunction on both shapes, unaligned and aligned by variants of the method.

    `results` are matches of the same pair by label, `maps` is the truth, `number` counts from 1.

    Raises
    ------
    OptionError
        There is no such eigenfunction.
    """
    first = next(iter(results.values()))
    if not 1 <= number <= min(first.rotation.shape):
        raise OptionError(f"there is no eigenfunction {number} among {min(first.rotation.shape)}")
    view = PairView.of(first)
    functions: dict[str, Pair] = {"unaligned": _unaligned(first)}
    functions |= {label: (result.source_aligned, result.target_aligned) for label, result in results.items()}
    panels: list[Image] = []
    for label, pair in functions.items():
        panels += view.function_panels(pair, number - 1, height, BEFORE if label == "unaligned" else AFTER)
    errors = {label: float(_errors(first, pair, maps)[number - 1]) for label, pair in functions.items()}
    figure = panel_sheet(
        [panels],
        columns=list(functions),
        column_span=2,
        rows=[f"eigenfunction {number}"],
        notes=[f"error {error:.3f}" for error in errors.values()],
        note_span=2,
        gaps_after=[2 * place + 1 for place in range(len(functions) - 1)],
    )
    rows = tuple((number, label, error) for label, error in errors.items())
    return Drawing(figure, ("eigenfunction", "variant", "error"), rows)


def _unaligned(result: Correspondence) -> Pair:
    count = min(result.rotation.shape)
    return spectral.as_computed(result.source_scale_invariant)[:, :count], result.target_scale_invariant.functions[
        :, :count
    ]


def _errors(result: Correspondence, functions: Pair, maps: PointMaps) -> NDArray[np.float64]:
    return spectral.alignment_errors(*functions, maps.target_of_source, result.source_basis.mass)


def _block_text(pair: spectral.PairRotation) -> str:
    (a, b), (c, d) = pair.block
    turn = f"{'reflected, ' if pair.reflected else ''}{pair.angle:+.0f}°, {pair.kept:.0%} inside"
    return f"{a:+.2f} {b:+.2f}\n{c:+.2f} {d:+.2f}\n{turn}"


def _rotation_rows(
    place: int, blocks: tuple[spectral.PairRotation, spectral.PairRotation], errors: Sequence[NDArray[np.float64]]
) -> tuple[tuple[Cell, ...], ...]:
    rows: list[tuple[Cell, ...]] = []
    for label, pair, measured in zip(("truth, before", "recovered, after"), blocks, errors, strict=True):
        entries = (float(entry) for entry in pair.block.ravel())
        turn = (pair.angle, str(pair.reflected).lower(), pair.kept)
        rows.append((label, place + 1, place + 2, *entries, *turn, *(float(error) for error in measured)))
    return tuple(rows)
