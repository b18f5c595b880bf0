"""``clalign check``: verdicts, the repaired copy with its way back, and nothing written by mistake."""

from __future__ import annotations

import json
from pathlib import Path

import malformed
import numpy as np
import pytest
from quick import Run, left_in

from clalign.errors import MeshError
from clalign.mesh.mesh import load_mesh
from clalign.mesh.reading import read_mesh_file


def test_every_verdict_is_that_of_loading(collection: dict[str, malformed.MalformedFile], run: Run) -> None:
    shown = run("check", *(case.path for case in collection.values()), "--json")
    assert (shown.status, shown.err) == (2, "")
    document = json.loads(shown.out)
    assert not document["usable"]
    for case, found in zip(collection.values(), document["meshes"], strict=True):
        assert found["path"] == str(case.path)
        assert found["usable"] is not case.refused
        if case.refused:
            with pytest.raises(MeshError) as caught:
                load_mesh(case.path)
            reasons = [found["error"]] if "error" in found else [f["sentence"] for f in found["findings"]]
            assert any(reason in str(caught.value) for reason in reasons)
            continue
        mesh = load_mesh(case.path)
        assert found["used"] == {"vertices": mesh.n_vertices, "triangles": mesh.n_faces}
        assert found["scale"] == mesh.scale
        handled = [f["sentence"] for f in found["findings"] if f["severity"] == "handled"]
        assert (*found["notes"], *handled) == mesh.notes


def test_what_a_person_reads(collection: dict[str, malformed.MalformedFile], run: Run, pair: tuple[Path, Path]) -> None:
    shown = run("check", *pair)
    assert shown.status == 0
    for words in (
        "usable\n",
        "162 vertices, 320 triangles",
        "closed, genus 0",
        "area 13.51",
        "matching the two: about",
    ):
        assert words in shown.out
    path = collection["hole"].path
    shown = run("check", path)
    assert (shown.status, "one piece, 1 boundary, genus 0" in shown.out) == (0, True)
    shown = run("check", collection["fin"].path)
    assert (shown.status, "cut there; faces that go straight on stay joined" in shown.out) == (0, True)
    shown = run("check", collection["fin"].path, "--strict")
    assert shown.status == 2
    assert "not usable" in shown.out
    assert "refused  1 edge belongs to more than two faces" in shown.out
    assert "--repair OUT` writes a repaired copy" in shown.out


def test_genus_of_a_ring(tmp_path: Path, run: Run) -> None:
    path = tmp_path / "ring.obj"
    path.write_bytes(malformed.WRITERS["obj"](malformed.ring()))
    found = json.loads(run("check", path, "--json").out)["meshes"][0]
    assert (found["genus"], found["euler_characteristic"], found["boundaries"]) == (1, 0, 0)
    np.testing.assert_allclose(found["extent"], np.ptp(malformed.ring()[0], axis=0))


@pytest.mark.parametrize(
    ("case", "suffix"),
    [
        pytest.param(case, suffix, id=f"{case.name}{suffix}")
        for case in malformed.surfaces()
        for suffix in (".ply", ".off", ".obj")
        if suffix == ".ply" or case.name in ("Möbius strip", "two bodies", "unreferenced vertex")
    ],
)
def test_repaired_copies_load_and_lead_back(case: malformed.Malformed, suffix: str, run: Run, tmp_path: Path) -> None:
    path = tmp_path / "given.off"
    path.write_bytes(malformed.WRITERS["off"]((case.vertices, case.faces)))
    out = tmp_path / f"clean{suffix}"
    shown = run("check", path, "--repair", out)
    if not case.repairable:
        assert shown.status == 2
        assert shown.err.startswith(f"error: {path}: the mesh cannot be repaired")
        assert left_in(tmp_path) == ["given.off"]
        return
    assert (shown.status, shown.err) == (0, "")
    assert left_in(tmp_path) == sorted(["given.off", out.name, f"{out.name}.index.txt"])
    index = np.loadtxt(tmp_path / f"{out.name}.index.txt", dtype=np.int64)
    np.testing.assert_array_equal(read_mesh_file(out).vertices, case.vertices[index])
    assert load_mesh(out).file_count == len(index)
    assert run("check", out).status == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--repair", "clean.stl"], "meshes are not written as '.stl'; use one of .ply, .off, .obj"),
        (["--repair", "given.off"], "is the mesh itself"),
        (["--repair", "there.ply"], "already exists; give --force"),
        (["--repair", "folder.ply"], "is a folder"),
        (["--merge"], "--merge and --force belong to --repair"),
        (["given.off", "--repair", "clean.ply"], "give one MESH, not 2"),
        (["--preset", "slow"], "unknown preset"),
    ],
)
def test_mistakes_are_found_before_anything_is_written(
    arguments: list[str], message: str, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("given.off").write_bytes(malformed.WRITERS["off"](malformed.sphere()))
    Path("there.ply.index.txt").write_text("mine")
    Path("folder.ply").mkdir()
    before = left_in(tmp_path)
    shown = run("check", "given.off", *arguments)
    assert (shown.status, shown.out) == (2, "")
    assert message in shown.err
    assert left_in(tmp_path) == before
    assert Path("there.ply.index.txt").read_text() == "mine"


def test_force_replaces_both_files(run: Run, tmp_path: Path) -> None:
    path, out = tmp_path / "given.off", tmp_path / "clean.ply"
    path.write_bytes(malformed.WRITERS["off"](malformed.sphere()))
    out.write_text("old")
    out.with_name("clean.ply.index.txt").write_text("old")
    shown = run("check", path, "--repair", out, "--force", "--json")
    assert shown.status == 0
    assert json.loads(shown.out)["repaired"]["mesh"] == str(out)
    assert out.with_name("clean.ply.index.txt").read_text() == "".join(f"{i}\n" for i in range(162))


def test_a_copy_with_little_of_the_area_is_warned_of(run: Run, tmp_path: Path) -> None:
    """Nine spheres of radius 1 and one of radius 2 that is taken apart into faces: the large sphere is left."""
    vertices, faces = malformed.sphere()
    apart = 2 * vertices[faces].reshape(-1, 3)
    spheres = [vertices + np.array([5 * number, 0, 0]) for number in range(1, 10)]
    every_face = [faces + number * len(vertices) for number in range(9)]
    every_face.append(np.arange(faces.size).reshape(-1, 3) + 9 * len(vertices))
    path = tmp_path / "given.off"
    path.write_bytes(malformed.WRITERS["off"]((np.concatenate([*spheres, apart]), np.concatenate(every_face))))
    shown = run("check", path, "--repair", tmp_path / "clean.ply", "--json")
    assert shown.status == 0
    assert shown.err == f"warning: {tmp_path / 'clean.ply'}: only 31 % of the area is left; look at it before use\n"
    assert json.loads(shown.out)["repaired"]["area_share"] == pytest.approx(4 / 13)


def test_a_soup_of_triangles_is_used_unless_read_strictly(run: Run, tmp_path: Path) -> None:
    vertices, faces = malformed.sphere()
    path = tmp_path / "soup.off"
    soup = vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)
    path.write_bytes(malformed.WRITERS["off"](soup))
    shown = run("check", path)
    assert (shown.status, "162 vertices, 320 triangles" in shown.out) == (0, True)
    shown = run("check", path, "--strict")
    assert (shown.status, "320 separate pieces" in shown.out) == (2, True)
    assert "add `--merge` to join vertices at equal positions" in shown.out


def test_merging_closes_a_seam(collection: dict[str, malformed.MalformedFile], run: Run, tmp_path: Path) -> None:
    assert run("check", collection["seam"].path, "--repair", tmp_path / "closed.ply", "--merge").status == 0
    found = json.loads(run("check", tmp_path / "closed.ply", "--json").out)["meshes"][0]
    assert (found["boundaries"], found["genus"], found["used"]["vertices"]) == (0, 0, 162)
