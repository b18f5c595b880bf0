"""The rows that a benchmark writes: one a pair and method, appended as soon as they are known."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clalign.benchmark.methods import Outcome
from clalign.evaluation.errors import THRESHOLDS, Evaluation
from clalign.storage.rows import RowFile, append_rows, complete_rows

RECORDS_FILE = "pairs.csv"
CURVES_FILE = "curves.csv"
_CURVES_HEADER = ["suite", "pair", "method", "settings", "unit", *(f"{r:.3f}" for r in THRESHOLDS)]

Key = tuple[str, str, str, str]


@dataclass(frozen=True)
class Record:
    """One pair by one method. Lengths are in sqrt(area) of the target, times in seconds.

    settings tells runs with other options or points apart; message is the reason of a failure; stages are
    "name=seconds" joined by ";". A value that does not exist is None, an empty cell in the file.
    """

    suite: str
    pair: str
    method: str
    settings: str
    status: str
    message: str = ""
    mean: float | None = None
    median: float | None = None
    q90: float | None = None
    maximum: float | None = None
    exact: float | None = None
    area_under_curve: float | None = None
    area_under_curve_diameter: float | None = None
    diameter: float | None = None
    mirrored_mean: float | None = None
    flipped: bool | None = None
    subvertex_mean: float | None = None
    covered_vertices: float | None = None
    covered_area: float | None = None
    dirichlet: float | None = None
    stretch: float | None = None
    unmatched: int | None = None
    points: int | None = None
    confidence: float | None = None
    orientation: float | None = None
    seconds: float | None = None
    stages: str = ""

    @property
    def key(self) -> Key:
        """What makes a second run of the same thing unnecessary."""
        return (self.suite, self.pair, self.method, self.settings)

    @property
    def failed(self) -> bool:
        """Whether there is no map."""
        return self.status != "ok"


def record_of(key: Key, evaluation: Evaluation, outcome: Outcome) -> Record:
    """Return the row of a pair that was matched."""
    return Record(
        *key,
        status="ok",
        mean=evaluation.mean,
        median=evaluation.median,
        q90=float(np.quantile(evaluation.errors, 0.9)),
        maximum=float(evaluation.errors.max()),
        exact=evaluation.exact,
        area_under_curve=evaluation.area_under_curve(),
        area_under_curve_diameter=evaluation.area_under_curve(per_diameter=True),
        diameter=evaluation.diameter,
        mirrored_mean=evaluation.mirrored_mean,
        flipped=evaluation.flipped,
        subvertex_mean=evaluation.subvertex_mean,
        **asdict(evaluation.quality),
        unmatched=evaluation.unmatched,
        points=int(evaluation.points.size),
        confidence=outcome.confidence,
        orientation=outcome.orientation,
        seconds=outcome.seconds,
        stages=";".join(f"{name}={seconds:.3f}" for name, seconds in outcome.stages.items()),
    )


def failed_record(key: Key, reason: str) -> Record:
    """Return the row of a pair without a map; the reason becomes one line."""
    return Record(*key, status="failed", message=" ".join(reason.split()))


def append_record(folder: Path, record: Record, curves: dict[str, NDArray[np.float64]]) -> None:
    """Write the curves (by unit) and then the row, so that a row that is there has its curves."""
    rows = [[*record.key, unit, *(f"{share:.5f}" for share in curve)] for unit, curve in curves.items()]
    append_rows(folder / CURVES_FILE, _CURVES_HEADER, rows)
    RowFile(folder / RECORDS_FILE, Record).append(record)


def read_records(folder: Path) -> list[Record]:
    """Return the complete rows of a benchmark's folder; none when there is no such file.

    Raises
    ------
    ResultError
        The file is of another kind.
    """
    return RowFile(folder / RECORDS_FILE, Record).read()


def read_curves(folder: Path, unit: str) -> dict[Key, NDArray[np.float64]]:
    """Return the (251,) curves of a benchmark's folder in one unit ("sqrt_area" or "diameter").

    Raises
    ------
    ResultError
        The file is of another kind.
    """
    rows = complete_rows(folder / CURVES_FILE, _CURVES_HEADER)
    return {(row[0], row[1], row[2], row[3]): np.array(row[5:], np.float64) for row in rows if row[4] == unit}
