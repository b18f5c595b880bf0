"""What landmarks do to a match: they settle symmetries, are kept, and a wrong one is named and spoils nothing."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray
from prepared import MIDDLE
from scipy.spatial import ConvexHull

from clalign.correspondence import Correspondence
from clalign.errors import ClalignWarning
from clalign.maps.point_maps import PointMaps
from clalign.matching.pair import match
from clalign.mesh.landmarks import landmarks_of
from clalign.mesh.mesh import Mesh, mesh_from_arrays
from clalign.refinement.landmarks import disagreement, kept_exactly

OPTIONS = MIDDLE.replace({"geodesics.search_samples": 150, "alignment.outer_iterations": 1})


@pytest.fixture(scope="module")
def ellipsoids() -> tuple[Mesh, Mesh, NDArray[np.int64]]:
    """A body that half-turns about three axes carry to itself, and a renumbered copy."""
    directions, faces = shapes.icosphere(3)
    vertices = directions * [1.0, 0.7, 0.45]
    other, other_faces, new_of_old = shapes.renumbered(vertices, faces, 3)
    return mesh_from_arrays(vertices, faces, "one"), mesh_from_arrays(other, other_faces, "other"), new_of_old


def mean_error(result: Correspondence, truth: NDArray[np.int64]) -> float:
    """Mean distance in space to the true vertices, in sqrt(area)."""
    places = result.target.vertices
    return float(np.linalg.norm(places[result.target_of_source] - places[truth], axis=1).mean())


@pytest.mark.filterwarnings("ignore::clalign.errors.ConfidenceWarning")
@pytest.mark.parametrize("turn", [[1, -1, -1], [-1, -1, 1]])
def test_one_landmark_settles_a_symmetry(ellipsoids: tuple[Mesh, Mesh, NDArray[np.int64]], turn: list[int]) -> None:
    """Each of the four maps is the right one for somebody; here are two of them."""
    source, target, new_of_old = ellipsoids
    points = source.file_positions()
    image = np.linalg.norm(points[:, None] * turn - points[None], axis=2).argmin(axis=1)
    truth = new_of_old[image]
    known = int(np.argmax(points @ [0.5, 0.6, 0.9]))
    result = match(source, target, OPTIONS, landmarks=[[known, truth[known]]])
    assert mean_error(result, truth) < 0.05
    assert result.target_of_source[known] == truth[known]
    assert result.landmarks[0]["used"]


@pytest.fixture(scope="module")
def bodies() -> tuple[Mesh, Mesh, NDArray[np.int64]]:
    vertices, faces = shapes.bumpy_sphere(3)
    other, other_faces, new_of_old = shapes.renumbered(shapes.bent(vertices), faces, 5)
    return mesh_from_arrays(vertices, faces, "one"), mesh_from_arrays(other, other_faces, "other"), new_of_old


def spread(mesh: Mesh, count: int) -> NDArray[np.int64]:
    chosen = [0]
    while len(chosen) < count:
        gaps = np.linalg.norm(mesh.vertices[:, None] - mesh.vertices[chosen][None], axis=2).min(axis=1)
        chosen.append(int(gaps.argmax()))
    return np.array(chosen)


def test_true_landmarks_are_kept_and_a_wrong_one_is_named(
    bodies: tuple[Mesh, Mesh, NDArray[np.int64]], tmp_path: Path
) -> None:
    source, target, new_of_old = bodies
    known = spread(source, 5)
    pairs = np.stack([known, new_of_old[known]], axis=1)
    plain = match(source, target, OPTIONS)
    result = match(source, target, OPTIONS, landmarks=pairs)
    np.testing.assert_array_equal(result.target_of_source[known], new_of_old[known])
    np.testing.assert_array_equal(result.source_of_target[new_of_old[known]], known)
    assert mean_error(result, new_of_old) <= mean_error(plain, new_of_old) + 1e-3
    pairs[2, 1] = new_of_old[spread(source, 6)[5]]
    with pytest.warns(ClalignWarning, match="landmark 3"):
        wrong = match(source, target, OPTIONS, landmarks=pairs)
    assert mean_error(wrong, new_of_old) <= mean_error(plain, new_of_old) + 1e-3
    assert [each["used"] for each in wrong.landmarks] == [True, True, False, True, True]
    assert any(words.startswith(f"landmark 3 (source vertex {known[2]}") for words in wrong.warnings)
    wrong.save(tmp_path / "result")
    assert Correspondence.load(tmp_path / "result").landmarks == wrong.landmarks


def test_landmarks_with_a_tolerance_are_not_forced(bodies: tuple[Mesh, Mesh, NDArray[np.int64]]) -> None:
    source, target, new_of_old = bodies
    known = spread(source, 4)
    off = [int(target.faces[(target.faces == new_of_old[vertex]).any(axis=1)][0].max()) for vertex in known]
    result = match(source, target, OPTIONS, landmarks=(known, np.array(off)), landmark_tolerance=0.1)
    plain = match(source, target, OPTIONS)
    assert mean_error(result, new_of_old) <= mean_error(plain, new_of_old) + 1e-3
    assert all(each["used"] for each in result.landmarks)


def test_a_landmark_that_one_direction_contradicts_is_left_aside(
    ellipsoids: tuple[Mesh, Mesh, NDArray[np.int64]],
) -> None:
    """What the backward map knows better is not overwritten."""
    source, target, truth = ellipsoids
    backward = np.argsort(truth)
    marks = landmarks_of([[3, int(truth[3])], [50, int(truth[50])]], source, target)
    far = int(np.linalg.norm(source.vertices - source.vertices[50], axis=1).argmax())
    backward[truth[50]] = far
    maps = PointMaps(truth, backward)
    shapes_of = (SimpleNamespace(mesh=source), SimpleNamespace(mesh=target))
    off = disagreement(*shapes_of, maps, marks)  # type: ignore[arg-type]
    assert off[0] < 1e-9
    assert off[1] > 0.5
    kept = kept_exactly(maps, marks, off < 0.1)
    assert kept.source_of_target[truth[50]] == far
    assert kept.source_of_target[truth[3]] == 3


def _turned_ellipsoid(seed: int) -> Mesh:
    """An ellipsoid with triangles of its own for each seed."""
    number = np.arange(600) + 0.5
    height, angle = 1 - 2 * number / 600, np.pi * (1 + 5**0.5) * number
    ring = np.sqrt(1 - height**2)
    points = np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=1)
    points @= np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    faces = ConvexHull(points).simplices
    inward = np.linalg.det(points[faces]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return mesh_from_arrays(points * [1.0, 0.7, 0.45], faces, f"ellipsoid {seed}")


@pytest.mark.filterwarnings("ignore::clalign.errors.ClalignWarning")
def test_equally_good_maps_are_named_kept_and_started_from(tmp_path: Path) -> None:
    source, target = _turned_ellipsoid(1), _turned_ellipsoid(2)
    options = OPTIONS.replace({"geodesics.search_samples": 300, "search.alternatives": 2})
    result = match(source, target, options)
    turns = {each["relation"]: each["alternative"] for each in result.equally_good}
    assert set(turns) == {f"half turn about the {axis} axis" for axis in ("left–right", "vertical", "front–back")}
    assert sorted(turns.values(), key=str) == [1, 2, None]
    assert all(each["order"] == 2 and not each["reversing"] for each in result.equally_good)
    said = [text for text in result.warnings if "about as good as the chosen one" in text]
    assert len(said) == 1
    assert "--start RESULT --start-map 1 or 2" in said[0]
    result.save(tmp_path / "result")
    loaded = Correspondence.load(tmp_path / "result")
    assert loaded.equally_good == result.equally_good
    assert [each.relation for each in loaded.alternatives] == [each.relation for each in result.alternatives]
    again = match(source, target, options, start=loaded.with_map(1))
    assert mean_error(again, loaded.alternatives[0].target_of_source) < 0.05
    assert mean_error(again, loaded.target_of_source) > 0.3
