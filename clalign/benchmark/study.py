"""Studies of values that were fixed by hand, the paper's or ours: one option varied, all else as in the base."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from clalign.benchmark.methods import AlignMethod, split_list
from clalign.errors import OptionError
from clalign.options import Options

if TYPE_CHECKING:
    from clalign.benchmark.table import Summary

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


def _sizes(scale_invariant: int, basis: int) -> Setting:
    return Setting(
        f"d = {scale_invariant}, k = {basis}", {"spectrum.scale_invariant": scale_invariant, "spectrum.basis": basis}
    )


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
        "d scale-invariant eigenfunctions and k functions of C",
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
    "rounds": Study("rounds of the optimisation", _values("rounds", "alignment.outer_iterations", (0, 1, 2, 3, 5, 10))),
}


def study_of(text: str, base: Options) -> Study:
    """Return a study with its rows, the base in front if none of them is it.

    Parameters
    ----------
    text : a name of `STUDIES`, or ``OPTION=VALUE,VALUE,...``; values that hold commas stand in brackets.
    base : what the rows differ from.

    Raises
    ------
    OptionError
        No such study or option.
    """
    option, equals, values = text.partition("=")
    if equals:
        study = Study(option, _values(option, option, split_list(values)))
    elif text in STUDIES:
        study = STUDIES[text]
    else:
        raise OptionError(f"unknown study {text!r}; there are {', '.join(STUDIES)}, and OPTION=VALUE,VALUE,...")
    if any(is_base(setting, base) for setting in study.settings):
        return study
    return Study(study.title, (Setting("as the options say", {}), *study.settings))


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
    """Return a Markdown table, the rows of the base in bold, with a block of rows for each suite."""
    from clalign.benchmark.table import COLUMNS, error_cells, markdown_table

    columns = COLUMNS[2:]
    rows = []
    suites = list(dict.fromkeys(summary.suite for summary in summaries))
    by_key = {(summary.suite, summary.method): summary for summary in summaries}
    for suite in suites:
        if len(suites) > 1:
            rows.append([f"*{suite}*", *("" for _ in columns)])
        for setting in settings:
            summary = by_key.get((suite, method_name(setting, base)))
            if summary is not None:
                label = f"**{setting.label}** (default)" if is_base(setting, base) else setting.label
                cells = error_cells(summary)
                rows.append([label, *(cells[name] for name in columns)])
    return markdown_table([title, *columns], rows)
