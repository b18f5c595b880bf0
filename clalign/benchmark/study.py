"""Studies of the values that the paper fixed by hand: one option varied, all else as in the default."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from clalign.benchmark.methods import AlignMethod
from clalign.benchmark.table import Summary
from clalign.errors import OptionError
from clalign.options import Options

BASE = "base"


@dataclass(frozen=True)
class Setting:
    """One row of a study.

    label : of the row, "λ = 50".
    changes : options that differ from the base.
    """

    label: str
    changes: Mapping[str, Any]


@dataclass(frozen=True)
class Study:
    """Rows of one table.

    title : what is varied.
    settings : the rows; the base is among them or is added.
    """

    title: str
    settings: tuple[Setting, ...]


def _values(label: str, option: str, values: Sequence[Any]) -> tuple[Setting, ...]:
    return tuple(Setting(f"{label} = {value}", {option: value}) for value in values)


def _funnel(slope: float, offset: int) -> Setting:
    changes = {"alignment.band": "half", "alignment.band_slope": slope, "alignment.band_offset": offset}
    return Setting(f"a = {slope}, b = {offset}", changes)


def _sizes(descriptors: int, basis: int) -> Setting:
    return Setting(f"d = {descriptors}, k = {basis}", {"spectrum.descriptors": descriptors, "spectrum.basis": basis})


def _metric(label: str, name: str) -> Setting:
    return Setting(label, {"spectrum.metric": name})


STUDIES: dict[str, Study] = {
    "weight": Study("λ, the weight of l_unsup", _values("λ", "alignment.weight", (0, 10, 50, 200, 1000, 5000))),
    "band": Study(
        "the funnel W_i = ⌈i/a⌉ + b",
        (
            *(
                _funnel(slope, offset)
                for slope, offset in ((2.5, 2), (1.25, 2), (5.0, 2), (10.0, 2), (2.5, 0), (2.5, 20))
            ),
            Setting("full width", {"alignment.band": "full"}),
            Setting("diagonal", {"alignment.band": "diagonal"}),
            Setting("no mask", {"alignment.band": "none"}),
        ),
    ),
    "xi": Study(
        "the metric",
        (
            *_values("ξ", "spectrum.xi", (0.1, 0.2, 0.3, 0.5, 0.75, 1.0)),
            Setting("K never smoothed", {"spectrum.smoothing": 0.0}),
            Setting("K always smoothed", {"spectrum.noisy_below": 1.0}),
            _metric("Euclidean (Eq. 3)", "euclidean"),
            _metric("regularized (Eq. 7)", "regularized"),
            _metric("heat kernel", "heat-kernel"),
        ),
    ),
    "sizes": Study(
        "d descriptors and k functions of C",
        tuple(
            _sizes(d, k) for d, k in ((50, 120), (100, 120), (200, 120), (352, 120), (352, 60), (352, 30), (352, 200))
        ),
    ),
    "samples": Study(
        "N samples behind the distance factors, and vertices of the losses",
        (
            *_values("N", "geodesics.factor_samples", (25, 50, 100, 200, 400)),
            *_values("vertices", "alignment.samples", (250, 1000, 2000)),
            Setting("all vertices", {"alignment.samples": 0}),
        ),
    ),
    "rounds": Study("rounds of the optimisation", _values("rounds", "alignment.rounds", (0, 1, 2, 3, 5, 10))),
}


def settings_of(name: str, base: Options) -> tuple[Setting, ...]:
    """Return the rows of a study, with the base in front if none of them is it.

    Raises
    ------
    OptionError
        No such study.
    """
    if name not in STUDIES:
        raise OptionError(f"unknown study {name!r}; there are {', '.join(STUDIES)}")
    settings = STUDIES[name].settings
    if any(is_base(setting, base) for setting in settings):
        return settings
    return (Setting("as the options say", {}), *settings)


def is_base(setting: Setting, base: Options) -> bool:
    """Return whether a row changes nothing."""
    return base.replace(setting.changes) == base


def method_name(setting: Setting, base: Options) -> str:
    """Return the name that a row's pairs are kept under: rows of the base share theirs in every study."""
    return BASE if is_base(setting, base) else setting.label


def methods_of(settings: Sequence[Setting], base: Options) -> list[AlignMethod]:
    """Return the methods of a study, each once."""
    options = {method_name(setting, base): base.replace(setting.changes) for setting in settings}
    return [AlignMethod(name, chosen) for name, chosen in options.items()]


def study_table(title: str, settings: Sequence[Setting], summaries: Sequence[Summary], base: Options) -> str:
    """Return a Markdown table, the rows of the base in bold; errors are times 100, a block of rows for each suite."""
    header = (
        f"| {title} | pairs | mean | median | worst pair | flips | exact | under curve | time, s |\n"
        "|---|--:|--:|--:|--:|--:|--:|--:|--:|"
    )
    lines = [header]
    suites = list(dict.fromkeys(summary.suite for summary in summaries))
    by_key = {(summary.suite, summary.method): summary for summary in summaries}
    for suite in suites:
        if len(suites) > 1:
            lines.append(f"| *{suite}* | | | | | | | | |")
        for setting in settings:
            summary = by_key.get((suite, method_name(setting, base)))
            if summary is not None:
                lines.append(_row(setting.label, summary, default=is_base(setting, base)))
    return "\n".join(lines)


def _row(label: str, summary: Summary, *, default: bool) -> str:
    def number(value: float | None, factor: float, digits: int, unit: str = "") -> str:
        return "–" if value is None else f"{factor * value:.{digits}f}{unit}"

    cells = [
        f"**{label}** (default)" if default else label,
        f"{summary.pairs}" + (f" ({summary.failed} failed)" if summary.failed else ""),
        number(summary.mean, 100, 3),
        number(summary.median, 100, 3),
        number(summary.worst, 100, 2),
        "–" if summary.flips is None else str(summary.flips),
        number(summary.exact, 100, 1, " %"),
        number(summary.area_under_curve, 1, 4),
        number(summary.seconds, 1, 1),
    ]
    return f"| {' | '.join(cells)} |"
