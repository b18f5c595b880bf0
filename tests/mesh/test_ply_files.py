"""Binary PLY of every kind that programs write, built byte by byte as the format's description says."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import shapes
import trimesh

from clalign.errors import MeshError
from clalign.mesh.reading import read_mesh_file

VERTICES = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 2, 0], [2, 2, 1.5]])
POLYGONS = [[0, 1, 2, 3], [3, 2, 4], [0, 1, 2, 4, 3], [2, 5, 4], [1, 5, 2]]
TRIANGLES = [[0, 1, 2], [0, 2, 3], [3, 2, 4], [0, 1, 2], [0, 2, 4], [0, 4, 3], [2, 5, 4], [1, 5, 2]]
LETTERS = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"}


def header(order: str, properties: Sequence[str], lists: Sequence[str], faces: int = len(POLYGONS)) -> bytes:
    lines = ["ply", f"format binary_{order}_endian 1.0", f"element vertex {len(VERTICES)}"]
    lines += [f"property {words}" for words in properties]
    lines += [f"element face {faces}", *(f"property {words}" for words in lists), "end_header", ""]
    return "\n".join(lines).encode()


def vertex_bytes(order: str, letter: str = "f") -> bytes:
    return b"".join(struct.pack(f"{'<' if order == 'little' else '>'}3{letter}", *row) for row in VERTICES)


def write(path: Path, order: str = "little", count: str = "uchar", index: str = "int", extra: bytes = b"") -> Path:
    """The polygons with lists of the given types."""
    sign = "<" if order == "little" else ">"
    faces = [struct.pack(f"{sign}{LETTERS[count]}{len(p)}{LETTERS[index]}", len(p), *p) for p in POLYGONS]
    head = header(order, [f"float {axis}" for axis in "xyz"], [f"list {count} {index} vertex_indices"])
    path.write_bytes(head + vertex_bytes(order) + b"".join(faces) + extra)
    return path


@pytest.mark.parametrize("order", ["little", "big"])
@pytest.mark.parametrize("count", ["char", "uchar", "short", "ushort", "int", "uint"])
@pytest.mark.parametrize("index", ["uchar", "short", "ushort", "int", "uint", "float", "double"])
def test_polygons_of_mixed_sizes_with_every_type_of_list(tmp_path: Path, order: str, count: str, index: str) -> None:
    raw = read_mesh_file(write(tmp_path / "a.ply", order, count, index))
    np.testing.assert_array_equal(raw.vertices, VERTICES)
    assert raw.faces.tolist() == TRIANGLES
    assert raw.normals is None


@pytest.mark.parametrize("extra", [b"\n", b"\r\n", b"\0\0\0", b" \x1a"])
def test_bytes_behind_the_last_face_are_no_damage(tmp_path: Path, extra: bytes) -> None:
    assert read_mesh_file(write(tmp_path / "a.ply", extra=extra)).faces.tolist() == TRIANGLES
    with pytest.raises(MeshError, match="5 faces, but 3 bytes follow the last of them; its counts are wrong"):
        read_mesh_file(write(tmp_path / "b.ply", extra=b"abc"))


@pytest.mark.parametrize("order", ["little", "big"])
def test_lists_and_numbers_around_what_is_read(tmp_path: Path, order: str) -> None:
    """Normals, colours, a list in the vertices, and faces with texture coordinates and numbers on both sides."""
    sign = "<" if order == "little" else ">"
    axes = [*(f"double {axis}" for axis in ("nx", "ny", "nz")), "uchar red", "list uchar float descriptor"]
    properties = [*axes, *(f"double {axis}" for axis in "xyz")]
    lists = ["short label", "list uchar float texcoord", "list uchar int vertex_index", "uchar flag"]
    rng = np.random.default_rng(2)
    normals = rng.normal(size=VERTICES.shape)
    content = header(order, properties, lists)
    for number, (row, normal) in enumerate(zip(VERTICES, normals, strict=True)):
        values = [0.5] * (number % 3)
        content += struct.pack(f"{sign}3dBB{len(values)}f3d", *normal, 7, len(values), *values, *row)
    for polygon in POLYGONS:
        uv = [0.25] * (2 * len(polygon))
        content += struct.pack(f"{sign}hB{len(uv)}fB{len(polygon)}iB", 3, len(uv), *uv, len(polygon), *polygon, 1)
    (tmp_path / "a.ply").write_bytes(content)
    raw = read_mesh_file(tmp_path / "a.ply")
    np.testing.assert_array_equal(raw.vertices, VERTICES)
    np.testing.assert_array_equal(raw.normals, normals)
    assert raw.faces.tolist() == TRIANGLES


@pytest.mark.parametrize("ending", [b"\r\n", b"\r"])
def test_endings_of_header_lines(tmp_path: Path, ending: bytes) -> None:
    content = write(tmp_path / "a.ply").read_bytes()
    head, body = content.split(b"end_header\n")
    # The first byte of the body looks like the end of a line, and is part of a number.
    body = struct.pack("<f", np.frombuffer(b"\n\0\0\x3f", "<f4")[0]) + body[4:]
    (tmp_path / "b.ply").write_bytes(head.replace(b"\n", ending) + b"end_header" + ending + body)
    raw = read_mesh_file(tmp_path / "b.ply")
    assert raw.vertices[0, 0] == np.frombuffer(b"\n\0\0\x3f", "<f4")[0]
    assert raw.faces.tolist() == TRIANGLES


def test_every_cut_of_a_file_is_one_line(tmp_path: Path) -> None:
    content = write(tmp_path / "a.ply").read_bytes()
    for size in range(3, len(content)):
        (tmp_path / "cut.ply").write_bytes(content[:size])
        with pytest.raises(MeshError) as caught:
            read_mesh_file(tmp_path / "cut.ply")
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"\x03\x03\0\0\0", b"\x02\x03\0\0\0", "promises|corners"),
        (b"property float y\n", b"property float why\n", "its vertices have no numbers x, y and z"),
        (b"property float y\n", b"property half y\n", "has the line 'property half y', which says nothing known"),
        (b"list uchar", b"list float", "has the line 'property list float int vertex_indices'"),
        (b"binary_little_endian", b"binary_middle_endian", "names no format that is known"),
        (b"element vertex", b"element vortex", "does not count vertices"),
        (b"property list uchar int vertex_indices", b"property int number", "has no list of vertices"),
        (b"element face 5", b"element face many", "has the line 'element face many'"),
    ],
)
def test_headers_that_say_nothing_known(tmp_path: Path, old: bytes, new: bytes, message: str) -> None:
    content = write(tmp_path / "a.ply").read_bytes()
    assert old in content
    (tmp_path / "b.ply").write_bytes(content.replace(old, new, 1))
    with pytest.raises(MeshError, match=message):
        read_mesh_file(tmp_path / "b.ply")


def test_a_polygon_of_two_corners_is_named(tmp_path: Path) -> None:
    head = header("little", [f"float {axis}" for axis in "xyz"], ["list uchar int vertex_indices"], 2)
    faces = struct.pack("<B3iB2i", 3, 0, 1, 2, 2, 0, 1)
    (tmp_path / "a.ply").write_bytes(head + vertex_bytes("little") + faces)
    with pytest.raises(MeshError, match="face 1 has 2 corners where 3 or more are needed"):
        read_mesh_file(tmp_path / "a.ply")


@pytest.mark.parametrize("text", [True, False])
def test_triangle_strips(tmp_path: Path, text: bool) -> None:
    """Stanford's scans: one list of strips, which end in -1; every second triangle is turned."""
    strips = [0, 1, 3, 2, 4, -1, 2, 5, 4, -1]
    lines = ["ply", f"format {'ascii' if text else 'binary_big_endian'} 1.0", f"element vertex {len(VERTICES)}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += ["element tristrips 1", "property list int int vertex_indices", "end_header", ""]
    if text:
        rows = [" ".join(map(str, row)) for row in VERTICES.tolist()] + [" ".join(map(str, [len(strips), *strips]))]
        content = "\n".join(lines + rows).replace("\n\n", "\n").encode()
    else:
        content = (
            "\n".join(lines).encode() + vertex_bytes("big") + struct.pack(f">i{len(strips)}i", len(strips), *strips)
        )
    (tmp_path / "a.ply").write_bytes(content)
    assert read_mesh_file(tmp_path / "a.ply").faces.tolist() == [[0, 1, 3], [3, 1, 2], [3, 2, 4], [2, 5, 4]]


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_the_same_as_another_reader(tmp_path: Path, encoding: str) -> None:
    vertices, faces = shapes.bumpy_sphere(2)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    content = mesh.export(file_type="ply", encoding=encoding, vertex_normal=True)
    (tmp_path / "a.ply").write_bytes(content)
    raw = read_mesh_file(tmp_path / "a.ply")
    other = trimesh.load_mesh(tmp_path / "a.ply", process=False)
    np.testing.assert_allclose(raw.vertices, other.vertices, rtol=1e-7)
    np.testing.assert_array_equal(raw.faces, other.faces)
    np.testing.assert_allclose(raw.normals, mesh.vertex_normals, atol=1e-6)
