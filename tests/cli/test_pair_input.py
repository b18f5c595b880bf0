"""``--start`` and ``--landmarks`` through the command line: what they lead to, and what is wrong with them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray
from quick import QUICK, device

from clalign.cli.main import main

Given = tuple[Path, Path, NDArray[np.int64]]


@pytest.fixture
def pair(tmp_path: Path) -> Given:
    vertices, faces = shapes.bumpy_sphere(2)
    other, other_faces, new_of_old = shapes.renumbered(vertices, faces, 5)
    source = shapes.write_off(tmp_path / "a.off", vertices, faces)
    return source, shapes.write_off(tmp_path / "b.off", other, other_faces), new_of_old


def match(pair: Given, *more: str | Path) -> int:
    source, target, _ = pair
    out = source.with_name("result")
    return main(["match", str(source), str(target), "--out", str(out), *QUICK, *device(), *map(str, more)])


def test_a_start_and_landmarks_lead_to_the_map(pair: Given, tmp_path: Path) -> None:
    truth = pair[2]
    start = truth.copy()
    start[::3] = -1
    np.savetxt(tmp_path / "map.txt", start, fmt="%d")
    known = [3, 60, 110]
    rows = "\n".join(f"point {row},{row},{truth[row]}" for row in known)
    (tmp_path / "pairs.csv").write_text(f"name,source,target\n{rows}\n")
    assert match(pair, "--start", tmp_path / "map.txt", "--landmarks", tmp_path / "pairs.csv") == 0
    found = np.loadtxt(tmp_path / "result" / "target_of_source.txt", dtype=int)
    np.testing.assert_array_equal(found[known], truth[known])
    facts = json.loads((tmp_path / "result" / "result.json").read_text())
    assert facts["confidence"] is None
    assert [(each["name"], each["source"], each["used"]) for each in facts["landmarks"]] == [
        (f"point {row}", row, True) for row in known
    ]
    again = match(pair, "--start", tmp_path / "result", "--force")
    assert again == 0


def test_descriptors_are_read_from_files(pair: Given, tmp_path: Path) -> None:
    """Coordinates carried by the truth, with the usual weight and a heavy one."""
    values = shapes.bumpy_sphere(2)[0]
    np.save(tmp_path / "a.npy", values)
    np.savetxt(tmp_path / "b.csv", values[np.argsort(pair[2])], delimiter=",")
    searched = ("--set", "search.method=tree", "--set", "readout.steps=2")
    for more in ((), ("--descriptor-weight", "5", "--force")):
        assert match(pair, "--descriptors", tmp_path / "a.npy", tmp_path / "b.csv", *searched, *more) == 0
        found = np.loadtxt(tmp_path / "result" / "target_of_source.txt", dtype=int)
        assert np.mean(found == pair[2]) > 0.9


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--landmark-tolerance", "0.1"], "--landmark-tolerance belongs to --landmarks FILE"),
        (["--landmarks", "none.csv"], "none.csv: landmarks cannot be read"),
        (["--landmarks", "pairs.csv", "--landmark-tolerance", "-1"], "must not be negative"),
        (["--start", "none.txt"], "none.txt: cannot be read"),
        (["--component", "0"], "expected one number from 1"),
        (["--descriptor-weight", "2"], "--descriptor-weight belongs to --descriptors FILE FILE"),
        (["--descriptors", "none.npy", "none.npy"], "none.npy: cannot be read"),
        (
            ["--descriptors", "pairs.csv", "pairs.csv", "--set", "search.method=tree"],
            "descriptors of the source: 1 rows, and a has 162 vertices",
        ),
        (["--descriptors", "pairs.csv", "pairs.csv"], "descriptors have no part in search.method=random"),
    ],
)
def test_what_is_wrong_is_one_line(
    pair: Given,
    more: list[str],
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pairs.csv").write_text(f"0,{pair[2][0]}\n")
    assert match(pair, *more) == 2
    shown = capsys.readouterr().err
    assert words in shown
    assert shown.count("\n") == 1
    assert not (tmp_path / "result").exists()
