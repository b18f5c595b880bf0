from __future__ import annotations

import csv
import json
from pathlib import Path

import datasets
import pytest
from datasets import NearestMethod

from clalign.benchmark import study
from clalign.benchmark.study import STUDIES, is_base, methods_of, study_of, study_table
from clalign.cli.main import main
from clalign.errors import OptionError
from clalign.options import Options


@pytest.mark.parametrize("name", STUDIES)
@pytest.mark.parametrize(
    "changes", [{}, {"alignment.weight": 77.0, "spectrum.xi": 0.33, "alignment.outer_iterations": 4}]
)
def test_every_study_has_the_base_and_different_rows(name: str, changes: dict[str, float]) -> None:
    base = Options().replace(changes)
    _, rows = study_of(name, base)
    methods = methods_of(rows, base)
    assert any(is_base(changes, base) for changes in rows.values())
    assert len({method.settings for method in methods}) == len(methods)
    assert sum(method.options == base for method in methods) == 1
    assert len(methods) >= 4


def test_unknown_study() -> None:
    with pytest.raises(OptionError, match="there are weight, band, xi, sizes, samples, rounds"):
        study_of("speed", Options())


def test_any_option_can_be_varied() -> None:
    base = Options()
    title, rows = study_of("alignment.decay=0.1, 0.2,0.5", base)
    assert title == "alignment.decay"
    assert list(rows) == [f"alignment.decay = {value}" for value in (0.1, 0.2, 0.5)]
    assert [is_base(changes, base) for changes in rows.values()] == [False, True, False]
    assert [method.options.alignment.decay for method in methods_of(rows, base)] == [0.1, 0.2, 0.5]
    _, others = study_of("spectrum.metric=auto,euclidean", base)
    assert list(others.values()) == [{}, *({"spectrum.metric": m} for m in ("auto", "euclidean"))]
    rules = [row.options.rules for row in methods_of(study_of("rules.search.finalists=12,24", base)[1], base)]
    assert [each.search.finalists for each in rules] == [12, 24]
    tuples = methods_of(study_of("rules.refinement.settle=(200,), (150, 250)", base)[1], base)
    assert [method.options.rules.refinement.settle for method in tuples] == [(200,), (150, 250)]
    with pytest.raises(OptionError, match=r"unknown option 'alignment\.decays'"):
        study_of("alignment.decays=1,2", base)


def test_command_writes_one_table_a_study_and_marks_the_default(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        study, "AlignMethod", lambda name, options: NearestMethod(name, fails_on="ap2" if "50" in name else "")
    )
    data, out, page = tmp_path / "mid", tmp_path / "out", tmp_path / "page.md"
    datasets.write_poses(data, ["ap0", "ap1", "ap2"])
    (data / "pairs_same.txt").write_text("ap0 ap1\nap0 ap2\nap0 ap9\n", encoding="ascii")
    page.write_text("<!-- table:study-weight -->\n<!-- /table:study-weight -->\n", encoding="utf-8")
    command = ["bench", "study", str(data), "--of", "weight", "--out", str(out)]
    assert main([*command, "--update", str(page)]) == 1
    captured = capsys.readouterr()
    assert "no mesh ap9" in captured.err
    assert "ap0 ap2 by λ = 50 failed: ap2 is not to my taste" in captured.err
    table = (out / "study-weight.md").read_text(encoding="utf-8").strip()
    assert table in captured.out
    assert table in page.read_text(encoding="utf-8")
    assert table.count("(default)") == 1
    assert "| **λ = 200** (default) | 2 |" in table
    assert "| λ = 50 | 2 (1 failed) |" in table
    assert main([*command[:-2], "--of", "rounds", "--out", str(out), "--limit", "1", "--json", "--quiet"]) == 0
    summaries = json.loads(capsys.readouterr().out)["rounds"]
    assert {summary["pairs"] for summary in summaries} == {1}
    with (out / "pairs.csv").open(encoding="utf-8") as stream:
        rows = [row for row in csv.DictReader(stream) if row["method"] == study.BASE]
    assert [row["pair"] for row in rows] == ["ap0 ap1", "ap0 ap2"]


def test_command_takes_the_layout_of_faust_and_a_section(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study, "AlignMethod", lambda name, options: NearestMethod(name))
    root, page = tmp_path / "faust", tmp_path / "page.md"
    datasets.write_poses(root, [f"tr_reg_{number:03d}" for number in (0, 1, 10)])
    page.write_text("<!-- table:own-rounds -->\n<!-- /table:own-rounds -->\n", encoding="utf-8")
    command = ["bench", "study", "--of", "rounds", "--out", str(tmp_path / "out"), "--quiet"]
    assert main([*command, "--root", str(root), "--update", str(page), "--section", "own"]) == 0
    assert "| **rounds = 3** (default) | 1 |" in page.read_text(encoding="utf-8")
    for folders in ([], [str(root), "--root", str(root)]):
        capsys.readouterr()
        assert main([*command, *folders]) == 2
        assert "name either a folder in the layout of the humans, or with --root" in capsys.readouterr().err


def test_command_varies_an_option(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study, "AlignMethod", lambda name, options: NearestMethod(name))
    datasets.write_poses(tmp_path / "mid", ["ap0", "ap1"])
    command = ["bench", "study", str(tmp_path / "mid"), "--out", str(tmp_path / "out"), "--quiet"]
    assert main([*command, "--vary", "alignment.decay=0.1,0.2"]) == 0
    table = (tmp_path / "out" / "study-alignment.decay.md").read_text(encoding="utf-8").splitlines()
    labels = [row.split(" | ")[0] for row in table[2:]]
    assert labels == ["| alignment.decay = 0.1", "| **alignment.decay = 0.2** (default)"]
    assert main(command) == 2
    assert "--vary OPTION=VALUES" in capsys.readouterr().err


def test_table_repeats_the_base_for_each_of_its_rows() -> None:
    base = Options()
    _, rows = study_of("samples", base)
    assert sum(is_base(changes, base) for changes in rows.values()) == 2
    assert study_table("title", rows, [], base).count("\n") == 1
