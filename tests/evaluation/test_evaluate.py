from __future__ import annotations

import csv
import dataclasses
import json
from pathlib import Path

import datasets
import numpy as np
import pytest
import shapes

from clalign.benchmark.perturb import renumber
from clalign.errors import ResultError
from clalign.evaluation.distances import Distances
from clalign.evaluation.errors import THRESHOLDS, area_under_curve, error_curve, evaluate
from clalign.evaluation.truth import Truth
from clalign.mesh.mesh import Mesh, mesh_from_arrays


@pytest.fixture(scope="module")
def sphere() -> Mesh:
    return mesh_from_arrays(*shapes.icosphere(4), name="sphere")


@pytest.fixture(scope="module")
def bumpy_mesh() -> Mesh:
    return mesh_from_arrays(*shapes.bumpy_sphere(3), name="bumpy")


@pytest.fixture(scope="module")
def egg() -> tuple[Mesh, np.ndarray]:
    (vertices, faces), mirror = datasets.symmetric()
    return mesh_from_arrays(vertices, faces, "egg"), mirror


def test_the_true_map_has_no_error(bumpy_mesh: Mesh) -> None:
    n = bumpy_mesh.n_vertices
    truth = Truth.identity(n)
    result = evaluate(np.arange(n), truth, source=bumpy_mesh, target=bumpy_mesh)
    assert result.mean == 0.0
    assert result.exact == 1.0
    assert result.area_under_curve() == 1.0
    assert result.quality.covered_vertices == 1.0
    assert result.quality.covered_area == pytest.approx(1.0)
    assert result.quality.stretch == pytest.approx(1.0)
    assert result.flipped is None
    assert result.points.size == 500


def test_dirichlet_energy_of_an_isometry_is_one(bumpy_mesh: Mesh) -> None:
    moved = renumber(bumpy_mesh, seed=3)
    result = evaluate(moved.truth.target_points, moved.truth, source=bumpy_mesh, target=moved.mesh)
    assert result.mean == 0.0
    assert result.quality.dirichlet == pytest.approx(1.0, rel=1e-9)


def test_a_torn_map_is_rough(bumpy_mesh: Mesh, rng: np.random.Generator) -> None:
    n = bumpy_mesh.n_vertices
    result = evaluate(rng.permutation(n), Truth.identity(n), source=bumpy_mesh, target=bumpy_mesh)
    assert result.quality.dirichlet > 20
    assert result.quality.stretch > 3


@pytest.mark.parametrize("method", ["heat", "bounded"])
def test_a_map_to_the_neighbour_is_wrong_by_an_edge(sphere: Mesh, method: str) -> None:
    n = sphere.n_vertices
    neighbour = np.zeros(n, dtype=np.int64)
    neighbour[sphere.faces] = np.roll(sphere.faces, 1, axis=1)
    result = evaluate(neighbour, Truth.identity(n), source=sphere, target=sphere, method=method, points=300)
    edges = np.linalg.norm(sphere.vertices - sphere.vertices[neighbour], axis=1)[result.points]
    assert result.exact == 0.0
    assert result.mean == pytest.approx(edges.mean(), rel=0.15 if method == "heat" else 0.03)
    if method == "bounded":
        assert (result.errors >= edges - 1e-12).all()


def test_the_antipodal_map_is_wrong_by_the_diameter(sphere: Mesh) -> None:
    """On a sphere of unit area it is pi R = sqrt(pi) / 2 for every vertex."""
    n = sphere.n_vertices
    antipode = np.argmin(sphere.vertices @ sphere.vertices.T, axis=1)
    result = evaluate(antipode, Truth.identity(n), source=sphere, target=sphere)
    assert result.mean == pytest.approx(np.sqrt(np.pi) / 2, rel=0.02)
    assert result.diameter == pytest.approx(np.sqrt(np.pi) / 2, rel=0.02)
    assert result.area_under_curve() == 0.0


def test_one_point_for_all(sphere: Mesh) -> None:
    """A constant map on a sphere is wrong by pi R / 2 on average over the sphere and covers one vertex."""
    n = sphere.n_vertices
    result = evaluate(np.zeros(n, dtype=int), Truth.identity(n), source=sphere, target=sphere, points=n)
    assert result.mean == pytest.approx(np.sqrt(np.pi) / 4, rel=0.02)
    assert result.quality.covered_vertices == pytest.approx(1 / n)
    assert result.quality.dirichlet == pytest.approx(0.0, abs=1e-9)


def test_the_mirrored_map_is_flipped(egg: tuple[Mesh, np.ndarray]) -> None:
    mesh, mirror = egg
    truth = Truth.identity(mesh.n_vertices)
    mirrored = truth.mirrored(mirror)
    wrong = evaluate(mirror, truth, source=mesh, target=mesh, mirrored=mirrored)
    right = evaluate(np.arange(mesh.n_vertices), truth, source=mesh, target=mesh, mirrored=mirrored)
    assert wrong.flipped is True
    assert wrong.mirrored_mean == 0.0
    assert wrong.mean > 0.1
    assert right.flipped is False
    assert right.mirrored_mean == pytest.approx(wrong.mean)


def test_errors_do_not_depend_on_size_place_or_numbering(bumpy_mesh: Mesh, rng: np.random.Generator) -> None:
    n = bumpy_mesh.n_vertices
    index = rng.integers(0, n, n)
    truth = Truth.identity(n)
    before = evaluate(index, truth, source=bumpy_mesh, target=bumpy_mesh)
    large = mesh_from_arrays(1000 * bumpy_mesh.vertices + 7.0, bumpy_mesh.faces, "large")
    moved = renumber(large, seed=5)
    new = moved.truth.target_points
    after = evaluate(new[index], truth.renumbered(new), source=bumpy_mesh, target=moved.mesh)
    np.testing.assert_allclose(after.errors, before.errors, atol=1e-6)
    assert after.diameter == pytest.approx(before.diameter, rel=1e-6)


def test_vertices_off_the_surface_are_skipped(bumpy_mesh: Mesh) -> None:
    """The file numbering of a mesh with unused vertices is that of the map and of the truth."""
    vertices, faces = shapes.bumpy_sphere(2)
    padded = mesh_from_arrays(np.concatenate([[[9.0, 9, 9]], vertices, [[8.0, 8, 8]]]), faces + 1, "padded")
    plain = mesh_from_arrays(vertices, faces, "plain")
    n = plain.n_vertices
    index = np.concatenate([[-1], np.arange(n), [-1]])
    truth = Truth(np.arange(n + 2), np.clip(np.arange(n + 2) - 1, 0, n - 1))
    result = evaluate(index, truth, source=padded, target=plain)
    assert result.mean == 0.0
    assert (result.skipped, result.unmatched) == (2, 0)
    index[1:4] = -1
    partial = evaluate(index, truth, source=padded, target=plain)
    assert partial.quality.covered_vertices == pytest.approx(1 - 3 / n)
    assert (partial.skipped, partial.unmatched, partial.points.size) == (2, 3, n - 3)


def test_points_inside_faces(sphere: Mesh) -> None:
    """The error of the middle of a face to one of its corners is the straight distance."""
    corner = sphere.faces[:, 0].astype(np.int64)
    distances = Distances(sphere)
    thirds = np.full((sphere.n_faces, 3), 1 / 3)
    found = distances.to_face_points(corner[:50], sphere.faces[:50], thirds[:50])
    middles = sphere.vertices[sphere.faces[:50]].mean(axis=1)
    np.testing.assert_allclose(found, np.linalg.norm(middles - sphere.vertices[corner[:50]], axis=1))
    far = distances.to_face_points(np.zeros(sphere.n_faces, dtype=np.int64), sphere.faces, thirds)
    centre = sphere.vertices[sphere.faces].mean(axis=1)
    cosine = (centre @ sphere.vertices[0]) / np.linalg.norm(centre, axis=1) / np.linalg.norm(sphere.vertices[0])
    radius = 1 / np.sqrt(4 * np.pi)
    np.testing.assert_allclose(far, radius * np.arccos(np.clip(cosine, -1, 1)), atol=0.03 * radius)


def test_subvertex_errors_vanish_at_the_true_corner(sphere: Mesh) -> None:
    n = sphere.n_vertices
    faces = np.zeros(n, dtype=np.int64)
    weights = np.zeros((n, 3))
    for corner in range(3):
        faces[sphere.faces[:, corner]] = np.arange(sphere.n_faces)
    weights[np.arange(n), (sphere.faces[faces] == np.arange(n)[:, None]).argmax(axis=1)] = 1.0
    antipode = np.argmin(sphere.vertices @ sphere.vertices.T, axis=1)
    result = evaluate(antipode, Truth.identity(n), source=sphere, target=sphere, barycentric=(faces, weights))
    assert result.subvertex_mean == 0.0
    assert result.mean > 0.5


def test_which_points_are_measured(bumpy_mesh: Mesh) -> None:
    n = bumpy_mesh.n_vertices
    index, truth = np.roll(np.arange(n), 1), Truth.identity(n)
    first = evaluate(index, truth, source=bumpy_mesh, target=bumpy_mesh, points=50, seed=1)
    again = evaluate(index, truth, source=bumpy_mesh, target=bumpy_mesh, points=50, seed=1)
    other = evaluate(index, truth, source=bumpy_mesh, target=bumpy_mesh, points=50, seed=2)
    chosen = evaluate(index, truth, source=bumpy_mesh, target=bumpy_mesh, points=first.points)
    np.testing.assert_array_equal(first.points, again.points)
    assert not np.array_equal(first.points, other.points)
    np.testing.assert_array_equal(chosen.errors, first.errors)
    assert np.unique(first.points).size == 50


def test_a_map_of_single_vertices_has_no_smoothness(bumpy_mesh: Mesh) -> None:
    n = bumpy_mesh.n_vertices
    index = np.full(n, -1)
    index[7] = 7
    result = evaluate(index, Truth.identity(n), source=bumpy_mesh, target=bumpy_mesh, points=n)
    assert (result.points.size, result.unmatched, result.mean) == (1, n - 1, 0.0)
    assert result.quality.dirichlet is None
    json.dumps(result.as_dict(), allow_nan=False)


def test_curve_and_area() -> None:
    assert area_under_curve(error_curve(np.zeros(3))) == 1.0
    assert area_under_curve(error_curve(np.full(3, 0.3))) == 0.0
    curve = error_curve(np.array([0.0, 0.1, 0.1, 1.0]))
    assert curve[0] == 0.25
    assert curve[THRESHOLDS.searchsorted(0.0999)] == pytest.approx(0.75)
    assert curve[-1] == 0.75
    uniform = error_curve(np.linspace(0, 0.25, 10001))
    assert area_under_curve(uniform) == pytest.approx(0.5, abs=1e-3)


def test_curve_per_diameter_is_the_stretched_curve(bumpy_mesh: Mesh, rng: np.random.Generator) -> None:
    n = bumpy_mesh.n_vertices
    result = evaluate(rng.permutation(n), Truth.identity(n), source=bumpy_mesh, target=bumpy_mesh)
    np.testing.assert_array_equal(result.curve(per_diameter=True), error_curve(result.errors / result.diameter))


def test_files(bumpy_mesh: Mesh, tmp_path: Path) -> None:
    n = bumpy_mesh.n_vertices
    truth = Truth.identity(n)
    mirrored = truth.mirrored(np.arange(n)[::-1])
    result = evaluate(np.roll(np.arange(n), 1), truth, source=bumpy_mesh, target=bumpy_mesh, mirrored=mirrored)
    result.write_json(tmp_path / "e.json")
    result.write_csv(tmp_path / "e.csv")
    values = json.loads((tmp_path / "e.json").read_text(encoding="utf-8"))
    assert values["per_sqrt_area"]["mean"] == pytest.approx(result.mean)
    assert values["per_diameter"]["q90"] == pytest.approx(np.quantile(result.errors, 0.9) / result.diameter)
    assert "heat method" in values["distances"]
    with (tmp_path / "e.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    np.testing.assert_allclose([float(row["error"]) for row in rows], result.errors)
    np.testing.assert_allclose([float(row["mirrored_error"]) for row in rows], result.mirrored_errors)


def test_maps_that_do_not_fit(bumpy_mesh: Mesh, egg: tuple[Mesh, np.ndarray]) -> None:
    n, truth = bumpy_mesh.n_vertices, Truth.identity(bumpy_mesh.n_vertices)
    small = egg[0]
    with pytest.raises(ResultError, match="needs both meshes"):
        evaluate(np.arange(n), truth)
    with pytest.raises(ResultError, match=f"{n - 1} entries.*exchanged"):
        evaluate(np.arange(n - 1), truth, source=bumpy_mesh, target=bumpy_mesh)
    with pytest.raises(ResultError, match=f"source vertex 162 is matched to target vertex 162.*{small.n_vertices}"):
        evaluate(np.arange(n), truth, source=bumpy_mesh, target=small)
    with pytest.raises(ResultError, match="whole numbers"):
        evaluate(np.arange(n) / 2, truth, source=bumpy_mesh, target=bumpy_mesh)
    with pytest.raises(ResultError, match="names target vertex"):
        evaluate(np.zeros(n, dtype=int), truth, source=bumpy_mesh, target=small)
    with pytest.raises(ResultError, match="no point of the truth"):
        evaluate(np.full(n, -1), truth, source=bumpy_mesh, target=bumpy_mesh)
    with pytest.raises(ResultError, match="distance method 'exact'"):
        evaluate(np.arange(n), truth, source=bumpy_mesh, target=bumpy_mesh, method="exact")  # type: ignore[arg-type]
    with pytest.raises(ResultError, match="lines of the truth"):
        evaluate(np.arange(n), truth, source=bumpy_mesh, target=bumpy_mesh, points=[n])
    with pytest.raises(ResultError, match="mirrored truth has 2 lines"):
        evaluate(np.arange(n), truth, source=bumpy_mesh, target=bumpy_mesh, mirrored=Truth.identity(2))


def test_a_result_brings_its_meshes(bumpy_pair, true_correspondence) -> None:  # type: ignore[no-untyped-def]
    truth = Truth.from_index(bumpy_pair.truth)
    assert evaluate(true_correspondence, truth).mean == 0.0
    turned = dataclasses.replace(true_correspondence, target_of_source=np.roll(bumpy_pair.truth, 1))
    assert evaluate(turned, truth).exact == 0.0
