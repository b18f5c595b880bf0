"""Every malformed mesh through the command that users give it to."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import malformed
import numpy as np
import pytest
import shapes
from quick import QUICK, Run

import clalign
from clalign.errors import ConfidenceWarning
from clalign.options import Options

CASES = malformed.case_names()
PROCESSES = ["Möbius strip", "truncated-binary.ply", "ünïcode – 形 😀.off"]


def test_the_names_are_all(collection: dict[str, malformed.MalformedFile]) -> None:
    assert list(collection) == CASES


@pytest.mark.parametrize("name", CASES)
def test_match_refuses_in_one_line_or_matches_with_a_note(
    name: str, collection: dict[str, malformed.MalformedFile], match: Run, pair: tuple[Path, Path], tmp_path: Path
) -> None:
    case = collection[name]
    for files in ((case.path, pair[1]), (pair[0], case.path)):
        shown = match(tmp_path / "out", "--no-cache", "--force", files=files)
        assert shown.out == ""
        if case.refused:
            assert shown.status == 2
            assert re.fullmatch(r"error: [^\n]{20,700}\n", shown.err)
            assert str(case.path) in shown.err
            assert re.search(case.words, shown.err)
            assert list(tmp_path.iterdir()) == []
        else:
            assert shown.status == 0, shown.err
            assert "Traceback" not in shown.err
            maps = np.loadtxt(tmp_path / "out" / "target_of_source.txt", dtype=np.int64)
            assert (maps >= 0).any()


@pytest.mark.parametrize("name", PROCESSES)
def test_the_process_ends_in_the_same_way(
    name: str, collection: dict[str, malformed.MalformedFile], pair: tuple[Path, Path], tmp_path: Path
) -> None:
    case = collection[name]
    command = [sys.executable, "-m", "clalign.cli.main", "match", str(case.path), str(pair[1]), *QUICK]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path, timeout=120)
    assert done.returncode == 2
    assert done.stdout == ""
    assert re.fullmatch(r"error: [^\n]+\n", done.stderr)
    assert list(tmp_path.iterdir()) == []


def test_no_permission_and_no_regular_file(
    match: Run, pair: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if hasattr(os, "mkfifo"):
        pipe = tmp_path / "pipe.off"
        os.mkfifo(pipe)
        shown = match(tmp_path / "out", files=(pipe, pair[1]))
        assert (shown.status, "is not a regular file" in shown.err) == (2, True)

    def refuse(self: Path) -> bytes:
        raise PermissionError(13, "Permission denied")

    # Nothing is forbidden to root, so that access rights cannot be tested with a file everywhere.
    monkeypatch.setattr(Path, "read_bytes", refuse)
    shown = match(tmp_path / "out")
    assert (shown.status, "no permission to read it" in shown.err) == (2, True)


def test_a_million_duplicated_vertices_are_joined_unless_read_strictly(run: Run, tmp_path: Path) -> None:
    """Three corners of its own for every triangle, as careless exporters write them."""
    vertices, faces = shapes.icosphere(7)
    soup = vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)
    assert len(soup[0]) > 980_000
    path = tmp_path / "soup.ply"
    path.write_bytes(malformed.WRITERS["binary ply"](soup))
    shown = run("check", path)
    assert shown.status == 0
    assert f"used     {len(vertices):,} vertices, {len(faces):,} triangles" in shown.out
    assert "819,198 vertices lie on open edges at the place of another one".replace(",", "") in shown.out
    shown = run("check", path, "--strict", "--repair", tmp_path / "joined.ply", "--merge")
    assert shown.status == 0
    assert shown.out.startswith(f"{path}: not usable\n")
    assert "327680 separate pieces" in shown.out
    assert "add `--merge` to join vertices" in shown.out
    joined = np.loadtxt(tmp_path / "joined.ply.index.txt", dtype=np.int64)
    assert len(joined) == len(vertices)
    np.testing.assert_array_equal(soup[0][joined], vertices[faces.ravel()[joined]])


def test_wildly_different_shapes_get_a_warning_with_the_confidence() -> None:
    """A torus has no map to a sphere that deserves trust."""
    body = shapes.bumpy_sphere(2)
    options = Options().replace({"engine.backend": "reference", "alignment.outer_iterations": 0})
    with (
        pytest.warns(ConfidenceWarning, match="turned inside out"),
        pytest.warns(ConfidenceWarning, match=r"low confidence .* ask for --alternatives 3"),
    ):
        result = clalign.match(body, malformed.ring(), options)
    with (
        pytest.warns(ConfidenceWarning, match="turned inside out"),
        pytest.warns(ConfidenceWarning, match=r"low confidence .* see the alternatives on the page"),
    ):
        more = clalign.match(body, malformed.ring(), options.replace({"search.alternatives": 500}))
    assert f"only {len(more.alternatives)} different map" in more.warnings[0]
    # Where the stretch of the surface chooses against the score, nothing is certain.
    assert more.confidence < 0.05 or more.score <= more.alternatives[0].score
    assert 0 <= result.confidence < 0.2
    (facing,) = (text for text in result.warnings if text.startswith("orientation"))
    assert f"{result.orientation:+.2f}" in facing
    (doubt,) = (text for text in result.warnings if text.startswith("low confidence"))
    assert f"{result.confidence:.2f}" in doubt
    assert result.target_of_source.min() >= 0
    assert np.isfinite(result.distortion).all()


def test_the_table_of_messages_names_every_case() -> None:
    table = subprocess.run(
        [sys.executable, malformed.__file__], capture_output=True, text=True, check=True, timeout=120
    ).stdout
    rows = table.splitlines()
    for name in CASES:
        assert any(row.startswith(name) for row in rows), name
