"""Every figure by its number in the paper: what it needs and how it is drawn from a pair and its variants."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from clalign.benchmark.methods import MethodRuns, method_label
from clalign.benchmark.pairs import LoadedPair
from clalign.benchmark.records import RECORDS_FILE, Record, read_curves, read_records
from clalign.benchmark.table import mean_curve
from clalign.correspondence import Correspondence
from clalign.errors import ResultError
from clalign.evaluation.errors import Evaluation, evaluate
from clalign.evaluation.spectral import spectral_errors
from clalign.evaluation.truth import Truth, true_maps
from clalign.maps.functional_maps import PointMaps
from clalign.presentation.curves import AXIS_LABELS
from clalign.presentation.figures.eigenfunctions import (
    SHOWN_INDEX,
    draw_eigenfunctions,
    draw_pair_rotation,
    draw_variants,
)
from clalign.presentation.figures.maps import draw_error_curves, draw_matched_colours, draw_mirrored
from clalign.presentation.figures.sheet import PANEL_HEIGHT, Drawing
from clalign.presentation.figures.spectral import draw_funnel, draw_spectral_errors

MAIN = "default"
MIRRORED_SIGNS = "paper-mirrored"
CURVE_VARIANTS = ("paper", "paper-cycle", "paper-isometric", "paper-heat-kernel", MAIN)
ALIGNED_VARIANTS = (MAIN, "cycle", "isometric")
STARTS = ("paper", MIRRORED_SIGNS, "mirrored", MAIN)


@dataclass(frozen=True)
class Subject:
    """The pair that figures are drawn of.

    Attributes
    ----------
    pair : its meshes and the truth; a truth without points is none.
    runs : its matches by method.
    variants : methods that replace a figure's own choice; empty keeps it.
    index : number of the eigenfunction of Fig. 8.
    pair_index : number of the first eigenfunction of Fig. 2; None takes the pair that is turned most.
    height : of a panel of one shape, in pixels.
    comparable : the match by the default method is one by the default options.
    seed : of the points that are measured.
    """

    pair: LoadedPair
    runs: MethodRuns
    variants: tuple[str, ...] = ()
    index: int = SHOWN_INDEX
    pair_index: int | None = None
    height: int = PANEL_HEIGHT
    comparable: bool = True
    seed: int = 0

    @property
    def result(self) -> Correspondence:
        """The match by the default method."""
        return self.runs(MAIN)

    @property
    def has_truth(self) -> bool:
        """Whether anything can be measured."""
        return self.pair.truth.count > 0

    @cached_property
    def maps(self) -> PointMaps:
        """The truth; the found map where there is none."""
        truth = self.pair.truth if self.has_truth else Truth.from_index(self.result.target_of_source)
        return true_maps(self.result.source, self.result.target, truth)

    def chosen(self, own: Sequence[str]) -> dict[str, Correspondence]:
        """Return the matches of a figure by label."""
        return {method_label(name): self.runs(name) for name in self.variants or own}

    def evaluated(self, results: dict[str, Correspondence]) -> dict[str, Evaluation]:
        """Return the errors of matches by label; empty without a truth."""
        if not self.has_truth:
            return {}
        pair = self.pair
        return {
            label: evaluate(result, pair.truth, mirrored=pair.mirrored, seed=self.seed)
            for label, result in results.items()
        }


@dataclass(frozen=True)
class Plan:
    """How one figure is made.

    Attributes
    ----------
    title : what it shows.
    draw : draws it.
    needs_truth : nothing can be drawn without a truth.
    compares : it shows variants of the default method beside each other.
    """

    title: str
    draw: Callable[[Subject], Drawing]
    needs_truth: bool = True
    compares: bool = False


def _curves(subject: Subject) -> Drawing:
    evaluations = subject.evaluated(subject.chosen(CURVE_VARIANTS))
    return draw_error_curves(
        {
            unit: {label: one.curve(per_diameter=unit == "diameter") for label, one in evaluations.items()}
            for unit in AXIS_LABELS
        }
    )


def _matched(subject: Subject) -> Drawing:
    results = {subject.pair.name: subject.result}
    return draw_matched_colours(results, subject.evaluated(results), subject.height)


def _mirrored(subject: Subject) -> Drawing:
    known = subject.pair.mirrored is not None
    results = subject.chosen([name for name in STARTS if known or name != MIRRORED_SIGNS])
    return draw_mirrored(results, subject.evaluated(results), subject.height)


def _spectral(subject: Subject) -> Drawing:
    results = subject.chosen(ALIGNED_VARIANTS)
    return draw_spectral_errors({label: spectral_errors(result, subject.maps) for label, result in results.items()})


#: The paper's figures that can be computed; Fig. 4 is a diagram of the method.
PLANS: dict[str, Plan] = {
    "1": Plan(
        "eigenfunctions before and after alignment",
        lambda subject: draw_eigenfunctions(subject.result, subject.maps, height=subject.height),
        needs_truth=False,
    ),
    "2": Plan(
        "a rotation inside a pair of eigenfunctions",
        lambda subject: draw_pair_rotation(subject.result, subject.maps, subject.pair_index, subject.height),
    ),
    "3": Plan("the true C̃ with its funnel", lambda subject: draw_funnel(subject.result, subject.maps)),
    "5": Plan("error curves of the variants", _curves, compares=True),
    "6": Plan("matched colours", _matched, needs_truth=False),
    "7": Plan("a mirrored result and the search that avoids it", _mirrored, compares=True),
    "8": Plan(
        "one eigenfunction under the variants",
        lambda subject: draw_variants(subject.chosen(ALIGNED_VARIANTS), subject.maps, subject.index, subject.height),
        compares=True,
    ),
    "9": Plan("alignment error over the eigenfunctions", _spectral, compares=True),
}


def draw_recorded_curves(folder: Path) -> Drawing:
    """Draw Fig. 5 from the folder of a benchmark: the mean curve over all pairs of each suite by each method.

    Of a method that ran with several settings (versions, options, points) in one suite, the last ones count.

    Raises
    ------
    ResultError
        The folder is not one of a benchmark, or has no pair in it.
    """
    groups: dict[str, list[Record]] = {}
    records = {record.key: record for record in read_records(folder)}
    suites = {record.suite for record in records.values()}
    last = {(record.suite, record.method): record.settings for record in records.values()}
    for record in records.values():
        if record.settings != last[record.suite, record.method]:
            continue
        label = method_label(record.method)
        groups.setdefault(label if len(suites) == 1 else f"{record.suite}: {label}", []).append(record)
    if not groups:
        raise ResultError(f"{folder / RECORDS_FILE}: no pair in it")
    drawn = {}
    for unit in AXIS_LABELS:
        curves = read_curves(folder, unit)
        drawn[unit] = {label: mean_curve(group, curves) for label, group in groups.items()}
    return draw_error_curves(drawn)
