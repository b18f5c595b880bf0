"""Text that says more than a list of triangles: objects, normals, points, headers without a blank."""

from __future__ import annotations

from pathlib import Path

import malformed
import numpy as np
import pytest
import shapes
import trimesh

from clalign.errors import MeshError
from clalign.mesh.mesh import load_mesh
from clalign.mesh.reading import read_mesh_file

TETRA = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"


@pytest.mark.parametrize("start", ["OFF{} {} 0\n", "COFF{} {} 0\n", "off{} {}\n", "STOFF{} {} 0 # glued\n"])
def test_the_header_of_modelnet_has_no_blank(tmp_path: Path, start: str) -> None:
    vertices, faces = shapes.bumpy_sphere(1)
    body = malformed.WRITERS["off"]((vertices, faces)).split(b"\n", 2)[2]
    path = tmp_path / "glued.off"
    path.write_bytes(start.format(len(vertices), len(faces)).encode() + body)
    raw = read_mesh_file(path)
    np.testing.assert_array_equal(raw.vertices, vertices)
    np.testing.assert_array_equal(raw.faces, faces)
    other = trimesh.load_mesh(path, process=False) if start.startswith("OFF") else raw
    np.testing.assert_array_equal(raw.faces, other.faces)


@pytest.mark.parametrize("word", ["OFFSET 1 2 3\n", "OFF_1\n", "OFFICE\n"])
def test_words_that_begin_with_off_are_no_header(tmp_path: Path, word: str) -> None:
    (tmp_path / "a.off").write_text(word)
    with pytest.raises(MeshError, match="does not begin with OFF"):
        read_mesh_file(tmp_path / "a.off")


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig"])
def test_text_of_other_encodings(tmp_path: Path, encoding: str) -> None:
    vertices, faces = shapes.bumpy_sphere(1)
    for suffix in ("off", "obj"):
        text = malformed.WRITERS[suffix]((vertices, faces)).decode()
        (tmp_path / f"a.{suffix}").write_bytes(text.encode(encoding))
        np.testing.assert_array_equal(read_mesh_file(tmp_path / f"a.{suffix}").vertices, vertices)


def test_a_decimal_comma_is_called_that(tmp_path: Path) -> None:
    (tmp_path / "a.off").write_text("OFF\n3 1 0\n0,5 0,1 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    with pytest.raises(MeshError, match=r"vertex 0 is given as '0,5 0,1 0': .* with decimal points, not commas"):
        read_mesh_file(tmp_path / "a.off")


def test_objects_of_an_obj_are_one_mesh_and_named(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    lines = [TETRA, "o body", "f 1 2 3", "g left arm", "f 1 2 4", "o empty", "g body", "f 2 3 4", "g lid", "f 1 3 4 2"]
    path.write_text("\n".join(lines))
    raw = read_mesh_file(path)
    assert raw.faces.tolist() == [[0, 1, 2], [0, 1, 3], [1, 2, 3], [0, 2, 3], [0, 3, 1]]
    assert raw.notes == (
        "the file has 3 objects or groups, read as one mesh: 'body' (4 vertices), 'left arm' (3 vertices), "
        "'lid' (4 vertices)",
    )
    path.write_text(TETRA + "o one\nf 1 2 3\nf 1 3 4\no no faces\n")
    assert read_mesh_file(path).notes == ()
    path.write_text(TETRA + "f 1 2 3\n" + "".join(f"o part{i}\nf 1 2 4\n" for i in range(20)))
    assert read_mesh_file(path).notes[0].endswith("'part10' (3 vertices) and 9 more")


def test_normals_of_an_obj_belong_to_vertices_or_are_left(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    normals = "vn 0 0 1\nvn 0 1 0\nvn 1 0 0\nvn 0 0 -1\n"
    for faces, kept in [
        ("", True),
        ("f 1//1 2//2 3//3\nf 1//1 3//3 4//4\n", True),
        ("f 1/5/1 2/5/2 3/5/3\n", True),
        ("f 1//1 2//2 3//4\n", False),
        ("f 1 2 3\n", False),
    ]:
        path.write_text(TETRA + "vt 0 0\n" * 5 + normals + faces)
        found = read_mesh_file(path).normals
        assert (found is not None) == kept
        if found is not None:
            assert found.tolist() == [[0, 0, 1], [0, 1, 0], [1, 0, 0], [0, 0, -1]]
    path.write_text(TETRA + "vn 0 0 1\n")
    assert read_mesh_file(path).normals is None


@pytest.mark.parametrize("suffix", ["xyz", "txt", "pts"])
@pytest.mark.parametrize("separator", [" ", "\t", ",", ", "])
@pytest.mark.parametrize("counted", [True, False])
def test_points_with_and_without_normals(tmp_path: Path, suffix: str, separator: str, counted: bool) -> None:
    points, _ = shapes.icosphere(1)
    path = tmp_path / f"a.{suffix}"
    for table in (points, np.concatenate([points, points], axis=1)):
        top = f"{len(points)}\n" if counted else "# points\n"
        path.write_text(top + "\n".join(separator.join(map(repr, row)) for row in table.tolist()))
        raw = read_mesh_file(path)
        np.testing.assert_array_equal(raw.vertices, points)
        assert raw.faces.shape == (0, 3)
        assert raw.notes == ()
        assert (raw.normals is not None) == (table.shape[1] == 6)
        if raw.normals is not None:
            np.testing.assert_array_equal(raw.normals, points)


def test_colours_of_points_are_not_taken_for_normals(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text("0 0 0 255 0 0\n1 0 0 0 255 0\n")
    raw = read_mesh_file(tmp_path / "a.xyz")
    assert raw.normals is None
    assert raw.notes == ("columns 4 to 6 are no vectors of length 1, so they were not taken for normals",)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2\n3 4\n", "its first row is '1 2': points are given as three numbers a line, or six"),
        ("0 0 0\n0 0 x\n", "vertex 1 is given as '0 0 x': expected three numbers"),
        ("0 0 0\n0 0 1 2\n", "4 numbers where vertex 0 has 3"),
        ("7\n0 0 0\n", "its first line promises '7' points, but 1 lines follow"),
        ("0,5 1,5 2,5\n", "with decimal points, not commas"),
        ("# nothing\n", "its first row is ''"),
    ],
)
def test_text_that_is_no_list_of_points(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "a.xyz").write_text(text)
    with pytest.raises(MeshError, match=message):
        read_mesh_file(tmp_path / "a.xyz")


@pytest.mark.parametrize("suffix", ["ply", "obj", "xyz"])
def test_files_without_faces_are_read_and_judged_by_the_checks(tmp_path: Path, suffix: str) -> None:
    points, _ = shapes.icosphere(1)
    path = tmp_path / f"a.{suffix}"
    path.write_text(str(trimesh.PointCloud(points).export(file_type="xyz")))
    if suffix == "obj":
        path.write_text("".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in points.tolist()))
    if suffix == "ply":
        path.write_bytes(trimesh.PointCloud(points).export(file_type="ply"))
    raw = read_mesh_file(path)
    np.testing.assert_allclose(raw.vertices, points, atol=1e-6)
    assert raw.faces.shape == (0, 3)
    mesh = load_mesh(path)
    assert (mesh.n_vertices, mesh.n_faces) == (42, 80)
    with pytest.raises(MeshError, match="has 42 vertices but no faces"):
        load_mesh(path, strict=True)
