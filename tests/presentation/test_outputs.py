"""Nothing that a user has is replaced unasked, and the meshes of the match are never."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clalign.cli.main import main
from clalign.correspondence import Correspondence
from clalign.errors import ResultError
from clalign.mesh.writing import save_mesh
from clalign.presentation import exports
from clalign.transfer.outputs import check_outputs


@pytest.fixture
def matched(small: Correspondence, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Correspondence]:
    """A match of source.ply and target.obj in the working folder, saved in ``result``."""
    monkeypatch.chdir(tmp_path)
    meshes = {}
    for role, name in (("source", "source.ply"), ("target", "target.obj")):
        mesh = getattr(small, role)
        save_mesh(name, mesh.file_positions(), mesh.file_faces)
        meshes[role] = replace(mesh, path=name)
    result = replace(small, **meshes)
    result.save("result")
    before = {name: Path(name).read_bytes() for name in ("source.ply", "target.obj")}
    yield result
    assert {name: (tmp_path / name).read_bytes() for name in before} == before


def stderr(capsys: pytest.CaptureFixture[str]) -> str:
    return capsys.readouterr().err


@pytest.mark.parametrize("name", ["ply", "obj"])
def test_export_never_replaces_a_mesh_of_the_match(
    matched: Correspondence, name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    role = "source" if name == "ply" else "target"
    kept = set(os.listdir())
    for extra in ([], ["--force"]):
        assert main(["export", "result", "--format", "numpy", "--format", name, "--out", ".", *extra]) == 2
        assert f"{role}.{name}: is the {role} of this match, and the original is worth keeping" in stderr(capsys)
    # From another folder, too: the result knows where its meshes are.
    here = Path.cwd()
    monkeypatch.chdir("result")
    assert main(["export", str(here / "result"), "--format", name, "--out", "..", "--force"]) == 2
    assert "is worth keeping" in stderr(capsys)
    monkeypatch.chdir(here)
    with pytest.raises(ResultError, match="is worth keeping"):
        (exports.export_ply if name == "ply" else exports.export_obj)(matched, ".")
    assert set(os.listdir()) == kept


@pytest.mark.usefixtures("matched")
def test_export_goes_into_the_result_and_replaces_only_when_asked(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", "result", "--format", "ply", "--format", "vts"]) == 0
    written = capsys.readouterr().out.split()
    assert [Path(path) for path in written] == [
        Path("result", name) for name in ("source.ply", "target.ply", "source.vts", "target.vts")
    ]
    Path("result/source.vts").write_text("mine")
    assert main(["export", "result", "--format", "map", "--format", "vts"]) == 2
    said = stderr(capsys)
    assert "source.vts: already exists; give --force to replace it, or another name" in said
    assert Path("result/source.vts").read_text() == "mine"
    assert not Path("result/source_target.map").exists()
    assert main(["export", "result", "--format", "vts", "--force"]) == 0
    assert Path("result/source.vts").read_text() != "mine"
    assert Correspondence.load("result").source.n_vertices == 642


@pytest.mark.parametrize("name", sorted(exports.FILES))
def test_the_table_of_files_is_what_is_written(small: Correspondence, tmp_path: Path, name: str) -> None:
    small.save(tmp_path / "result")
    assert main(["export", str(tmp_path / "result"), "--format", name, "--out", str(tmp_path / "out")]) == 0
    assert sorted(os.listdir(tmp_path / "out")) == sorted(exports.FILES[name])


@pytest.mark.usefixtures("matched")
def test_transfer_asks_before_it_replaces(small: Correspondence, capsys: pytest.CaptureFixture[str]) -> None:
    np.savetxt("values.txt", np.arange(small.source.file_count))
    line = ["transfer", "result", "scalars", "values.txt", "--out"]
    assert main([*line, "out.txt"]) == 0
    before = Path("out.txt").read_bytes()
    np.savetxt("values.txt", np.ones(small.source.file_count))
    assert main([*line, "out.txt"]) == 2
    assert "out.txt: already exists; give --force to replace it, or another name" in stderr(capsys)
    assert Path("out.txt").read_bytes() == before
    assert main([*line, "out.txt", "--force"]) == 0
    assert Path("out.txt").read_bytes() != before
    assert main([*line, "source.ply", "--force"]) == 2
    assert "source.ply: is the source of this match" in stderr(capsys)
    os.link("target.obj", "linked.obj")
    os.symlink("target.obj", "pointing.obj")
    for name in ("linked.obj", "pointing.obj"):
        assert main([*line, name, "--force"]) == 2
        assert f"{name}: is the target of this match" in stderr(capsys)


def test_results_of_arrays_have_no_originals(small: Correspondence, tmp_path: Path) -> None:
    assert small.source.path is None
    check_outputs(small, [tmp_path / "source.ply"], force=False)
    with pytest.raises(ResultError, match="is a folder; name a file"):
        check_outputs(small, [tmp_path], force=True)
