"""Studies of values that were fixed by hand, the paper's or ours: one option varied, all else as in the base."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from clalign.benchmark.methods import AlignMethod, split_list
from clalign.errors import OptionError
from clalign.options import Options

if TYPE_CHECKING:
    from clalign.benchmark.table import Summary

BASE = "base"


Rows = dict[str, dict[str, Any]]
"""The rows of one table: label, such as "λ = 50", to the options that differ from the base."""


def _values(label: str, option: str, values: Sequence[Any]) -> Rows:
    return {f"{label} = {value}": {option: value} for value in values}


_FUNNELS = ((2.5, 2), (1.25, 2), (5.0, 2), (10.0, 2), (2.5, 0), (2.5, 20))
_SIZES = ((50, 120), (100, 120), (200, 120), (352, 120), (352, 60), (352, 30), (352, 200))

STUDIES: dict[str, tuple[str, Rows]] = {
    "weight": ("λ, the weight of l_unsup", _values("λ", "alignment.weight", (0, 10, 50, 200, 1000, 5000))),
    "band": (
        "the funnel W_i = ⌈i/a⌉ + b",
        {
            f"a = {a}, b = {b}": {"alignment.band": "half", "alignment.band_slope": a, "alignment.band_offset": b}
            for a, b in _FUNNELS
        }
        | {
            "full width": {"alignment.band": "full"},
            "diagonal": {"alignment.band": "diagonal"},
            "no mask": {"alignment.band": "none"},
        },
    ),
    "xi": (
        "the metric",
        _values("ξ", "spectrum.xi", (0.1, 0.2, 0.3, 0.5, 0.75, 1.0))
        | {
            "K never smoothed": {"spectrum.smoothing": 0.0},
            "K always smoothed": {"spectrum.noisy_below": 1.0},
            "Euclidean (Eq. 3)": {"spectrum.metric": "euclidean"},
            "regularized (Eq. 7)": {"spectrum.metric": "regularized"},
            "heat kernel": {"spectrum.metric": "heat-kernel"},
        },
    ),
    "sizes": (
        "d scale-invariant eigenfunctions and k functions of C",
        {f"d = {d}, k = {k}": {"spectrum.scale_invariant": d, "spectrum.basis": k} for d, k in _SIZES},
    ),
    "samples": (
        "N samples behind the distance factors, and vertices of the losses",
        _values("N", "geodesics.factor_samples", (25, 50, 100, 200, 400))
        | _values("vertices", "alignment.samples", (250, 1000, 2000))
        | {"all vertices": {"alignment.samples": 0}},
    ),
    "rounds": ("rounds of the optimisation", _values("rounds", "alignment.outer_iterations", (0, 1, 2, 3, 5, 10))),
}


def study_of(text: str, base: Options) -> tuple[str, Rows]:
    """Return what is varied and the rows of its table, the base in front if none of them is it.

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
        title, rows = option, _values(option, option, split_list(values))
    elif text in STUDIES:
        title, rows = STUDIES[text]
    else:
        raise OptionError(f"unknown study {text!r}; there are {', '.join(STUDIES)}, and --vary OPTION=VALUE,...")
    if any(is_base(changes, base) for changes in rows.values()):
        return title, rows
    return title, {"as the options say": {}} | rows


def is_base(changes: Mapping[str, Any], base: Options) -> bool:
    """Return whether a row changes nothing."""
    return base.replace(changes) == base


def methods_of(rows: Rows, base: Options) -> list[AlignMethod]:
    """Return the methods of a study, each once: rows of the base share their pairs in every study."""
    options = {_method_name(label, rows, base): base.replace(changes) for label, changes in rows.items()}
    return [AlignMethod(name, chosen) for name, chosen in options.items()]


def study_table(title: str, rows: Rows, summaries: Sequence[Summary], base: Options) -> str:
    """Return a Markdown table, the rows of the base in bold, with a block of rows for each suite."""
    from clalign.benchmark.table import COLUMNS, error_cells, markdown_table

    columns = COLUMNS[2:]
    lines = []
    suites = list(dict.fromkeys(summary.suite for summary in summaries))
    by_key = {(summary.suite, summary.method): summary for summary in summaries}
    for suite in suites:
        if len(suites) > 1:
            lines.append([f"*{suite}*", *("" for _ in columns)])
        for label, changes in rows.items():
            summary = by_key.get((suite, _method_name(label, rows, base)))
            if summary is not None:
                cells = error_cells(summary)
                shown = f"**{label}** (default)" if is_base(changes, base) else label
                lines.append([shown, *(cells[name] for name in columns)])
    return markdown_table([title, *columns], lines)


def _method_name(label: str, rows: Rows, base: Options) -> str:
    return BASE if is_base(rows[label], base) else label
