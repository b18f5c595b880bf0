"""Numbering through every format, and one clear MeshError for every file that is broken as a file."""

from __future__ import annotations

import os
from pathlib import Path

import malformed
import numpy as np
import pytest
import shapes
import trimesh
from skips import posix

from clalign.errors import MeshError
from clalign.mesh.mesh import load_mesh
from clalign.mesh.reading import read_mesh_file
from clalign.mesh.writing import save_mesh


def doubled_and_unused() -> malformed.Arrays:
    """A mesh that tools like to renumber: two doubled vertices, an unused one first and one last."""
    vertices, faces = shapes.bumpy_sphere(1)
    faces = faces + 1
    vertices = np.concatenate([[[4.0, 4, 4]], vertices, vertices[[5, 9]], [[3.0, 3, 3]]])
    count = len(vertices)
    faces[(faces == 6) & (np.arange(len(faces)) % 2 == 0)[:, None]] = count - 3
    faces[(faces == 10) & (np.arange(len(faces)) % 3 == 0)[:, None]] = count - 2
    return vertices, faces


@pytest.mark.parametrize("suffix", [".off", ".ply", ".obj"])
@pytest.mark.parametrize("coloured", [False, True])
def test_what_is_written_reads_back_exactly(tmp_path: Path, suffix: str, coloured: bool) -> None:
    vertices, faces = doubled_and_unused()
    colours = np.random.default_rng(3).random((len(vertices), 3)) if coloured else None
    path = tmp_path / f"größe 形{suffix.upper()}"
    save_mesh(path, vertices, faces, colours)
    raw = read_mesh_file(path)
    np.testing.assert_array_equal(raw.vertices, vertices)
    np.testing.assert_array_equal(raw.faces, faces)
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", [".off", ".ply"])
def test_other_programs_read_what_is_written(tmp_path: Path, suffix: str) -> None:
    vertices, faces = doubled_and_unused()
    colours = np.random.default_rng(3).integers(0, 256, (len(vertices), 3)).astype(np.uint8)
    save_mesh(tmp_path / f"mesh{suffix}", vertices, faces, colours)
    other = trimesh.load_mesh(tmp_path / f"mesh{suffix}", process=False)
    np.testing.assert_allclose(other.vertices, vertices)
    np.testing.assert_array_equal(other.faces, faces)
    if suffix == ".ply":
        np.testing.assert_array_equal(other.visual.vertex_colors[:, :3], colours)


@pytest.mark.parametrize("name", ["off", "obj", "ply", "binary ply"])
def test_numbering_of_files_written_elsewhere(tmp_path: Path, name: str) -> None:
    vertices, faces = doubled_and_unused()
    path = tmp_path / f"mesh.{name.split()[-1]}"
    path.write_bytes(malformed.WRITERS[name]((vertices, faces)))
    raw = read_mesh_file(path)
    np.testing.assert_array_equal(raw.vertices, vertices)
    np.testing.assert_array_equal(raw.faces, faces)


def test_textured_obj_keeps_its_numbering(tmp_path: Path) -> None:
    vertices, faces = doubled_and_unused()
    lines = ["mtllib missing.mtl", "o thing", *(f"v {x!r} {y!r} {z!r} 0.5 0.5 0.5" for x, y, z in vertices.tolist())]
    lines += [f"vt {t / 1000:.3f} 0.5" for t in range(3 * len(faces))] + ["vn 0 0 1", "usemtl skin", "s 1"]
    for number, face in enumerate(faces.tolist()):
        corners = [f"{v + 1}/{3 * number + c + 1}/1" for c, v in enumerate(face)]
        lines.append("f " + " ".join(corners) + "  # a comment")
    path = tmp_path / "textured.obj"
    path.write_text("\r\n".join(lines))
    raw = read_mesh_file(path)
    np.testing.assert_array_equal(raw.vertices, vertices)
    np.testing.assert_array_equal(raw.faces, faces)


def test_textured_ply_keeps_its_numbering(tmp_path: Path) -> None:
    vertices, faces = doubled_and_unused()
    header = ["ply", "format ascii 1.0", "comment TextureFile häut.png", f"element vertex {len(vertices)}"]
    header += [f"property float {name}" for name in "xyz"] + [f"element face {len(faces)}"]
    header += ["property list uchar int vertex_indices", "property list uchar float texcoord", "end_header"]
    rows = [f"{x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices.tolist()]
    rows += [f"3 {a} {b} {c} 6 0 0 {i % 7} 0 1 {i % 5}" for i, (a, b, c) in enumerate(faces.tolist())]
    path = tmp_path / "textured.ply"
    path.write_text("\n".join(header + rows) + "\n", encoding="latin-1")
    raw = read_mesh_file(path)
    np.testing.assert_allclose(raw.vertices, vertices, rtol=1e-6)
    np.testing.assert_array_equal(raw.faces, faces)


def test_stl_is_numbered_by_first_appearance(tmp_path: Path) -> None:
    vertices, faces = shapes.bumpy_sphere(2)
    path = tmp_path / "mesh.stl"
    path.write_bytes(malformed.WRITERS["stl"]((vertices, faces)))
    mesh = load_mesh(path)
    assert (mesh.n_vertices, mesh.n_faces) == (len(vertices), len(faces))
    assert "162 vertices, numbered by first appearance" in mesh.notes[0]
    flat = faces.ravel()
    order = flat[np.sort(np.unique(flat, return_index=True)[1])]
    np.testing.assert_allclose(mesh.file_vertices(), vertices[order], atol=1e-6)
    trimesh.Trimesh(vertices, faces, process=False).export(tmp_path / "text.stl", file_type="stl_ascii")
    text = (tmp_path / "text.stl").read_bytes()
    (tmp_path / "text.stl").write_bytes(text.replace(b"solid", "solid Gerät".encode("latin-1"), 1))
    np.testing.assert_allclose(load_mesh(tmp_path / "text.stl").file_vertices(), vertices[order], atol=1e-6)


def test_obj_counts_backward_and_splits_polygons(tmp_path: Path) -> None:
    path = tmp_path / "polygons.obj"
    path.write_text(
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n"
        "v 2 0 0\nv 2 1 0\nf -5 -2 -1 -4\nf 1// 2//3 -4/2\nl 1 2\nf \\\n3 4 5 6 1\n"
    )
    expected = [[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2], [0, 1, 2], [2, 3, 4], [2, 4, 5], [2, 5, 0]]
    assert read_mesh_file(path).faces.tolist() == expected
    path.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 0 1 2\nf 1 2 -4\n")
    with pytest.raises(MeshError, match=r"2 faces name vertices outside 0 to 2, such as -1 \(faces 0, 1\)"):
        load_mesh(path)


@pytest.mark.parametrize("header", ["OFF\n", "off\n", "OFF ", "COFF\n", "NOFF\n", "STOFF # text\n", "\ufeffOFF\n"])
def test_off_headers_comments_and_polygons(tmp_path: Path, header: str) -> None:
    path = tmp_path / "mesh.off"
    rows = "# counts\n5 2 0\n\n0 0 0 1 1\n1 0 0 1 1\n1 1 0 1 1\n0 1 0 1 1 # corner\n0 2 0 1 1\n"
    rows += "4 0 1 2 3 255 0 0\n3 2 4 3\n"
    path.write_text(header + (rows if header.endswith("\n") else rows[9:]), encoding="utf-8")
    raw = read_mesh_file(path)
    assert raw.faces.tolist() == [[0, 1, 2], [0, 2, 3], [2, 4, 3]]
    assert raw.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 2, 0]]


@pytest.mark.parametrize(
    ("line", "row", "message"),
    [
        (2, "0 0", "vertex 2 is given as '0 0': expected 3 numbers"),
        (1, "0 zero 1", "vertex 1 is given as '0 zero 1': expected 3 numbers"),
        (3, "0 0 1 9", "vertex 3 is given as '0 0 1 9', 4 numbers where vertex 0 has 3"),
        (4, "3 0 1", "face 0 is given as '3 0 1': expected a count of 3 or more and as many numbers"),
        (5, "2 0 1", "face 1 is given as '2 0 1': expected a count of 3"),
        (6, "3 0 1 x", "face 2 contains 'x' where a vertex number is expected"),
        (7, "0 1 2 3", "face 3 is given as '0 1 2 3': expected a count of 3"),
    ],
)
def test_damaged_rows_of_a_text_ply_are_named(tmp_path: Path, line: int, row: str, message: str) -> None:
    header = ["ply", "format ascii 1.0", "element vertex 4", *(f"property float {name}" for name in "xyz")]
    header += ["element face 4", "property list uchar int vertex_indices", "end_header"]
    rows = ["0 0 0", "1 0 0", "0 1 0", "0 0 1", "3 0 2 1", "3 0 1 3", "3 1 2 3", "3 2 0 3"]
    path = tmp_path / "mesh.ply"
    path.write_text("\n".join([*header, *rows]) + "\n")
    assert len(read_mesh_file(path).faces) == 4
    rows[line] = row
    path.write_text("\n".join([*header, *rows]) + "\n")
    with pytest.raises(MeshError) as caught:
        read_mesh_file(path)
    assert str(caught.value).startswith(f"{path}: {message}")


def test_ply_of_quads_and_mixed_polygons(tmp_path: Path) -> None:
    vertices, _ = malformed.grid(1, 2)
    header = ["ply", "format ascii 1.0", "element vertex 6", *(f"property float {name}" for name in "xyz")]
    header += ["element face 2", "property list uchar int vertex_index", "end_header"]
    rows = [f"{x} {y} {z}" for x, y, z in vertices.tolist()]
    for faces, expected in [
        (["4 0 1 4 3", "4 1 2 5 4"], {(0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4)}),
        (["4 0 1 4 3", "3 1 2 5"], {(0, 1, 4), (0, 4, 3), (1, 2, 5)}),
    ]:
        (tmp_path / "mesh.ply").write_text("\n".join(header + rows + faces) + "\n")
        found = read_mesh_file(tmp_path / "mesh.ply").faces
        rolled = {tuple(np.roll(face, -int(np.argmin(face))).tolist()) for face in found}
        assert rolled == {tuple(np.roll(face, -int(np.argmin(face))).tolist()) for face in expected}


def test_every_file_of_the_collection(tmp_path: Path) -> None:
    cases = malformed.write_collection(tmp_path)
    assert len(cases) > 60
    for case in cases:
        if not case.refused:
            load_mesh(case.path)
            continue
        with pytest.raises(MeshError, match=case.words or None) as error:
            load_mesh(case.path)
        message = str(error.value)
        assert message.startswith(f"{case.path}: "), case.name
        assert "\n" not in message, case.name
        assert "Traceback" not in message, case.name


@posix
@pytest.mark.skipif(os.name == "posix" and os.geteuid() == 0, reason="the superuser may read everything")
def test_a_file_without_permission(tmp_path: Path) -> None:
    path = shapes.write_off(tmp_path / "secret.off", *shapes.icosphere(1))
    path.chmod(0)
    with pytest.raises(MeshError, match=r"secret\.off: no permission"):
        load_mesh(path)


@pytest.mark.parametrize(("error", "words"), [(PermissionError, "no permission"), (OSError, "cannot be read")])
def test_refusals_of_the_operating_system(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: type[OSError], words: str
) -> None:
    path = shapes.write_off(tmp_path / "mesh.off", *shapes.icosphere(1))

    def refuse(self: Path) -> bytes:
        raise error("refused")

    monkeypatch.setattr(Path, "read_bytes", refuse)
    with pytest.raises(MeshError, match=f"mesh.off: {words}"):
        load_mesh(path)


def test_paths_that_are_no_files(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.off"
    if os.name == "posix":
        os.mkfifo(pipe)
    for name in (pipe, "nul\0byte.off", "x" * 5000 + ".off", ""):
        with pytest.raises(MeshError):
            load_mesh(name)


def test_saving_refuses_what_it_cannot_do(tmp_path: Path) -> None:
    vertices, faces = shapes.icosphere(1)
    with pytest.raises(MeshError, match=r"not written as '.stl'"):
        save_mesh(tmp_path / "mesh.stl", vertices, faces)
    with pytest.raises(MeshError, match=r"colours have shape \(3, 3\)"):
        save_mesh(tmp_path / "mesh.ply", vertices, faces, np.eye(3))
    with pytest.raises(MeshError, match="cannot be written"):
        save_mesh(tmp_path / "missing folder" / "mesh.ply", vertices, faces)
    assert list(tmp_path.iterdir()) == []
