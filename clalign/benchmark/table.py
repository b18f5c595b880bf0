"""Summaries of benchmark runs as Markdown and plain values, and the marked sections of pages that hold them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.benchmark.records import Key, Record
from clalign.errors import ResultError
from clalign.evaluation.errors import THRESHOLDS
from clalign.storage.files import write_text

COLUMNS = (
    *("suite", "method", "pairs", "mean", "median", "worst pair", "flips", "exact"),
    *("under curve", "covered", "time, s"),
)
"""Of a table of errors."""

SHORT_COLUMNS = ("suite", "method", "pairs", "mean", "worst pair", "flips", "exact", "time, s")
"""Those that a README has room for."""


@dataclass(frozen=True)
class Summary:
    """All pairs of one suite by one method. Errors are mean geodesic errors of pairs in sqrt(area).

    mean, median, worst : over the pairs that have a map.
    flips : pairs whose map is nearer to the mirrored truth; None where no mirror image is known.
    mirrored : mean error to the mirrored truth.
    exact, area_under_curve, coverage, dirichlet, confidence, seconds : means over the pairs.
    """

    suite: str
    method: str
    pairs: int
    failed: int
    mean: float | None
    median: float | None
    worst: float | None
    worst_pair: str
    flips: int | None
    mirrored: float | None
    exact: float | None
    area_under_curve: float | None
    area_under_curve_diameter: float | None
    coverage: float | None
    dirichlet: float | None
    confidence: float | None
    seconds: float | None


def summarise(records: Sequence[Record]) -> list[Summary]:
    """Return one summary for each suite and method, in the order in which they first appear."""
    groups: dict[tuple[str, str], list[Record]] = {}
    for record in records:
        groups.setdefault((record.suite, record.method), []).append(record)
    return [_summary(suite, method, group) for (suite, method), group in groups.items()]


def mean_curve(records: Sequence[Record], curves: Mapping[Key, NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return the (251,) mean of the curves of these records, a failed pair counting as a curve of zeros.

    Raises
    ------
    ResultError
        A record has no curve.
    """
    missing = [record for record in records if not record.failed and record.key not in curves]
    if missing:
        raise ResultError(f"no curve of {missing[0].pair} by {missing[0].method}; curves.csv and pairs.csv differ")
    total = np.zeros(THRESHOLDS.size)
    for record in records:
        if not record.failed:
            total += curves[record.key]
    return total / max(len(records), 1)


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]], text_columns: int = 1) -> str:
    """Return a Markdown table whose first `text_columns` columns are text and whose others are numbers."""
    rule = "|" + text_columns * "---|" + (len(header) - text_columns) * "--:|"
    lines = ["| " + " | ".join(cells) + " |" for cells in (header, *rows)]
    return "\n".join([lines[0], rule, *lines[1:]])


def markdown(summaries: Sequence[Summary], columns: Sequence[str] = COLUMNS) -> str:
    """Return a Markdown table with a row for every summary."""
    rows = [[cells[name] for name in columns] for cells in map(error_cells, summaries)]
    return markdown_table(columns, rows, text_columns=2)


def error_cells(summary: Summary) -> dict[str, str]:
    """Return a cell for each of `COLUMNS`: errors times 100, as in the literature, and shares in per cent."""

    def number(value: float | None, factor: float, digits: int, unit: str = "") -> str:
        return "–" if value is None else f"{value * factor:.{digits}f}{unit}"

    cells = [
        summary.suite,
        summary.method,
        f"{summary.pairs}" + (f" ({summary.failed} failed)" if summary.failed else ""),
        number(summary.mean, 100, 3),
        number(summary.median, 100, 3),
        number(summary.worst, 100, 2) + (f" ({summary.worst_pair})" if summary.worst_pair else ""),
        "–" if summary.flips is None else str(summary.flips),
        number(summary.exact, 100, 1, " %"),
        number(summary.area_under_curve, 1, 4),
        number(summary.coverage, 100, 1, " %"),
        number(summary.seconds, 1, 1),
    ]
    return dict(zip(COLUMNS, cells, strict=True))


def as_plain(summaries: Sequence[Summary], problems: Sequence[str]) -> dict[str, Any]:
    """Return the summaries and what was missing as plain values for JSON."""
    return {"summaries": [asdict(summary) for summary in summaries], "problems": list(problems)}


def failures(records: Sequence[Record]) -> list[str]:
    """Return one line for each pair without a map."""
    return [f"{r.suite}: {r.pair} by {r.method} failed: {r.message}" for r in records if r.failed]


def replace_section(text: str, name: str, body: str) -> str:
    """Return `text` with what stands between ``<!-- table:NAME -->`` and ``<!-- /table:NAME -->`` replaced.

    Raises
    ------
    ResultError
        The markers are not there exactly once, in this order.
    """
    opening, closing = f"<!-- table:{name} -->", f"<!-- /table:{name} -->"
    start, end = text.find(opening), text.find(closing)
    if text.count(opening) != 1 or text.count(closing) != 1 or end < start:
        raise ResultError(f"expected {opening} and after it {closing}, each once")
    return f"{text[: start + len(opening)]}\n{body}\n{text[end:]}"


def update_file(path: str | Path, name: str, body: str, short: str | None = None) -> None:
    """Replace the marked section `name` of a file (`replace_section`), and the section ``NAME-short``, if it has one.

    Parameters
    ----------
    short : what goes into ``NAME-short``; a file that has this section may lack the other.

    Raises
    ------
    ResultError
        The file cannot be read or written, or has no such section.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise ResultError(f"{path}: cannot be read ({error})") from error
    bodies = {name: body} if short is None else {name: body, f"{name}-short": short}
    there = [section for section in bodies if f"<!-- table:{section} -->" in text]
    try:
        for section in there or [name]:
            text = replace_section(text, section, bodies[section])
    except ResultError as error:
        raise ResultError(f"{path}: {error}") from error
    write_text(path, text)


def _summary(suite: str, method: str, records: Sequence[Record]) -> Summary:
    known = [record for record in records if not record.failed]
    means = [record.mean for record in known if record.mean is not None]
    flags = [record.flipped for record in known if record.flipped is not None]
    worst = max(known, key=lambda record: record.mean or 0.0, default=None)
    return Summary(
        suite=suite,
        method=method,
        pairs=len(records),
        failed=len(records) - len(known),
        mean=float(np.mean(means)) if means else None,
        median=float(np.median(means)) if means else None,
        worst=None if worst is None else worst.mean,
        worst_pair="" if worst is None else worst.pair,
        flips=sum(flags) if flags else None,
        mirrored=_mean(known, "mirrored_mean"),
        exact=_mean(known, "exact"),
        area_under_curve=_mean(known, "area_under_curve"),
        area_under_curve_diameter=_mean(known, "area_under_curve_diameter"),
        coverage=_mean(known, "covered_vertices"),
        dirichlet=_mean(known, "dirichlet"),
        confidence=_mean(known, "confidence"),
        seconds=_mean(known, "seconds"),
    )


def _mean(records: Sequence[Record], column: str) -> float | None:
    values = [value for record in records if (value := getattr(record, column)) is not None]
    return float(np.mean(values)) if values else None
