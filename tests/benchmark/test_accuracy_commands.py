from __future__ import annotations

import csv
import json
from pathlib import Path

import datasets
import numpy as np
import pytest
import shapes
from datasets import NearestMethod

from clalign.cli.bench import accuracy
from clalign.cli.main import main


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """Two bent eggs, each in its own order, truth files of both kinds, the true map and the mirrored map."""
    (vertices, faces), mirror = datasets.symmetric()
    places = []
    for number, name in enumerate(("x", "y")):
        own, own_faces, place = shapes.renumbered(shapes.bent(vertices, 0.2 * number), faces, number)
        shapes.write_off(tmp_path / f"{name}.off", own, own_faces)
        datasets.write_numbers(tmp_path / f"{name}.vts", place + 1)
        places.append(place)
    order = np.argsort(places[0])
    datasets.write_numbers(tmp_path / "mirror.txt", mirror)
    datasets.write_numbers(tmp_path / "true.txt", places[1][order])
    datasets.write_numbers(tmp_path / "true-from-one.txt", places[1][order] + 1)
    datasets.write_numbers(tmp_path / "flipped.txt", places[1][mirror][order])
    return tmp_path


def call(files: Path, map_name: str, *more: str) -> int:
    meshes = ["--source", str(files / "x.off"), "--target", str(files / "y.off")]
    points = ["--truth", str(files / "x.vts"), str(files / "y.vts"), "--mirror", str(files / "mirror.txt")]
    return main(["evaluate", str(files / map_name), *meshes, *points, *more])


def test_evaluate_a_true_map(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(files, "true.txt", "--json") == 0
    values = json.loads(capsys.readouterr().out)
    assert values["per_sqrt_area"]["mean"] == 0.0
    assert values["flipped"] is False
    assert call(files, "true-from-one.txt", "--base", "1", "--json") == 0
    assert json.loads(capsys.readouterr().out) == values


def test_evaluate_a_flipped_map_for_people(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(files, "flipped.txt", "--csv", str(files / "e.csv"), "--picture", str(files / "curve.svg")) == 0
    shown = capsys.readouterr().out
    assert "mean 0.000 to the mirrored truth: FLIPPED" in shown
    assert "heat method" in shown
    with (files / "e.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 162
    assert all(float(row["mirrored_error"]) == 0.0 for row in rows)
    assert "</svg>" in (files / "curve.svg").read_text(encoding="utf-8")


def test_evaluate_with_an_index_file(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    meshes = ["--source", str(files / "x.off"), "--target", str(files / "y.off"), "--json"]
    truth = ["--truth", str(files / "true-from-one.txt"), "--truth-base", "1"]
    assert main(["evaluate", str(files / "true.txt"), *meshes, *truth]) == 0
    assert json.loads(capsys.readouterr().out)["exact"] == 1.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["gone", "--truth", "identity"], "neither a result folder nor a map file"),
        (["true.txt", "--truth", "identity"], "name its meshes with --source"),
        (["true-from-one.txt", "--source", "x.off", "--target", "y.off", "--truth", "identity"], "looks 1-based"),
        (["true.txt", "--source", "x.off", "--target", "y.off", "--truth", "x.vts"], "looks 1-based"),
        (["true.txt", "--source", "x.off", "--target", "y.off", "--truth", "a", "b", "c"], "one file or two"),
        (["true.txt", "--source", "x.off", "--target", "y.off", "--truth", "identity", "--points", "0"], "points"),
        (
            ["true.txt", "--source", "x.off", "--target", "y.off", "--truth", "identity", "--csv", "no/e.csv"],
            "no/e.csv",
        ),
    ],
)
def test_evaluate_says_what_is_wrong(
    files: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, arguments: list[str], message: str
) -> None:
    monkeypatch.chdir(files)
    assert main(["evaluate", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert "Traceback" not in error


@pytest.fixture
def nearest(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stand in for the matcher."""
    monkeypatch.setattr(
        accuracy, "named_methods", lambda names, changes: [NearestMethod(name, fails_on="tr_reg_002") for name in names]
    )


def test_bench_humans_fills_a_folder_and_a_readme(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], nearest: None
) -> None:
    data, out, readme = tmp_path / "humans", tmp_path / "out", tmp_path / "README.md"
    mirror = datasets.write_poses(data / "mid", ["ap0", "ap1", "ap2"])
    datasets.write_numbers(data / "mid" / "mirror.txt", mirror)
    (data / "mid" / "pairs_same.txt").write_text("ap0 ap1\nap0 ap2\nap0 ap7\n", encoding="ascii")
    readme.write_text("# Title\n<!-- table:humans -->\n<!-- /table:humans -->\n", encoding="utf-8")
    status = main(["bench", "humans", str(data), "--out", str(out), "--update", str(readme)])
    assert status == 0
    captured = capsys.readouterr()
    table = (out / "summary.md").read_text(encoding="utf-8").strip()
    assert table in captured.out
    assert table in readme.read_text(encoding="utf-8")
    assert "no mesh ap7" in captured.err
    assert "1/2 mid/pairs_same ap0 ap1 default: mean" in captured.err
    assert {path.name for path in out.iterdir()} == {
        "pairs.csv",
        "curves.csv",
        "summary.md",
        "summary.json",
        "curve.png",
        "curve_diameter.png",
    }
    (summary,) = json.loads((out / "summary.json").read_text(encoding="utf-8"))["summaries"]
    assert (summary["pairs"], summary["flips"], summary["failed"]) == (2, 0, 0)


def test_bench_robustness_takes_changes_of_meshes_and_of_options(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], nearest: None
) -> None:
    datasets.write_poses(tmp_path / "eggs", ["ap0", "ap1"])
    command = ["bench", "robustness", str(tmp_path / "eggs"), "--out", str(tmp_path / "out"), "--json"]
    assert main([*command, "--changes", "noise,normal-noise", "--set", "alignment.weight=5"]) == 0
    summaries = json.loads(capsys.readouterr().out)["summaries"]
    assert [summary["suite"] for summary in summaries] == ["eggs/noise", "eggs/normal-noise"]
    assert all((summary["pairs"], summary["failed"]) == (2, 0) for summary in summaries)


def test_bench_faust_goes_on_after_a_failure(tmp_path: Path, capsys: pytest.CaptureFixture[str], nearest: None) -> None:
    root, out = tmp_path / "faust", tmp_path / "out"
    datasets.write_poses(root, [f"tr_reg_{number:03d}" for number in (0, 1, 2)])
    command = ["bench", "faust", "--root", str(root), "--out", str(out), "--methods", "paper,default", "--json"]
    assert main(command) == 1
    captured = capsys.readouterr()
    assert json.loads(captured.out)["summaries"][1]["failed"] == 1
    assert "tr_reg_000 tr_reg_002 by default failed: tr_reg_002 is not to my taste" in captured.err
    assert main([*command, "--limit", "1"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [summary["pairs"] for summary in document["summaries"]] == [1, 1]
    assert any("97 of FAUST's 100" in problem for problem in document["problems"])


def test_bench_animals_when_interrupted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, nearest: None
) -> None:
    datasets.write_poses(tmp_path / "cow", ["cow1", "cow2"])

    def interrupt(record: object) -> str:
        raise KeyboardInterrupt

    monkeypatch.setattr(accuracy, "progress_line", interrupt)
    command = ["bench", "animals", str(tmp_path), "--out", str(tmp_path / "out")]
    assert main(command) == 130
    assert "the same command goes on from there" in capsys.readouterr().err
    monkeypatch.undo()
    monkeypatch.setattr(accuracy, "named_methods", lambda names, changes: [NearestMethod("default", fails_on="cow2")])
    assert main(command) == 0


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--methods", "best"], "unknown method 'best'"),
        (["--set", "seed"], "GROUP.NAME=VALUE"),
        (["--distances", "exact"], "--distances must be one of heat, bounded"),
        (["--jobs", "0"], "jobs must be at least 1"),
        (["--pairs", "none.txt"], "no pairs file"),
        (["--out", __file__], "cannot make this folder"),
        (["--update", "page.md", "--limit", "1"], "a part of the pairs into the section 'humans'"),
    ],
)
def test_bench_says_what_is_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str], message: str
) -> None:
    datasets.write_poses(tmp_path / "mid", ["ap0", "ap1"])
    assert main(["bench", "humans", str(tmp_path / "mid"), "--out", str(tmp_path / "out"), *more]) == 2
    assert message in capsys.readouterr().err
