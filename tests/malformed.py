"""A collection of malformed meshes: what is in each, and what the program must make of it.

`surfaces()` are pairs of arrays with one defect each; `write_collection(folder)` writes these as files, together with
files that are broken as files. ``python tests/malformed.py`` prints the message for each, as a table.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapes
from numpy.typing import NDArray

REFUSED_STRICTLY = ("no-faces", "no-area-vertex", "non-manifold-edge", "non-manifold-vertex")
"""Kinds that are read as the surface that was most likely meant, unless asked to read strictly."""

Arrays = tuple[NDArray[np.float64], NDArray[np.int64]]


@dataclass(frozen=True)
class Malformed:
    """A mesh with one defect."""

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    kind: str
    """The kind of the finding that must come up."""
    refused: bool
    """Whether loading must fail; else the mesh loads with a note or without."""
    refused_strictly: bool = False
    """Whether strict loading must fail."""
    numbers: tuple[int, ...] = ()
    """Vertex or face numbers that the finding must name."""
    repairable: bool = True
    """Whether `repair` must make a usable mesh of it."""


@dataclass(frozen=True)
class MalformedFile:
    """A file that cannot or should not be read as it is."""

    name: str
    path: Path
    refused: bool
    words: str
    """Regular expression that the error message, or one of the notes, must contain."""


def sphere(subdivisions: int = 2) -> Arrays:
    """Bumpy sphere of 162 vertices, on which the defects are put."""
    return shapes.bumpy_sphere(subdivisions)


def strip(count: int, half_turns: int) -> Arrays:
    """Closed ribbon of `count` quads cut in two, twisted: one half-turn makes it a Möbius strip."""
    angle = 2 * np.pi * np.arange(count) / count
    lean = half_turns * angle / 2
    across = np.stack([np.cos(lean) * np.cos(angle), np.cos(lean) * np.sin(angle), np.sin(lean)], axis=1)
    middle = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
    vertices = np.concatenate([middle + 0.3 * across, middle - 0.3 * across])
    here, there = np.arange(count), np.roll(np.arange(count), -1)
    top, bottom = there.copy(), there + count
    if half_turns % 2:
        top[-1], bottom[-1] = count, 0
    faces = np.concatenate([np.stack([here, here + count, top], 1), np.stack([here + count, bottom, top], 1)])
    return vertices, faces


def grid(rows: int, columns: int) -> Arrays:
    """Flat rectangle of unit squares cut in two."""
    y, x = np.meshgrid(np.arange(rows + 1.0), np.arange(columns + 1.0), indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    step = columns + 1
    faces = [[corner, corner + 1, corner + step + 1], [corner, corner + step + 1, corner + step]]
    return vertices, np.concatenate([np.stack(face, axis=1) for face in faces])


def klein_bottle(rows: int = 12, columns: int = 8) -> Arrays:
    """Closed one-sided surface, in the usual figure-eight immersion."""
    u, v = np.meshgrid(2 * np.pi * np.arange(rows) / rows, 2 * np.pi * np.arange(columns) / columns, indexing="ij")
    w = np.cos(u / 2) * np.sin(v) - np.sin(u / 2) * np.sin(2 * v)
    height = np.sin(u / 2) * np.sin(v) + np.cos(u / 2) * np.sin(2 * v)
    vertices = np.stack([(3 + w) * np.cos(u), (3 + w) * np.sin(u), height], axis=-1).reshape(-1, 3)

    def number(i: NDArray[np.int64], j: NDArray[np.int64]) -> NDArray[np.int64]:
        # One turn in u brings v back as -v.
        return (i % rows) * columns + np.where(i >= rows, -j, j) % columns

    i, j = (index.ravel() for index in np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"))
    a, b, c, d = number(i, j), number(i + 1, j), number(i + 1, j + 1), number(i, j + 1)
    return vertices, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def ring(columns: int = 24, rows: int = 10) -> Arrays:
    """Torus, thicker on one side and stretched, so that it has no symmetry but a mirror's."""
    u, v = np.meshgrid(2 * np.pi * np.arange(columns) / columns, 2 * np.pi * np.arange(rows) / rows, indexing="ij")
    thickness = 0.25 + 0.08 * np.sin(u)
    reach = 1 + thickness * np.cos(v)
    points = np.stack([reach * np.cos(u), 1.4 * reach * np.sin(u), thickness * np.sin(v)], axis=-1)
    i, j = (index.ravel() for index in np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"))
    a, b = i * rows + j, (i + 1) % columns * rows + j
    c, d = (i + 1) % columns * rows + (j + 1) % rows, i * rows + (j + 1) % rows
    return points.reshape(-1, 3), np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def _joined(*parts: Arrays) -> Arrays:
    start = np.cumsum([0] + [len(vertices) for vertices, _ in parts])
    faces = [faces + begin for (_, faces), begin in zip(parts, start, strict=False)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)


def _with_face(number: int, corners: list[int]) -> Arrays:
    vertices, faces = sphere()
    faces[number] = corners
    return vertices, faces


def _with_vertex(number: int, position: list[float]) -> Arrays:
    vertices, faces = sphere()
    vertices[number] = position
    return vertices, faces


def _plus_faces(extra: list[list[int]]) -> Arrays:
    vertices, faces = sphere()
    return vertices, np.concatenate([faces, extra])


def _with_fin() -> Arrays:
    """A triangle sticking out of an edge of the body."""
    vertices, faces = sphere()
    a, b, _ = faces[7]
    return np.concatenate([vertices, [2 * vertices[a] + vertices[b]]]), np.concatenate([faces, [[a, b, len(vertices)]]])


def _pinched() -> Arrays:
    """A body and one of half its size that share one vertex."""
    vertices, faces = sphere()
    other = faces.copy()
    shared = int(np.argmax(vertices[:, 0]))
    mirrored = vertices[shared] * 1.5 - vertices * 0.5
    place = np.arange(len(vertices)) + len(vertices)
    place[shared] = shared
    both = np.concatenate([vertices, mirrored])
    joined = np.concatenate([faces, place[other]])
    used = np.unique(joined)
    return both[used], np.searchsorted(used, joined)


def _three_sheets() -> Arrays:
    """Three half planes that meet in a line, like a T in section."""
    vertices, faces = grid(4, 4)
    left = (np.stack([-vertices[:, 0], vertices[:, 1], vertices[:, 2]], axis=1), faces)
    up = (np.stack([vertices[:, 2], vertices[:, 1], vertices[:, 0] * 1.5], axis=1), faces)
    points, triangles = _joined((vertices, faces), left, up)
    _, first, inverse = np.unique(points + 0.0, axis=0, return_index=True, return_inverse=True)
    return points[first], inverse.reshape(-1)[triangles]


def _flipped_some() -> Arrays:
    vertices, faces = sphere()
    faces[[3, 50, 51]] = faces[[3, 50, 51]][:, ::-1]
    return vertices, faces


def _with_flat_face() -> Arrays:
    """A vertex in the middle of an edge, with a triangle of zero area that closes the gap."""
    vertices, faces = sphere()
    a, b, c = faces[0]
    middle = len(vertices)
    halves = [[a, middle, c], [middle, b, c], [a, b, middle]]
    return np.concatenate([vertices, [(vertices[a] + vertices[b]) / 2]]), np.concatenate([faces[1:], halves])


def _collapsed_vertex() -> Arrays:
    """One vertex with all its neighbours at one point."""
    vertices, faces = sphere()
    ring = np.unique(faces[(faces == 12).any(axis=1)])
    vertices[ring] = vertices[12]
    return vertices, faces


def _cut_seam() -> Arrays:
    """A body cut open along a few edges: the corners of half a fan moved to a copy of their vertex."""
    vertices, faces = sphere(2)
    side = vertices[faces].mean(axis=1)[:, 2] > 0
    above, below = np.unique(faces[side]), np.unique(faces[~side])
    rim = np.intersect1d(above, below)
    cut = rim[vertices[rim, 0] > 0]
    place = np.arange(len(vertices))
    place[cut] = len(vertices) + np.arange(len(cut))
    faces[side] = place[faces[side]]
    return np.concatenate([vertices, vertices[cut]]), faces


def surfaces() -> list[Malformed]:
    """All array cases."""
    vertices, faces = sphere()
    n = len(vertices)
    shifted = (vertices + np.array([10.0, 0, 0]), faces)
    tiny = (0.02 * vertices + np.array([5.0, 0, 0]), faces)
    triangle = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    collinear = np.linspace(0, 1, 20)[:, None] * np.ones(3)
    fan = np.stack([np.arange(18), np.arange(1, 19), np.arange(2, 20)], axis=1)
    height = vertices[faces].mean(axis=1)[:, 2]
    open_top = faces[height < height.max() - 0.08]
    double = np.concatenate([vertices, vertices])
    unused_first = (np.concatenate([[[9.0, 9, 9]], vertices]), faces + 1)
    unused_nan = (np.concatenate([vertices, [[np.nan] * 3]]), faces)
    cases: list[tuple[str, Arrays, str, bool, tuple[int, ...], bool]] = [
        ("no vertices", (np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)), "no-vertices", True, (), False),
        ("point cloud", (vertices, np.zeros((0, 3), dtype=np.int64)), "no-faces", False, (), True),
        ("index beyond the end", _with_face(5, [0, 1, n]), "index-out-of-range", True, (5,), True),
        ("negative index", _with_face(9, [0, -1, 2]), "index-out-of-range", True, (9,), True),
        ("enormous index", _with_face(9, [0, 2**62, 2]), "index-out-of-range", True, (9,), True),
        ("NaN", _with_vertex(17, [0, np.nan, 0]), "non-finite", True, (17,), True),
        ("infinity", _with_vertex(18, [np.inf, 0, 0]), "non-finite", True, (18,), True),
        ("giant vertex", _with_vertex(19, [1e200, 0, 0]), "coordinate-range", True, (19,), True),
        ("tiny mesh", (vertices * 1e-200, faces), "coordinate-range", True, (), False),
        ("one triangle", (triangle, np.array([[0, 1, 2]])), "too-few-vertices", True, (), False),
        ("all on a line", (collinear, fan), "no-area", True, (0, 1, 2), False),
        ("all at a point", (np.ones((n, 3)), faces), "no-area", True, (), False),
        ("vertex far away", _with_vertex(20, [1e20, 0, 0]), "no-area", True, (20,), False),
        ("vertex without area", _collapsed_vertex(), "no-area-vertex", False, (12,), True),
        ("two bodies", _joined((vertices, faces), shifted), "components", True, (), True),
        ("fin", _with_fin(), "non-manifold-edge", False, (len(faces),), True),
        ("three sheets", _three_sheets(), "non-manifold-edge", False, (), True),
        ("pinched vertex", _pinched(), "non-manifold-vertex", False, (), True),
        ("Möbius strip", strip(40, 1), "non-orientable", True, (), True),
        ("Klein bottle", klein_bottle(), "non-orientable", True, (), True),
        ("unreferenced vertex", unused_first, "unreferenced-vertex", False, (0,), True),
        ("unreferenced NaN", unused_nan, "unreferenced-vertex", False, (n,), True),
        ("repeated corner", _plus_faces([[3, 3, 4]]), "repeated-corner", False, (len(faces),), True),
        ("duplicate face", _plus_faces([faces[4].tolist()]), "duplicate-face", False, (len(faces),), True),
        ("reversed duplicate", _plus_faces([faces[4, ::-1].tolist()]), "duplicate-face", False, (len(faces),), True),
        ("flat face", _with_flat_face(), "zero-area-face", False, (len(faces) + 1,), True),
        ("crumb", _joined((vertices, faces), tiny), "small-components", False, (n,), True),
        ("some faces turned", _flipped_some(), "orientation", False, (3, 50, 51), True),
        ("inside out", (vertices, faces[:, ::-1].copy()), "inside-out", False, (), True),
        ("inside out with a hole", (vertices, open_top[:, ::-1].copy()), "inside-out", False, (), True),
        ("seam", _cut_seam(), "open-seam", False, (), True),
        ("hole", (vertices, open_top), "boundary", False, (), True),
        ("doubled vertices", (double, faces), "unreferenced-vertex", False, (n,), True),
    ]
    return [
        Malformed(name, *arrays, kind, refused, refused or kind in REFUSED_STRICTLY, numbers, good)
        for name, arrays, kind, refused, numbers, good in cases
    ]


def _off(arrays: Arrays) -> bytes:
    vertices, faces = arrays
    lines = ["OFF", f"{len(vertices)} {len(faces)} 0"]
    lines += [" ".join(repr(float(value)) for value in row) for row in vertices]
    lines += [f"3 {a} {b} {c}" for a, b, c in faces.tolist()]
    return ("\n".join(lines) + "\n").encode()


def _obj(arrays: Arrays) -> bytes:
    vertices, faces = arrays
    lines = ["v " + " ".join(repr(float(value)) for value in row) for row in vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    return ("\n".join(lines) + "\n").encode()


def _ply(arrays: Arrays, binary: bool) -> bytes:
    vertices, faces = arrays
    header = [
        "ply",
        f"format {'binary_little_endian' if binary else 'ascii'} 1.0",
        f"element vertex {len(vertices)}",
        *(f"property double {axis}" for axis in "xyz"),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
        "",
    ]
    if not binary:
        lines = [" ".join(repr(float(value)) for value in row) for row in vertices]
        lines += [f"3 {a} {b} {c}" for a, b, c in faces.tolist()]
        return ("\n".join(header) + "\n".join(lines) + "\n").encode()
    sides = np.zeros(len(faces), dtype=[("count", "u1"), ("corners", "<i4", (3,))])
    sides["count"], sides["corners"] = 3, faces
    return "\n".join(header).encode() + vertices.astype("<f8").tobytes() + sides.tobytes()


def _stl(arrays: Arrays) -> bytes:
    vertices, faces = arrays
    facets = np.zeros(len(faces), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("extra", "<u2")])
    facets["corners"] = vertices[faces]
    return b"\0" * 80 + np.uint32(len(faces)).tobytes() + facets.tobytes()


WRITERS: dict[str, Callable[[Arrays], bytes]] = {
    "off": _off,
    "obj": _obj,
    "ply": lambda arrays: _ply(arrays, binary=False),
    "binary ply": lambda arrays: _ply(arrays, binary=True),
    "stl": _stl,
}
"""Bytes of a mesh in every format that is read."""


def _volume(arrays: Arrays) -> bytes:
    """A tetrahedron as an unstructured grid of VTK."""
    corners = " ".join(f"{value:.3f}" for value in arrays[0][:4].ravel())
    head = "# vtk DataFile Version 3.0\na tetrahedron\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 4 float\n"
    return f"{head}{corners}\nCELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n10\n".encode()


def broken_files() -> list[tuple[str, bytes, str]]:
    """File name, content, and what the message must contain, for files that are broken as files."""
    good = sphere()
    content = {name: write(good) for name, write in WRITERS.items()}
    off = content["off"].splitlines(keepends=True)
    wrong_counts = content["ply"].replace(b"element vertex 162", b"element vertex 161")
    absurd_counts = content["binary ply"].replace(b"element vertex 162", b"element vertex 900000000000")
    return [
        ("empty.off", b"", "empty"),
        ("blank.ply", b" \n\n", "empty"),
        ("prose.off", b"Dear reader,\nthis is a letter.\n", "does not begin with OFF"),
        ("prose.obj", b"Dear reader,\nthis is a letter.\n", "neither vertices"),
        ("prose.ply", b"Dear reader,\nthis is a letter.\n", "no PLY header"),
        ("prose.stl", b"Dear reader,\nthis is a letter.\n", "neither a whole text STL"),
        ("noise.off", bytes(range(256)) * 4, "does not begin with OFF"),
        ("noise.stl", bytes(range(256)) * 4, "neither a whole text STL"),
        (
            "truncated.off",
            b"".join(off[: len(off) // 2]),
            "320 faces, but 240 lines follow",
        ),
        ("truncated-vertices.off", b"".join(off[:40]), "promises 162 vertices"),
        ("truncated.obj", b"".join(content["obj"].splitlines(keepends=True)[:37]) + b"v 0.5", "vertex|no faces"),
        ("truncated.ply", b"".join(content["ply"].splitlines(keepends=True)[:126]), "damaged|promises"),
        ("truncated-binary.ply", content["binary ply"][:3000], "damaged|promises"),
        ("truncated.stl", content["stl"][:5000], "neither a whole text STL"),
        ("header-only.ply", content["ply"].split(b"end_header")[0], "has no end"),
        ("wrong-counts.off", content["off"].replace(b"162 320", b"163 320"), "promises 163 vertices"),
        (
            "fewer-faces.off",
            content["off"].replace(b"162 320", b"162 300"),
            "300 faces, but 482 lines follow",
        ),
        (
            "fewer-faces.ply",
            content["ply"].replace(b"face 320", b"face 300"),
            "300 faces, but 482 lines follow",
        ),
        ("fewer-faces-binary.ply", content["binary ply"].replace(b"face 320", b"face 300"), "damaged|promises"),
        (
            "swapped-counts.off",
            content["off"].replace(b"162 320", b"320 162"),
            "vertex 162 is .* 4 numbers where vertex 0 has 3",
        ),
        ("wrong-counts.ply", wrong_counts, "damaged|promises|face"),
        ("absurd-counts.ply", absurd_counts, "promises 900000000000 vertices"),
        ("absurd-counts.off", b"OFF\n900000000000 900000000000 0\n0 0 0\n", "promises 900000000000 vertices"),
        ("no-counts.off", b"OFF\nmany more\n", "counts"),
        ("word.off", content["off"].replace(off[5], b"0.1 zero 0.3\n"), "vertex 3 is given as '0.1 zero 0.3'"),
        ("word.obj", b"v 0 0 0\nv 1 0 zero\nv 0 1 0\nf 1 2 3\n", "vertex 1 is given as '1 0 zero'"),
        ("short.obj", b"v 0 0 0\nv 1 0\nv 0 1 0\nf 1 2 3\n", "vertex 1 is given as '1 0'"),
        ("line.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2\n", "three corners"),
        ("letters.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf a b c\n", "face 0 contains 'a'"),
        ("short-face.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1\n", "face 0 is given as '3 0 1'"),
        ("other-format.off", content["ply"], "does not begin with OFF"),
        ("comma.off", off[0] + off[1] + b"0,5 0,25 1,5\n" + b"".join(off[3:]), "with decimal points, not commas"),
        ("prose.vtk", b"Dear reader,\nthis is a letter.\n", "no VTK header"),
        ("prose.vtp", b"Dear reader,\nthis is a letter.\n", "no VTK file in XML"),
        ("prose.glb", b"Dear reader,\nthis is a letter.\n", "no GLB file"),
        ("prose.xyz", b"Dear reader,\nthis is a letter.\n", "points are given as three numbers a line"),
        ("prose.off.gz", b"Dear reader,\nthis is a letter.\n", "no whole gzip file"),
        ("volume.vtk", _volume(good), "extract its surface"),
        ("lh.curv", b"\xff\xff\xff\0\0\0\xa2\0\0\x01\x40\0\0\0\x01" + bytes(648), "FreeSurfer file of values"),
        ("truncated.white", b"\xff\xff\xfecreated\n\n\0\0\0\xa2\0\0\x01\x40" + bytes(100), "promises 162 vertices"),
        ("mesh.fbx", b"Kaydara FBX Binary", "unknown mesh format"),
        ("mesh", content["off"], "unknown mesh format"),
        ("ünïcode – 形 😀.off", b"", "ünïcode – 形 😀.off: the file is empty"),
    ]


def write_collection(folder: Path) -> list[MalformedFile]:
    """Write every case into `folder`; the refused ones name what the message must contain, the others their note."""
    found = []
    for case in surfaces():
        path = folder / f"{case.name.replace(' ', '-')}.off"
        path.write_bytes(_off((case.vertices, case.faces)))
        found.append(MalformedFile(case.name, path, case.refused, ""))
    for name, content, words in broken_files():
        path = folder / name
        path.write_bytes(content)
        found.append(MalformedFile(name, path, True, words))
    folder_path = folder / "folder.off"
    folder_path.mkdir()
    found.append(MalformedFile("a folder", folder_path, True, "is a directory"))
    found.append(MalformedFile("missing", folder / "missing.off", True, "no such file"))
    return found


def case_names() -> list[str]:
    """Names of the whole collection, in its order."""
    return [
        *(case.name for case in surfaces()),
        *(name for name, _, _ in broken_files()),
        "a folder",
        "missing",
    ]


def messages(folder: Path) -> list[tuple[str, str, str]]:
    """Write the collection and load it: name, "refused" or "loaded", and the message or the notes of each."""
    from clalign.errors import MeshError
    from clalign.mesh.mesh import load_mesh

    rows = []
    for case in write_collection(folder):
        try:
            verdict, message = "loaded", "; ".join(load_mesh(case.path).notes)
        except MeshError as error:
            verdict, message = "refused", str(error)
        message = message.replace(f"{folder}{os.sep}", "").replace(str(Path.cwd()), "…")
        rows.append((case.name, verdict, message))
    return rows


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        for row in messages(Path(scratch)):
            print("{:<26} {:<8} {}".format(*row))
