"""``--component`` and ``--strict`` of ``clalign match``, ``check`` and ``collection``, as processes of their own."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import malformed
import numpy as np
import pytest
import shapes
from collections_small import ARGUMENTS
from quick import QUICK, Shown, device, left_in

from clalign.correspondence import Correspondence
from clalign.mesh.mesh import load_mesh


def clalign(*arguments: str | Path) -> Shown:
    done = subprocess.run(
        [sys.executable, "-m", "clalign.cli.main", *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert "Traceback" not in done.stderr
    return Shown(done.returncode, done.stdout, done.stderr)


def write(path: Path, vertices: np.ndarray, faces: np.ndarray) -> Path:
    path.write_bytes(malformed.WRITERS["off"]((vertices, faces)))
    return path


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Two bodies side by side, the smaller one first; a body alone; and one in single triangles."""
    folder = tmp_path_factory.mktemp("pieces")
    vertices, faces = shapes.bumpy_sphere(2)
    two = np.concatenate([0.9 * vertices + [4.0, 0.0, 0.0], vertices]), np.concatenate([faces, faces + 162])
    soup = shapes.bent(vertices, 0.3)[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)
    return {
        "two": write(folder / "two.off", *two),
        "one": write(folder / "one.off", vertices, faces),
        "soup": write(folder / "soup.off", *soup),
    }


def test_two_bodies_are_matched_once_it_is_said_which(files: dict[str, Path], tmp_path: Path) -> None:
    match = ("match", files["two"], files["one"], "--out", tmp_path / "out", *QUICK, *device())
    shown = clalign(*match)
    assert (shown.status, shown.out) == (2, "")
    assert f"error: {files['two']}: the mesh has 2 separate pieces, 2 of them of similar size: piece 1 with 162 " in (
        shown.err
    )
    assert "around (3.657, " in shown.err
    assert "say which is meant with `--component 1`" in shown.err
    assert left_in(tmp_path) == []
    for number, rows, said in (
        ("2", slice(0, 162), "piece 2 is matched, as asked for"),
        ("1", slice(162, 324), "the largest is matched"),
    ):
        assert clalign(*match, "--component", f"{number},-", "--force").status == 0
        result = Correspondence.load(tmp_path / "out")
        np.testing.assert_array_equal(result.source.file_index, np.arange(324)[rows])
        assert (result.target_of_source[rows] >= 0).all()
        assert (np.delete(result.target_of_source, np.arange(324)[rows]) == -1).all()
        assert any(f"{said}; 162 vertices are left out" in note for note in result.warnings)


@pytest.mark.parametrize(
    ("component", "message"),
    [
        ("3", "two.off: there is no piece 3: the mesh has 2 pieces. Way out: choose a piece from 1, the largest, to 2"),
        ("1,2", "one.off: there is no piece 2: the mesh has 1 piece. Way out"),
        ("0", "--component 0: expected one number from 1 for both meshes or two, such as 1,2 or -,2"),
        ("1,1,1", "--component 1,1,1: expected one number"),
        ("first", "--component first: expected one number"),
    ],
)
def test_pieces_that_are_not_there(component: str, message: str, files: dict[str, Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    shown = clalign("match", files["two"], files["one"], "--out", out, "--component", component, *QUICK, *device())
    assert (shown.status, shown.out) == (2, "")
    assert message in shown.err
    assert not out.exists()


def test_check_counts_repairs_and_refuses_pieces(files: dict[str, Path], tmp_path: Path) -> None:
    assert clalign("check", files["two"]).status == 2
    shown = clalign("check", files["two"], "--component", "2", "--repair", tmp_path / "second.ply", "--json")
    assert (shown.status, shown.err) == (0, "")
    found = json.loads(shown.out)["meshes"][0]
    assert found["used"] == {"vertices": 162, "triangles": 320}
    index = np.loadtxt(tmp_path / "second.ply.index.txt", dtype=np.int64)
    np.testing.assert_array_equal(index, np.arange(162))
    assert load_mesh(tmp_path / "second.ply").n_vertices == 162
    shown = clalign("check", files["two"], "--component", "7")
    assert (shown.status, "there is no piece 7" in shown.out) == (2, True)
    # Without a piece the copy has the largest.
    assert clalign("check", files["two"], "--repair", tmp_path / "first.ply").status == 0
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "first.ply.index.txt", dtype=np.int64), 162 + np.arange(162))


def test_strict_matching_refuses_what_is_read_otherwise(files: dict[str, Path], tmp_path: Path) -> None:
    match = ("match", files["soup"], files["one"], "--out", tmp_path / "out", *QUICK, *device())
    for strict in (["--strict"], ["--set", "surface.strict=true"]):
        shown = clalign(*match, *strict)
        assert (shown.status, "soup.off: the mesh has 320 separate pieces" in shown.err) == (2, True)
        assert "add `--merge` to join vertices at equal positions first" in shown.err
    assert left_in(tmp_path) == []
    assert clalign(*match).status == 0
    result = Correspondence.load(tmp_path / "out")
    assert (result.source.n_vertices, result.source.file_count) == (162, 960)
    assert len(result.target_of_source) == 960
    assert (result.target_of_source >= 0).all()


@pytest.mark.parametrize("strict", [False, True], ids=["", "strictly"])
def test_a_collection_reads_its_shapes_either_way(strict: bool, files: dict[str, Path], tmp_path: Path) -> None:
    (tmp_path / "list.txt").write_text(f"{files['one']}\n{files['soup']}\n", encoding="utf-8")
    out = tmp_path / "out"
    words = ["--strict"] if strict else []
    shown = clalign(
        "collection",
        tmp_path / "list.txt",
        "--out",
        out,
        "--workers",
        "1",
        "--quiet",
        "--no-report",
        *ARGUMENTS,
        *words,
    )
    if strict:
        assert shown.status == 1
        assert "soup.off: the mesh has 320 separate pieces" in shown.err
        assert not (out / "pairs" / "one" / "soup").exists()
        return
    assert (shown.status, shown.err) == (0, "")
    with np.load(out / "pairs" / "one" / "soup" / "maps.npz") as maps:
        assert len(maps["source_of_target"]) == 960
        assert maps["source_of_target"].min() >= 0
