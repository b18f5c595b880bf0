"""``clalign register`` and ``--map`` on stored results."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import shapes
from fabricated import fabricate, small

from clalign.cli.main import main
from clalign.correspondence import Correspondence
from clalign.errors import ResultError
from clalign.mesh.mesh import load_mesh
from clalign.mesh.reading import read_mesh_file
from clalign.mesh.writing import save_mesh
from clalign.transfer.texture import read_texture


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result between a textured OBJ and a PLY."""
    place = tmp_path_factory.mktemp("registered")
    vertices, faces = shapes.bumpy_sphere(2)
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += [f"vt {(x + 2) / 4!r} {(y + 2) / 4!r}" for x, y, _ in vertices.tolist()]
    lines += [f"f {a}/{a} {b}/{b} {c}/{c}" for a, b, c in (faces + 1).tolist()]
    (place / "template.obj").write_text("\n".join(lines) + "\n")
    save_mesh(place / "scan.ply", shapes.bent(vertices), faces)
    meshes = load_mesh(place / "template.obj"), load_mesh(place / "scan.ply")
    same = np.arange(len(vertices))
    fabricate(*meshes, same, same, alternatives=2).save(place / "result")
    return place


def test_a_template_keeps_its_texture(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "on-scan.obj"
    assert main(["register", str(folder / "result"), "--out", str(out), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["quality"]["flipped"] == 0.0
    given, written = read_texture(folder / "template.obj"), read_texture(out)
    np.testing.assert_array_equal(written.coordinates, given.coordinates)
    np.testing.assert_array_equal(written.corners, given.corners)
    scan = read_mesh_file(folder / "scan.ply").vertices
    edge = np.linalg.norm(scan[given.faces[:, 0]] - scan[given.faces[:, 1]], axis=1).mean()
    assert np.linalg.norm(read_mesh_file(out).vertices - scan, axis=1).mean() < 0.3 * edge


def test_values_become_columns(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bones.txt").write_text("\n".join(map(str, range(162))))
    out = tmp_path / "on-scan.ply"
    words = ["register", str(folder / "result"), "--out", str(out), "--values"]
    assert main([*words, f"bone={tmp_path / 'bones.txt'}"]) == 0
    said = capsys.readouterr()
    assert "0 turned over, 0 collapsed" in said.out
    assert "no texture coordinates or other properties: the source is a file of the kind '.obj'" in said.err
    assert b"property int bone" in out.read_bytes()
    assert main([*words, f"bone={tmp_path / 'bones.txt'}"]) == 2
    assert "--force" in capsys.readouterr().err
    (tmp_path / "few.txt").write_text("1\n2\n")
    assert main([*words, f"bone={tmp_path / 'few.txt'}", "--force"]) == 2
    assert "bone: has the shape (2,); one number for each of the 162 vertices" in capsys.readouterr().err
    assert main([*words, "bone", "--force"]) == 2
    assert "--values bone: expected NAME=FILE" in capsys.readouterr().err


def test_the_scan_is_not_replaced(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["register", str(folder / "result"), "--out", str(folder / "scan.ply"), "--force"]) == 2
    assert "is the target of this match" in capsys.readouterr().err


def test_alternatives_can_be_used(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = Correspondence.load(folder / "result")
    landmarks = tmp_path / "points.txt"
    landmarks.write_text("3\n5\n")
    words = ["transfer", str(folder / "result"), "landmarks", str(landmarks), "--out", str(tmp_path / "to.txt")]
    assert main([*words, "--map", "2"]) == 0
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "to.txt"), result.alternatives[1].target_of_source[[3, 5]])
    export = ["export", str(folder / "result"), "--out", str(tmp_path), "--map", "1", "--format"]
    assert main([*export, "map"]) == 0
    np.testing.assert_array_equal(
        np.loadtxt(tmp_path / "source_target.map") - 1, result.alternatives[0].target_of_source
    )
    capsys.readouterr()
    assert main([*export, "matlab"]) == 2
    assert f"match anew with --start {folder / 'result'} --start-map 1" in capsys.readouterr().err
    evaluation = ["evaluate", str(folder / "result"), "--truth", "identity", "--points", "20", "--json"]
    assert main(evaluation) == main([*evaluation, "--map", "1"]) == 0
    first, other = capsys.readouterr().out.split("\n}\n")[:2]
    assert json.loads(first + "}")["exact"] == 1.0
    assert json.loads(other + "}")["exact"] < 0.5
    assert main([*words, "--map", "3", "--force"]) == 2
    assert "there is no map 3: the result keeps alternatives 1 to 2" in capsys.readouterr().err


def test_an_alternative_is_not_taken_for_the_result(tmp_path: Path) -> None:
    other = small().with_map(1)
    assert other.shown_map == 1
    assert other.barycentric is None
    with pytest.raises(ResultError, match="save the result itself"):
        other.save(tmp_path / "other")
    assert small().with_map(0) is small()
