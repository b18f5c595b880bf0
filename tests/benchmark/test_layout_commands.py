"""``bench`` on a small folder in the layout of each data set, made from the bundled humans."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import datasets
import numpy as np
import pytest
import shapes

from clalign.benchmark.methods import Outcome
from clalign.benchmark.pairs import LoadedPair
from clalign.cli.bench import accuracy
from clalign.cli.main import main

if TYPE_CHECKING:
    from conftest import Pair


@dataclass(frozen=True)
class Oracle:
    """Answers with the truth that the layout's reader found: its error is 0 if and only if the reader is right."""

    name: str
    settings: str = "1"

    def __call__(self, pair: LoadedPair) -> Outcome:
        index = np.full(pair.source.file_count, -1, dtype=np.int64)
        index[pair.truth.source_points] = pair.truth.target_points
        return Outcome(index, 0.1)


def bodies(pair: Pair) -> list[datasets.Arrays]:
    """The same person in two poses with one numbering, and the first pose once more, bent."""
    vertices, faces = pair.source
    return [(vertices, faces), (pair.target[0][pair.truth], faces), (shapes.bent(vertices, 0.1), faces)]


def write_faust(root: Path, pair: Pair) -> list[str]:
    for number, body in enumerate(bodies(pair)):
        datasets.write_ply(root / "registrations" / f"tr_reg_{number:03d}.ply", *body)
    (root / "registrations" / "tr_reg_003.ply").write_text("ply\nnot a mesh\n", encoding="ascii")
    return ["--root", str(root / "registrations")]


def write_remeshed(root: Path, pair: Pair) -> list[str]:
    root.mkdir()
    for number, body in enumerate(bodies(pair)):
        own, faces, place = shapes.renumbered(*body, number)
        shapes.write_off(root / f"tr_reg_{number:03d}.off", own, faces)
        datasets.write_numbers(root / "corres" / f"tr_reg_{number:03d}.vts", place + 1)
    (root / "tr_reg_003.off").write_text("OFF\n3 1\n", encoding="ascii")
    datasets.write_numbers(root / "corres" / "tr_reg_003.vts", [1, 2, 3])
    (root / "pairs.txt").write_text("tr_reg_000 tr_reg_001\n0, 2\n0 3\n0 9\n", encoding="ascii")
    return ["--root", str(root), "--pairs", "pairs.txt"]


def write_classes(root: Path, pair: Pair) -> list[str]:
    root.mkdir()
    for number, body in enumerate(bodies(pair)):
        shapes.write_off(root / f"david{number}.off", *body)
    (root / "david3.off").write_text("", encoding="ascii")
    shapes.write_off(root / "egg0.off", *datasets.symmetric()[0])
    return ["--root", str(root)]


@pytest.mark.parametrize("write", [write_faust, write_remeshed, write_classes])
def test_every_layout_runs_and_names_what_is_wrong(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    human_pair: Pair,
    write: Callable[[Path, Pair], list[str]],
) -> None:
    monkeypatch.setattr(accuracy, "named_methods", lambda names, _: [Oracle(name) for name in names])
    arguments = write(tmp_path / "data", human_pair)
    command = ["bench", "faust", *arguments, "--out", str(tmp_path / "out"), "--points", "40", "--json"]
    assert main([*command, "--variants", "default"]) == 1
    captured = capsys.readouterr()
    (summary,) = json.loads(captured.out)["summaries"]
    assert (summary["pairs"], summary["failed"]) == (3, 1)
    assert summary["mean"] == 0.0
    assert summary["exact"] == 1.0
    (failure,) = [line for line in captured.err.splitlines() if " failed: " in line]
    assert "_003" in failure or "david3" in failure
    assert "Traceback" not in captured.err
    problems = json.loads(captured.out)["problems"]
    if write is write_remeshed:
        assert any("no mesh tr_reg_009" in problem for problem in problems)


def test_humans_layout_reads_lines_of_the_body(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, human_pair: Pair
) -> None:
    monkeypatch.setattr(accuracy, "named_methods", lambda names, _: [Oracle(name) for name in names])
    root = tmp_path / "remeshed"
    for number, body in enumerate(bodies(human_pair)):
        own, faces, place = shapes.renumbered(*body, number)
        datasets.write_ply(root / f"ap{number}.ply", own, faces)
        datasets.write_numbers(root / f"ap{number}.truth.txt", place)
    (root / "pairs_same.txt").write_text("ap0 ap1\nap0 ap2\n", encoding="ascii")
    assert main(["bench", "humans", str(root), "--out", str(tmp_path / "out"), "--points", "40", "--json"]) == 0
    (summary,) = json.loads(capsys.readouterr().out)["summaries"]
    assert (summary["suite"], summary["pairs"], summary["mean"]) == ("remeshed/pairs_same", 2, 0.0)
