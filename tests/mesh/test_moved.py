"""Files whose vertices are moved, and that keep everything else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from clalign.errors import MeshError
from clalign.mesh.moved import moved_file
from clalign.mesh.reading import read_mesh_file
from clalign.mesh.topology import vertex_normals

POINTS = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1]])
TRIANGLES = np.array([[0, 2, 1], [0, 3, 2], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
MOVED = POINTS @ np.diag([2.0, 3.0, 1.0]) + 0.25

HEAD = """ply
format {kind} 1.0
comment made by hand
element camera 1
property float focus
element vertex 5
property float x
property double y
property float z
property float nx
property float ny
property float nz
property uchar label
property float texture_u
element face 5
property list uchar int vertex_indices
property uchar part
end_header
"""
FACES = [[0, 3, 2, 1], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]
LABELS, TEXTURE = [7, 8, 9, 250, 11], [0.125, 0.25, 0.375, 0.5, 0.625]


def _binary(order: str) -> bytes:
    row = [(name, order + kind) for name, kind in zip(("x", "y", "z"), ("f4", "f8", "f4"), strict=True)]
    row += [(name, order + "f4") for name in ("nx", "ny", "nz")] + [("label", "u1"), ("texture_u", order + "f4")]
    table = np.zeros(5, dtype=row)
    for place, axis in enumerate("xyz"):
        table[axis] = POINTS[:, place]
    table["label"], table["texture_u"] = LABELS, TEXTURE
    faces = b"".join(
        bytes([len(face)]) + np.array(face, dtype=order + "i4").tobytes() + bytes([number])
        for number, face in enumerate(FACES)
    )
    return np.array([35.0], dtype=order + "f4").tobytes() + table.tobytes() + faces


def _text() -> bytes:
    rows = [
        f"{x} {y} {z} 0 0 0 {label} {u}" for (x, y, z), label, u in zip(POINTS.tolist(), LABELS, TEXTURE, strict=True)
    ]
    faces = [" ".join(map(str, [len(face), *face, number])) for number, face in enumerate(FACES)]
    return ("\n".join(["35.0", *rows, *faces]) + "\n").encode()


def _table(content: bytes, order: str) -> dict[str, list[float]]:
    """Columns of the vertices of a written file, by their names."""
    head, _, body = content.partition(b"end_header\n")
    names = [line.split() for line in head.decode().splitlines() if line.startswith("property")][1:]
    names = [words for words in names if words[1] != "list" and words[2] != "part"]
    if not order:
        rows = [line.split() for line in body.splitlines()][1:6]
        return {words[2]: [float(row[place]) for row in rows] for place, words in enumerate(names)}
    types = {"float": "f4", "double": "f8", "uchar": "u1", "int": "i4"}
    kinds = [(words[2], order + types[words[1]]) for words in names]
    table = np.frombuffer(body, dtype=kinds, count=5, offset=4)
    return {name: table[name].astype(float).tolist() for name, _ in kinds}


@pytest.mark.parametrize(("kind", "order"), [("binary_little_endian", "<"), ("binary_big_endian", ">"), ("ascii", "")])
def test_ply_keeps_what_it_has_and_takes_columns(tmp_path: Path, kind: str, order: str) -> None:
    path = tmp_path / "given.ply"
    body = _binary(order) if order else _text()
    path.write_bytes(HEAD.format(kind=kind).encode() + body)
    columns = {"weight": np.linspace(0, 1, 5), "bone": np.arange(5)}
    content = moved_file(path, MOVED, TRIANGLES, columns)
    table = _table(content, order)
    np.testing.assert_allclose(np.stack([table[axis] for axis in "xyz"], axis=1), MOVED, rtol=1e-6)
    normals = np.stack([table[f"n{axis}"] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(normals, vertex_normals(MOVED, TRIANGLES), atol=1e-6)
    assert table["label"] == LABELS
    assert table["texture_u"] == TEXTURE
    assert table["weight"] == columns["weight"].tolist()
    assert table["bone"] == [0, 1, 2, 3, 4]
    assert b"comment made by hand" in content
    # Faces are the bytes that they were, and another reader finds the polygons.
    assert content.endswith(body[-40:])
    (tmp_path / "moved.ply").write_bytes(content)
    again = read_mesh_file(tmp_path / "moved.ply")
    np.testing.assert_allclose(again.vertices, MOVED, rtol=1e-6)
    np.testing.assert_array_equal(again.faces, read_mesh_file(path).faces)


OBJ = """# a pyramid
mtllib paint.mtl
v 0 0 0 1 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0.5 0.5 1
vn 0 0 1
vt 0.5 0.25
vt 0.75 1
g base
usemtl red
f 1/1/1 4/2/1 3/1/1 \\
  2/2/1
g sides
s off
f -5//1 2//1 5//1
f 2 3 5
"""


def test_obj_keeps_texture_groups_and_polygons(tmp_path: Path) -> None:
    path = tmp_path / "given.obj"
    path.write_text(OBJ)
    lines = moved_file(path, MOVED, TRIANGLES).decode().splitlines()
    assert lines[2] == "v 0.25 0.25 0.25 1 0 0"
    assert [line for line in lines if line.startswith(("vt", "g", "usemtl", "mtllib", "s "))] == [
        "mtllib paint.mtl", "vt 0.5 0.25", "vt 0.75 1", "g base", "usemtl red", "g sides", "s off",
    ]  # fmt: skip
    assert [line for line in lines if line.startswith("f")] == ["f 1/1 4/2 3/1 2/2", "f -5 2 5", "f 2 3 5"]
    assert not any(line.startswith("vn") for line in lines)


def test_what_cannot_be_rewritten_says_so(tmp_path: Path) -> None:
    path = tmp_path / "given.ply"
    path.write_bytes(HEAD.format(kind="ascii").encode() + _text())
    with pytest.raises(MeshError, match=r"given\.ply: .*another column called 'label'"):
        moved_file(path, MOVED, TRIANGLES, {"label": np.arange(5)})
    (tmp_path / "given.obj").write_text(OBJ)
    with pytest.raises(MeshError, match=r"given\.obj: has 5 vertices where 4 were read"):
        moved_file(tmp_path / "given.obj", MOVED[:4], TRIANGLES)
