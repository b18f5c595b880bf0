"""``clalign collection`` and ``clalign bench collection`` on small shapes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import shapes
from collections_small import ARGUMENTS, CHANGES, write_shapes

from clalign.benchmark import collections
from clalign.benchmark.collections import Costs, Errors, RunTimes, errors_table, times_table
from clalign.cli.main import main
from clalign.collection.result import Collection
from clalign.collection.store import Store
from clalign.correspondence import Correspondence
from clalign.mesh.writing import save_mesh
from clalign.storage.files import size_text


def test_a_piece_can_be_chosen_of_every_shape(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two bodies of like size in each file: refused with both named, and one of them matched where that is said."""
    vertices, faces = shapes.bumpy_sphere(2)
    (tmp_path / "shapes").mkdir()
    for name in ("a", "b"):
        both = np.concatenate([vertices, 1.1 * vertices + [5.0, 0.0, 0.0]])
        save_mesh(tmp_path / "shapes" / f"{name}.ply", both, np.concatenate([faces, faces + len(vertices)]))
    command = ["collection", str(tmp_path / "shapes"), "--workers", "1", "--no-report", "--quiet", *ARGUMENTS, "--out"]
    assert main([*command, str(tmp_path / "refused")]) != 0
    assert "--component 1" in capsys.readouterr().err
    assert main([*command, str(tmp_path / "out"), "--component", "2"]) == 0
    found = Collection.load(tmp_path / "out").maps("a", "b").target_of_source
    np.testing.assert_array_equal(np.flatnonzero(found >= 0), np.arange(len(vertices)))


def test_collection_writes_pages_and_whole_results(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_shapes(tmp_path / "shapes", 2)
    out = tmp_path / "out"
    command = ["collection", str(tmp_path / "shapes"), "--out", str(out), "--workers", "1", "--keep", "full", "--json"]
    assert main([*command, "--quiet", *ARGUMENTS]) == 0
    shown = capsys.readouterr()
    document = json.loads(shown.out)
    assert document["pairs"] == {"direct": 1, "repaired": 0, "derived": 0, "without": 0}
    assert shown.err == ""
    pair = out / "pairs" / "s0" / "s1"
    page = (out / "index.html").read_text(encoding="utf-8")
    assert 'href="pairs/s0/s1/report.html"' in page
    assert (pair / "report.html").stat().st_size > 100_000
    result = Correspondence.load(pair / "result")
    with np.load(pair / "maps.npz") as maps:
        np.testing.assert_array_equal(maps["target_of_source"], result.target_of_source)


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        (["--no-cache"], "--cache FOLDER puts them elsewhere"),
        (["--keep", "half"], "keep is 'maps' or 'full'"),
        (["--pairs", "some"], "cannot read the pairs"),
        (["--workers", "0"], "workers at least 1"),
        (["--set", "nonsense=1"], "nonsense"),
    ],
)
def test_wrong_use_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], extra: list[str], message: str
) -> None:
    write_shapes(tmp_path / "shapes", 2)
    assert main(["collection", str(tmp_path / "shapes"), "--out", str(tmp_path / "out"), *extra]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert message in lines[0]
    assert not (tmp_path / "out").exists()


def test_bench_measures_before_and_after(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """All pairs of three shapes against a star of them, with truth beside the meshes; the tables go into a file."""
    folder = tmp_path / "shapes"
    for name, numbers in write_shapes(folder, 3).items():
        np.savetxt(folder / f"{name}.truth.txt", numbers, fmt="%d")
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- table:collection -->\nold\n<!-- /table:collection -->\nafter\n")
    changes = [part for name, value in CHANGES.items() for part in ("--set", f"{name}={value}")]
    command = [
        "bench",
        "collection",
        str(folder),
        "--out",
        str(tmp_path / "out"),
        "--runs",
        "two,star",
        "--points",
        "50",
    ]
    assert main([*command, "--preset", "fast", "--update", str(page), "--quiet", "--json", *changes]) == 0
    document = json.loads(capsys.readouterr().out)
    counts = [(entry["maps"], len(entry["means"])) for entry in document["errors"]]
    assert counts == [("two, as matched", 3), ("two, consistent", 3), ("star, as matched", 2), ("star, consistent", 3)]
    assert all(mean < 0.1 for entry in document["errors"] for mean in entry["means"])
    assert all(entry["wall"] > 0 for entry in document["times"])
    text = page.read_text()
    assert "| star, consistent | 3 | not known |" in text
    assert "traffic, prepared shapes" in text
    assert "old" not in text
    # What is complete is only read, and not under other options.
    assert main([*command, "--preset", "fast", "--quiet", *changes, "--set", "spectrum.basis=31"]) == 2
    assert "was matched with other values of spectrum.basis" in capsys.readouterr().err


def test_bench_compares_the_runs_of_all_pairs_with_the_first_of_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    compared, measured = [], []

    def run_one(name: str, *_: object) -> tuple[Collection, RunTimes]:
        return Collection(Store(tmp_path / name), (), ()), RunTimes(name, 1, 1.0, 1.0, 1.0, 0.0)

    def error_rows(name: str, _: Collection, points: int, seed: int) -> list[Errors]:
        measured.append((name, points, seed))
        return []

    def different_maps(first: Collection, second: Collection) -> list[str]:
        compared.append((first.folder.name, second.folder.name))
        return []

    monkeypatch.setattr(collections, "run_one", run_one)
    monkeypatch.setattr(collections, "error_rows", error_rows)
    monkeypatch.setattr(collections, "different_maps", different_maps)
    monkeypatch.setattr(collections, "costs", lambda _: Costs(1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0))
    command = ["bench", "collection", str(tmp_path), "--out", str(tmp_path / "out"), "--points", "7", "--seed", "3"]
    assert main([*command, "--runs", "star,one,two", "--json", "--quiet"]) == 0
    assert json.loads(capsys.readouterr().out)["different_maps"] == {"two": 0}
    assert compared == [("one", "two")]
    assert measured == [("star", 7, 3), ("one", 7, 3)]


@pytest.mark.parametrize(
    ("extra", "message"),
    [(["--runs", "one,ten"], "unknown run 'ten'"), (["--out", __file__], "cannot make this folder")],
)
def test_bench_refuses_what_it_cannot_do_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], extra: list[str], message: str
) -> None:
    assert main(["bench", "collection", str(tmp_path), "--out", str(tmp_path / "out"), *extra]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_tables() -> None:
    times = [RunTimes("one", 1, 100.0, 10.0, 80.0, 0.0), RunTimes("two", 2, None, 10.0, 80.0, 1.0)]
    lines = times_table(times, {"two": 0}).splitlines()
    assert lines[2] == "| one | 1 | 100 | 10 | 80 | 0 | 90% |  |"
    assert lines[3] == "| two | 2 | resumed | 10 | 80 | 1 |  | 0 |"
    assert errors_table([Errors("m", (0.01, 0.03), 1)]).splitlines()[-1] == "| m | 2 | 1 | 2.000 | 2.000 | 3.000 |"


def test_costs_of_many_pairs_are_those_of_one_times_their_number() -> None:
    one = Costs(2.0, 30e6, 9.0, 70e3, 1.5, 4e3, 1e9)
    table = one.table(pairs=499_500, workers=10)
    assert "| shapes | 1 | 1000 |" in table
    assert f"| {(1000 * 2 + 499_500 * 9) / 36000:.1f} h |" in table
    assert f"| disk, prepared shapes | {size_text(30e6)} | {size_text(30e9)} |" in table
    assert f"| traffic, tasks | {size_text(4e3)} | {size_text(4e3 * 499_500)} |" in table
    assert f"| traffic, prepared shapes | 1.50 a pair | {size_text(499_500 * 1.5 * 30e6)} |" in table
    assert f"| memory of the network | {size_text(28.8e3)} | {size_text(4e9)} |" in table
