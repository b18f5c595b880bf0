"""Landmarks: every form and file gives the same pairs, and what is wrong is named."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray

from clalign.errors import InputError
from clalign.mesh.landmarks import Landmarks, landmarks_of
from clalign.mesh.mesh import Mesh, mesh_from_arrays

PAIRS = np.array([[3, 40], [17, 5], [99, 120]])
NAMES = ("nose", "left", "right")

Points = NDArray[np.float64]
Write = Callable[[Path, tuple[str, ...], Points], Path]


@pytest.fixture(scope="module")
def meshes() -> tuple[Mesh, Mesh]:
    vertices, faces = shapes.bumpy_sphere(2)
    return mesh_from_arrays(vertices, faces, "one"), mesh_from_arrays(3.0 * vertices + [5.0, 0, 1], faces, "other")


@pytest.fixture(scope="module")
def points(meshes: tuple[Mesh, Mesh]) -> list[Points]:
    return [mesh.file_positions()[PAIRS[:, side]] for side, mesh in enumerate(meshes)]


def same(found: Landmarks) -> None:
    np.testing.assert_array_equal(np.stack([found.source, found.target], axis=1), PAIRS)


def slicer(path: Path, names: tuple[str, ...], places: Points) -> Path:
    controls: list[dict[str, object]] = [
        {"label": name, "position": place.tolist()} for name, place in zip(names, places, strict=True)
    ]
    controls.append({"label": "unset", "position": [0, 0, 0], "positionStatus": "undefined"})
    path.write_text(json.dumps({"markups": [{"type": "Fiducial", "controlPoints": controls}]}))
    return path


def meshlab(path: Path, names: tuple[str, ...], places: Points) -> Path:
    rows = [
        f'<point x="{x}" y="{y}" z="{z}" active="1" name="{name}"/>'
        for name, (x, y, z) in zip(names, places.tolist(), strict=True)
    ]
    path.write_text(f"<!DOCTYPE PickedPoints><PickedPoints>{''.join(rows)}</PickedPoints>")
    return path


def test_arrays(meshes: tuple[Mesh, Mesh], points: list[Points]) -> None:
    same(landmarks_of(PAIRS, *meshes))
    same(landmarks_of(PAIRS.tolist(), *meshes))
    same(landmarks_of((PAIRS[:, 0], PAIRS[:, 1]), *meshes))
    found = landmarks_of(tuple(points), *meshes)
    same(found)
    assert found.source_gap.max() < 1e-9
    two = landmarks_of((PAIRS[:2, 0], PAIRS[:2, 1]), *meshes)
    np.testing.assert_array_equal(two.target, PAIRS[:2, 1])
    np.testing.assert_array_equal(landmarks_of(PAIRS[:2], *meshes).target, PAIRS[:2, 1])
    assert landmarks_of(two, *meshes, 0.2).tolerance == 0.2
    one = landmarks_of([[3, 40]], *meshes)
    assert (len(one), one.names) == (1, ("1",))


def test_points_beside_the_surface_are_snapped_and_say_how_far(meshes: tuple[Mesh, Mesh], points: list[Points]) -> None:
    outward = points[1] - [5.0, 0, 1]
    found = landmarks_of((points[0], points[1] + 0.02 * outward), *meshes)
    same(found)
    np.testing.assert_allclose(found.target_gap, 0.02 * np.linalg.norm(outward, axis=1) / meshes[1].scale, rtol=1e-9)
    with pytest.raises(InputError, match=r"landmark \d: lies [\d.]+ away from other"):
        landmarks_of((points[0], points[1] + [100.0, 0, 0]), *meshes)


@pytest.mark.parametrize("name", ["plain.txt", "commas.csv", "named.csv", "spaced.csv", "headed.csv", "points.txt"])
def test_one_file(name: str, meshes: tuple[Mesh, Mesh], points: list[Points], tmp_path: Path) -> None:
    rows = {
        "plain.txt": ["# pairs", *(f"{a} {b}" for a, b in PAIRS)],
        "commas.csv": [f"{a},{b}" for a, b in PAIRS],
        "named.csv": [f"{name};{a};{b}" for name, (a, b) in zip(NAMES, PAIRS, strict=True)],
        "spaced.csv": [f"{name} tip, {a}, {b}" for name, (a, b) in zip(NAMES, PAIRS, strict=True)],
        "headed.csv": ["source,target", *(f"{a},{b}" for a, b in PAIRS)],
        "points.txt": [" ".join(map(repr, [*a, *b])) for a, b in zip(*(p.tolist() for p in points), strict=True)],
    }[name]
    path = tmp_path / name
    path.write_text("\n".join(rows) + "\n")
    found = landmarks_of(path, *meshes)
    same(found)
    spaced = tuple(f"{each} tip" for each in NAMES)
    assert found.names == {"named.csv": NAMES, "spaced.csv": spaced}.get(name, ("1", "2", "3"))


@pytest.mark.parametrize(("write", "suffix"), [(slicer, ".mrk.json"), (meshlab, ".pp")])
def test_two_files_are_joined_by_name(
    write: Write, suffix: str, meshes: tuple[Mesh, Mesh], points: list[Points], tmp_path: Path
) -> None:
    first = write(tmp_path / f"a{suffix}", NAMES, points[0])
    turned = [2, 0, 1]
    second = write(tmp_path / f"b{suffix}", tuple(NAMES[turn] for turn in turned), points[1][turned])
    found = landmarks_of([first, second], *meshes)
    same(found)
    assert found.names == NAMES
    np.savetxt(tmp_path / "b.txt", points[1])
    same(landmarks_of([first, tmp_path / "b.txt"], *meshes))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ([[3, 400]], "landmark 1: 400 is no vertex of other, which has 0 to 161"),
        ([[3, 40], [3, 41]], "landmark 1: vertex 3 of one belongs to another landmark as well"),
        ([[3, 40.5]], "expected vertex numbers"),
        ([], "expected rows of two"),
        (7, "expected pairs of vertices"),
        ("nothing.txt", "cannot be read"),
    ],
)
def test_what_is_wrong_with_arrays_is_named(meshes: tuple[Mesh, Mesh], given: object, words: str) -> None:
    with pytest.raises(InputError, match=words):
        landmarks_of(given, *meshes)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1 2\n3\n", "landmark 2 is given as '3'"),
        ("nose,1,2\n3,4\n", "some rows begin with a name"),
        ("# none\n", "holds no landmark"),
        ("1 2 3\n", "expected 2 vertex numbers or 6"),
        ("1_2 3 4\n5 6 7\n", "some rows begin with a name"),
    ],
)
def test_what_is_wrong_with_a_text_is_named(meshes: tuple[Mesh, Mesh], text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "given.txt"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        landmarks_of(path, *meshes)


def test_what_is_wrong_with_two_files_is_named(meshes: tuple[Mesh, Mesh], points: list[Points], tmp_path: Path) -> None:
    first = slicer(tmp_path / "a.mrk.json", NAMES, points[0])
    with pytest.raises(InputError, match="no landmark name in common"):
        landmarks_of([first, slicer(tmp_path / "b.mrk.json", ("x", "y", "z"), points[1])], *meshes)
    with pytest.raises(InputError, match="two landmarks are called 'nose'"):
        landmarks_of([first, slicer(tmp_path / "c.mrk.json", ("nose", "nose", "z"), points[1])], *meshes)
    with pytest.raises(InputError, match="holds the points of one shape"):
        landmarks_of(first, *meshes)
    (tmp_path / "bad.pp").write_text("<PickedPoints><point x='1'/>")
    with pytest.raises(InputError, match="no file of picked points"):
        landmarks_of([tmp_path / "bad.pp", tmp_path / "bad.pp"], *meshes)
    with pytest.raises(InputError, match="must not be negative"):
        landmarks_of(PAIRS, *meshes, -0.1)
