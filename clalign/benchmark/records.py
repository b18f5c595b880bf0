"""The rows that a benchmark writes: one a pair and method, appended as soon as they are known."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.benchmark.methods import Outcome
from clalign.errors import ResultError
from clalign.evaluation.errors import THRESHOLDS, Evaluation

RECORDS_FILE = "pairs.csv"
CURVES_FILE = "curves.csv"

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
    suite, pair, method, settings = key
    quality = evaluation.quality
    return Record(
        suite=suite,
        pair=pair,
        method=method,
        settings=settings,
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
        covered_vertices=quality.covered_vertices,
        covered_area=quality.covered_area,
        dirichlet=quality.dirichlet,
        stretch=quality.stretch,
        unmatched=evaluation.unmatched,
        points=int(evaluation.points.size),
        confidence=outcome.confidence,
        orientation=outcome.orientation,
        seconds=outcome.seconds,
        stages=";".join(f"{name}={seconds:.3f}" for name, seconds in outcome.stages.items()),
    )


def failed_record(key: Key, reason: str) -> Record:
    """Return the row of a pair without a map."""
    suite, pair, method, settings = key
    return Record(suite, pair, method, settings, status="failed", message=" ".join(reason.split()))


class RecordFile:
    """``pairs.csv`` and ``curves.csv`` of a folder, appended row by row and flushed to the disk.

    A run that was killed in the middle of a row loses that row only.
    """

    def __init__(self, folder: Path) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ResultError(f"{folder}: cannot make this folder ({error.strerror})") from error
        self._records = folder / RECORDS_FILE
        self._curves = folder / CURVES_FILE

    def read(self) -> list[Record]:
        """Return all rows, the last one of each key.

        Raises
        ------
        ResultError
            The file is of another kind.
        """
        return list({record.key: record for record in read_records(self._records)}.values())

    def append(self, record: Record, curves: dict[str, NDArray[np.float64]]) -> None:
        """Write the curves (by unit) and then the row, so that a row that is there has its curves."""
        header = ["suite", "pair", "method", "settings", "unit", *(f"{r:.3f}" for r in THRESHOLDS)]
        rows = [[*record.key, unit, *(f"{share:.5f}" for share in curve)] for unit, curve in curves.items()]
        _append(self._curves, header, rows)
        _append(self._records, [field.name for field in fields(Record)], [_cells(record)])


def read_records(path: Path) -> list[Record]:
    """Return the complete rows of a ``pairs.csv``; none when there is no such file.

    Raises
    ------
    ResultError
        The file is not one of these.
    """
    if not path.is_file() or not path.stat().st_size:
        return []
    names = [field.name for field in fields(Record)]
    with path.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.reader(stream))
    if not rows or rows[0] != names:
        raise ResultError(f"{path} was not written by this version's benchmark; choose another folder with --out")
    return [_record(row) for row in rows[1:] if len(row) == len(names)]


def read_curves(path: Path, unit: str) -> dict[Key, NDArray[np.float64]]:
    """Return the (251,) curves of a ``curves.csv`` in one unit ("sqrt_area" or "diameter")."""
    curves: dict[Key, NDArray[np.float64]] = {}
    if path.is_file():
        with path.open(newline="", encoding="utf-8") as stream:
            for row in csv.reader(stream):
                if len(row) == 5 + THRESHOLDS.size and row[4] == unit:
                    curves[(row[0], row[1], row[2], row[3])] = np.array(row[5:], dtype=np.float64)
    return curves


def _append(path: Path, header: Iterable[str], rows: Iterable[Iterable[str]]) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    if not path.is_file() or not path.stat().st_size:
        writer.writerow(header)
    elif not path.read_bytes().endswith(b"\n"):
        text.write("\n")
    writer.writerows(rows)
    with path.open("a", encoding="utf-8", newline="") as stream:
        stream.write(text.getvalue())
        stream.flush()
        os.fsync(stream.fileno())


def _cells(record: Record) -> list[str]:
    return [_cell(value) for value in asdict(record).values()]


def _cell(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _record(row: list[str]) -> Record:
    values: dict[str, Any] = {}
    for field, cell in zip(fields(Record), row, strict=True):
        kind = str(field.type)
        if kind == "str":
            values[field.name] = cell
        elif cell == "":
            values[field.name] = None
        elif kind.startswith("bool"):
            values[field.name] = cell == "True"
        else:
            values[field.name] = int(cell) if kind.startswith("int") else float(cell)
    return Record(**values)
