from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from clalign.benchmark.records import Record, failed_record
from clalign.benchmark.table import (
    SHORT_COLUMNS,
    as_plain,
    failures,
    markdown,
    mean_curve,
    replace_section,
    summarise,
    update_file,
)
from clalign.errors import ResultError
from clalign.evaluation.errors import THRESHOLDS


def row(pair: str, mean: float, *, method: str = "ours", flipped: bool | None = False) -> Record:
    return Record("suite", pair, method, "s", "ok", mean=mean, flipped=flipped, exact=0.5, seconds=2.0)


ROWS = [
    row("a b", 0.004),
    row("a c", 0.006),
    row("a d", 0.5, flipped=True),
    failed_record(("suite", "a e", "ours", "s"), "no  such\nmesh"),
    row("a b", 0.01, method="pyFM", flipped=None),
]


def test_summaries_count_pairs_failures_and_flips() -> None:
    ours, peer = summarise(ROWS)
    assert (ours.pairs, ours.failed, ours.flips, ours.worst_pair) == (4, 1, 1, "a d")
    assert ours.mean == pytest.approx(0.17)
    assert ours.median == pytest.approx(0.006)
    assert ours.worst == 0.5
    assert ours.confidence is None
    assert (peer.method, peer.flips, peer.failed) == ("pyFM", None, 0)


def test_markdown_prints_errors_times_hundred() -> None:
    lines = markdown(summarise(ROWS)).splitlines()
    assert len({line.count("|") for line in lines}) == 1
    assert "| suite | ours | 4 (1 failed) | 17.000 | 0.600 | 50.00 (a d) | 1 | 50.0 % |" in lines[2]
    assert "| pyFM | 1 | 1.000 | 1.000 | 1.00 (a b) | – |" in lines[3]


def test_a_short_table_has_the_cells_of_the_long_one() -> None:
    lines = markdown(summarise(ROWS), SHORT_COLUMNS).splitlines()
    assert lines[1] == "|---|---|--:|--:|--:|--:|--:|--:|"
    assert lines[2] == "| suite | ours | 4 (1 failed) | 17.000 | 50.00 (a d) | 1 | 50.0 % | 2.0 |"


def test_a_suite_that_failed_wholly_has_a_row() -> None:
    (summary,) = summarise([ROWS[3]])
    assert summary.mean is None
    assert "| 1 (1 failed) | – | – | – |" in markdown([summary])


def test_json_and_failures() -> None:
    document = json.loads(json.dumps(as_plain(summarise(ROWS), ["no mesh x"])))
    assert document["problems"] == ["no mesh x"]
    assert document["summaries"][0]["flips"] == 1
    assert failures(ROWS) == ["suite: a e by ours failed: no such mesh"]


def test_a_failed_pair_pulls_the_curve_down() -> None:
    ones = np.ones(THRESHOLDS.size)
    curves = {record.key: ones for record in ROWS if not record.failed}
    np.testing.assert_allclose(mean_curve(ROWS[:4], curves), 0.75)
    np.testing.assert_allclose(mean_curve([ROWS[3]], {}), 0.0)
    with pytest.raises(ResultError, match="no curve of a b"):
        mean_curve(ROWS[:1], {})


def test_only_the_marked_section_changes(tmp_path: Path) -> None:
    text = "before\n<!-- table:one -->\nold\n<!-- /table:one -->\nmiddle\n<!-- table:two -->\n<!-- /table:two -->\n"
    changed = replace_section(text, "one", "| new |")
    assert changed == text.replace("old", "| new |")
    assert replace_section(changed, "one", "| new |") == changed
    readme = tmp_path / "README.md"
    readme.write_text(text, encoding="utf-8")
    update_file(readme, "two", "x")
    assert readme.read_text(encoding="utf-8") == text.replace("table:two -->\n<", "table:two -->\nx\n<")


def test_pages_take_the_table_the_short_one_or_both(tmp_path: Path) -> None:
    page, long, short = tmp_path / "page.md", "<!-- table:a -->\n<!-- /table:a -->\n", "<!-- table:a-short -->\n"
    for text, shown in ((long, "xx"), (f"{short}<!-- /table:a-short -->\n", "y"), (f"{long}{short}", None)):
        page.write_text(text, encoding="utf-8")
        if shown is None:
            with pytest.raises(ResultError, match="/table:a-short"):
                update_file(page, "a", "xx", "y")
            continue
        update_file(page, "a", "xx", "y")
        assert page.read_text(encoding="utf-8") == text.replace("-->\n<!-- /", f"-->\n{shown}\n<!-- /")


@pytest.mark.parametrize(
    "text",
    ["", "<!-- table:a -->", "<!-- /table:a --><!-- table:a -->", "<!-- table:a --><!-- table:a --><!-- /table:a -->"],
)
def test_missing_markers(text: str, tmp_path: Path) -> None:
    with pytest.raises(ResultError, match="table:a"):
        replace_section(text, "a", "x")
    readme = tmp_path / "README.md"
    with pytest.raises(ResultError, match=r"README\.md"):
        update_file(readme, "a", "x")
