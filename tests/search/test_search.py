"""The search for the isometry: its parts on small cases, and whole on shapes whose answer is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import shapes
from numpy.typing import NDArray
from prepared import MIDDLE, tiny_pair

from clalign.engine import Backend, Reference
from clalign.geometry.geodesics import all_pairs
from clalign.geometry.shape import Shape, prepare
from clalign.maps.orientation import index_pairs, orientation_scores
from clalign.mesh.mesh import mesh_from_arrays
from clalign.refinement.zoomout import vertex_maps
from clalign.rules import Level, SearchRules
from clalign.search.batch import (
    SampledShape,
    SamplePair,
    distortions,
    map_distances,
    newton_schulz,
    up_sample,
    without_duplicates,
)
from clalign.search.find import find_isometry
from clalign.search.initial_maps import oriented_initial_maps, sign_patterns, unfold
from clalign.search.score import ranked
from clalign.search.symmetries import composed, self_maps
from clalign.search.tree import branched

RULES = SearchRules()
PRODUCTS = RULES.scored_products

Arrays = tuple[NDArray[np.float64], NDArray[np.int64]]


def reflected(arrays: Arrays) -> Arrays:
    """Return the mirror image, its faces turned so that they look outward again."""
    vertices, faces = arrays
    return vertices * np.array([-1.0, 1.0, 1.0]), faces[:, ::-1].copy()


def rotated(arrays: Arrays, seed: int) -> Arrays:
    rotation = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return arrays[0] @ (rotation * np.linalg.det(rotation)).T, arrays[1]


@pytest.fixture(scope="module")
def shape(bumpy: Arrays) -> Shape:
    return prepare(mesh_from_arrays(*bumpy), MIDDLE)


@pytest.fixture(scope="module")
def samples(shape: Shape) -> SampledShape:
    return SampledShape.of(shape)


@pytest.fixture(scope="module")
def own(samples: SampledShape) -> SamplePair:
    """The shape with itself."""
    return SamplePair(samples, samples, Reference())


def test_sign_patterns_are_all_there() -> None:
    patterns = sign_patterns(5)
    assert patterns.shape == (16, 5, 5)
    diagonals = np.diagonal(patterns, axis1=1, axis2=2)
    assert (diagonals[:, 0] == 1).all()
    assert len(np.unique(diagonals, axis=0)) == 16
    assert (np.abs(patterns) == np.eye(5)).all()


def test_branching_joins_what_is_left_out() -> None:
    """The map forgets function 2 of X and never reaches function 3 of Y: both signs of joining them are tried."""
    lost = np.diag([1.0, 1.0, 0.0, 0.0, 1.0]).astype(np.float32)
    lost[2, 3] = 1.0
    whole = np.eye(5, dtype=np.float32)
    candidates = branched(np.stack([whole, lost]), 0.55)
    assert candidates.shape == (4, 5, 5)
    np.testing.assert_array_equal(candidates[:2], np.stack([whole, lost]))
    for candidate, sign in zip(candidates[2:], (1.0, -1.0), strict=True):
        expected = lost.copy()
        expected[3, 2] = sign
        np.testing.assert_array_equal(candidate, expected)
    np.testing.assert_array_equal(branched(whole[None], 0.55), whole[None])


def test_duplicates_are_left_out() -> None:
    position = np.array([0.0, 0.01, 0.5, 0.52, 1.0])
    between = np.abs(position[:, None] - position)
    assert without_duplicates(between, np.arange(5), 0.1, 10) == [0, 2, 4]
    assert without_duplicates(between, np.array([3, 4, 1, 0, 2]), 0.1, 10) == [3, 4, 1]
    assert without_duplicates(between, np.arange(5), 0.1, 2) == [0, 2]
    assert without_duplicates(between, np.arange(5), 0.001, 10) == [0, 1, 2, 3, 4]


def test_newton_schulz_gives_the_polar_factor(rng: np.random.Generator) -> None:
    maps = np.stack([np.linalg.qr(rng.normal(size=(12, 12)))[0] for _ in range(6)])
    disturbed = (maps + 0.05 * rng.normal(size=maps.shape)).astype(np.float32)
    expected = np.stack([scipy.linalg.polar(m.astype(np.float64))[0] for m in disturbed])
    np.testing.assert_allclose(newton_schulz(disturbed), expected, atol=1e-4)


def test_pairs_of_functions_have_two_columns_also_where_there_are_none() -> None:
    assert index_pairs(1, 3).tolist() == [[1, 2], [1, 3], [2, 3]]
    for last in (0, 1):
        assert index_pairs(1, last).shape == (0, 2)


def test_three_functions_are_enough_for_a_search() -> None:
    """As few as the options let through: two functions beside the constant one fix this map and its orientation."""
    vertices, faces = shapes.bumpy_sphere(2)
    options = MIDDLE.replace({"spectrum.basis": 3, "spectrum.refinement": 3})
    shape = prepare(mesh_from_arrays(vertices, faces), options)
    found = find_isometry(shape, shape, "preserving", RULES, Reference()).chosen
    np.testing.assert_allclose(found.functional, np.eye(3), atol=1e-4)
    assert found.orientation == pytest.approx(1.0, abs=1e-4)


def test_orientation_of_a_shape_and_its_mirror_image(shape: Shape, samples: SampledShape, bumpy: Arrays) -> None:
    identity = np.eye(20)[None]
    assert orientation_scores(identity, samples.tensor, samples.tensor, PRODUCTS)[0] == pytest.approx(1.0, abs=1e-5)
    assert orientation_scores(identity, samples.tensor, -samples.tensor, PRODUCTS)[0] == pytest.approx(-1.0, abs=1e-5)
    image = prepare(mesh_from_arrays(*reflected(bumpy)), MIDDLE)
    # Same numbering and same intrinsic functions, up to sign.
    signs = np.sign(np.sum(image.basis.functions * shape.basis.functions * shape.mass[:, None], axis=0))
    assert (
        orientation_scores(np.diag(signs[:20])[None], samples.tensor, SampledShape.of(image).tensor, PRODUCTS)[0]
        < -0.99
    )
    np.testing.assert_allclose(samples.mirrored().mirrored().tensor, samples.tensor)


def test_orientation_of_nonsense_is_undecided(samples: SampledShape, rng: np.random.Generator) -> None:
    nonsense = np.stack([np.linalg.qr(rng.normal(size=(20, 20)))[0] for _ in range(20)])
    scores = orientation_scores(nonsense, samples.tensor, samples.tensor, PRODUCTS)
    assert np.abs(scores).max() < 0.8
    assert abs(scores.mean()) < 0.2


def test_unfolding_keeps_a_right_block(own: SamplePair) -> None:
    """Triple products of the true map agree with those it carries, so unfolding finds it again."""
    found = unfold(own, np.eye(9, dtype=np.float32)[None], 0.7, RULES)
    np.testing.assert_allclose(found[0], np.eye(len(found[0])), atol=1e-3)


def test_mirrored_starts_are_dropped(own: SamplePair, samples: SampledShape) -> None:
    mirrored = SamplePair(samples, samples.mirrored(), Reference())
    block = np.eye(9, dtype=np.float32)[None]
    kept = oriented_initial_maps(mirrored, block, (0.5, 1.0), RULES)
    assert (orientation_scores(kept.functional, samples.tensor, -samples.tensor, PRODUCTS) > 0).all()
    assert oriented_initial_maps(own, block, (0.5, 1.0), RULES).count == 2


def test_distortion_and_distance_of_candidates(own: SamplePair, rng: np.random.Generator) -> None:
    count = own.source.count
    identity = np.arange(count, dtype=np.int32)
    random = rng.permutation(count).astype(np.int32)
    index = np.stack([identity, random], axis=1)
    for floor in (None, RULES.distance_floor):
        values = distortions(own, index, count, floor)
        assert values[0] == pytest.approx(0.0, abs=1e-12)
        assert values[1] > 0.05
    between = map_distances(own, index, count)
    weights = own.target.prefix_weights(count)
    expected = weights @ own.source.distances[identity, random]
    np.testing.assert_allclose(between, [[0.0, expected], [expected, 0.0]], atol=1e-12)


def test_up_sampling_keeps_the_identity(own: SamplePair) -> None:
    batch = up_sample(own, np.eye(10)[None], [Level(size, 200, 250) for size in (15, 20, 30)])
    assert batch.functional.shape == (1, 30, 30)
    np.testing.assert_allclose(batch.functional[0], np.eye(30), atol=1e-4)
    np.testing.assert_array_equal(batch.index[:, 0], np.arange(200))


def test_levels_fit_small_shapes() -> None:
    shape = prepare(mesh_from_arrays(*tiny_pair().source), MIDDLE)
    pair = SamplePair.of(shape, shape, Reference())
    level = pair.fit(120, 500, 1000)
    assert (level.queries, level.points) == (162, 162)
    assert level.size == shape.basis.count
    assert pair.fit(40, 30, 60).size == 15


def test_self_maps_of_a_symmetric_shape(bumpy: Arrays) -> None:
    """An ellipsoid is carried to itself by half-turns about its axes: they are found, and compose to candidates."""
    directions, faces = shapes.icosphere(3)
    options = MIDDLE.replace({"geodesics.search_samples": 150})
    ellipsoid = prepare(mesh_from_arrays(directions * np.array([1.0, 0.7, 0.45]), faces), options)
    samples = SampledShape.of(ellipsoid)
    pair = SamplePair(samples, samples, Reference())
    found = self_maps(pair, replace(RULES, self_maps=7))
    points = ellipsoid.mesh.vertices[ellipsoid.geodesics.samples]
    size = found.shape[1]
    turns = [np.diag(signs) for signs in np.array(np.meshgrid([1, -1], [1, -1], [1, -1])).reshape(3, -1).T]
    basis = samples.functions[:, :size]
    weighted = basis * samples.weights[:, None]
    for functional in found:
        image = basis @ np.linalg.lstsq(weighted.T @ basis, weighted.T @ points, rcond=None)[0]
        carried = basis @ functional @ np.linalg.lstsq(weighted.T @ basis, weighted.T @ points, rcond=None)[0]
        nearest = min(float(np.abs(carried - image @ turn).mean()) for turn in turns)
        assert nearest < 0.05
    assert 3 <= len(found) <= 7
    candidates = composed(np.eye(size, dtype=np.float32)[None], found, found[:2])
    assert candidates.shape == (1 + len(found) + 2, size, size)
    np.testing.assert_allclose(candidates[1 : 1 + len(found)], found)


def exact(source: Shape, target: Shape, functional: NDArray[np.float64], truth: NDArray[np.int64]) -> float:
    return float((vertex_maps(source, target, functional, Reference()).target_of_source == truth).mean())


def test_a_shape_finds_itself_renumbered_and_rotated(shape: Shape, bumpy: Arrays, kernels: Backend) -> None:
    vertices, faces, new_of_old = shapes.renumbered(*rotated(bumpy, 4), 5)
    other = prepare(mesh_from_arrays(vertices, faces), MIDDLE)
    progress: list[float] = []
    found = find_isometry(shape, other, "preserving", RULES, kernels, progress.append).chosen
    assert exact(shape, other, found.functional, new_of_old) > 0.99
    assert found.orientation > 0.99
    assert progress == sorted(progress)
    assert progress[-1] == 1.0


@pytest.fixture(scope="module")
def image(bumpy: Arrays) -> tuple[Shape, NDArray[np.int64]]:
    vertices, faces, new_of_old = shapes.renumbered(*rotated(reflected(bumpy), 6), 7)
    return prepare(mesh_from_arrays(vertices, faces), MIDDLE), new_of_old


@pytest.mark.parametrize("orientation", ["reversing", "any"])
def test_the_mirror_image_is_found_on_request(
    shape: Shape, image: tuple[Shape, NDArray[np.int64]], kernels: Backend, orientation: str
) -> None:
    found = find_isometry(shape, image[0], orientation, RULES, kernels).chosen  # type: ignore[arg-type]
    assert exact(shape, image[0], found.functional, image[1]) > 0.99
    assert found.orientation < -0.99


def test_the_mirror_image_is_rejected_otherwise(
    shape: Shape, image: tuple[Shape, NDArray[np.int64]], kernels: Backend
) -> None:
    found = find_isometry(shape, image[0], "preserving", RULES, kernels).chosen
    assert exact(shape, image[0], found.functional, image[1]) < 0.1


@pytest.mark.parametrize("axes", [(1.0, 1.0, 1.0), (2.0, 1.0, 1.0)], ids=["sphere", "body of revolution"])
def test_shapes_without_one_answer_get_some_isometry(axes: tuple[float, float, float], kernels: Backend) -> None:
    """All eigenvalues come in clusters; any answer that keeps distances will do."""
    directions, faces = shapes.icosphere(2)
    options = MIDDLE.replace({"geodesics.search_samples": 120})
    first = prepare(mesh_from_arrays(directions * np.array(axes), faces), options)
    vertices, turned_faces, _ = shapes.renumbered(*rotated((directions * np.array(axes), faces), 1), 2)
    second = prepare(mesh_from_arrays(vertices, turned_faces), options)
    found = find_isometry(first, second, "preserving", RULES, kernels)
    maps = vertex_maps(first, second, found.chosen.functional, Reference())
    on_first, on_second = all_pairs(first.mesh), all_pairs(second.mesh)
    for image, here, there in (
        (maps.target_of_source, on_first, on_second),
        (maps.source_of_target, on_second, on_first),
    ):
        # Neighbours are 0.07 apart, the farthest two points 0.9 to 1.0.
        change = np.abs(there[np.ix_(image, image)] - here)
        assert change.mean() < 0.01
        assert change.max() < 0.13
    assert on_first[maps.source_of_target[maps.target_of_source], np.arange(162)].max() < 0.1
    assert found.chosen.orientation > 0.95
    assert found.margin >= 0


@pytest.mark.parametrize("swapped", [False, True])
def test_a_very_small_shape_against_a_larger_one(swapped: bool, kernels: Backend) -> None:
    """42 vertices have 14 functions where 162 have 54: candidates live in what both have."""
    pair = [prepare(mesh_from_arrays(*shapes.bumpy_sphere(level)), MIDDLE) for level in (1, 2)]
    source, target = reversed(pair) if swapped else pair
    found = find_isometry(source, target, "preserving", RULES, kernels).chosen
    assert found.functional.shape == (14, 14)
    maps = vertex_maps(source, target, found.functional, Reference())
    # The vertices of the coarser sphere are the first ones of the finer.
    coarse_to_fine = maps.source_of_target if swapped else maps.target_of_source
    fine = all_pairs(pair[1].mesh)
    assert fine[coarse_to_fine, np.arange(42)].mean() < 0.2


def test_where_no_candidate_keeps_the_orientation_the_best_still_has_others_to_beat(own: SamplePair) -> None:
    """Two mirrored maps: confidence comes from comparing them, not from there being nobody else."""
    identity = np.eye(20, dtype=np.float32)
    other = np.diag(np.where(np.arange(20) % 2, -1.0, 1.0)).astype(np.float32)
    level = own.fit(20, 200, 250)
    batch = up_sample(own, np.stack([identity, other]), [level])
    ranking = ranked(own, batch, level.points, replace(RULES, least_orientation=2.0))
    assert len(ranking.distinct) == 2
    assert np.isfinite(ranking.margin)


def test_a_mirrored_search_tells_the_orientation_of_every_map(
    shape: Shape, image: tuple[Shape, NDArray[np.int64]], kernels: Backend
) -> None:
    found = find_isometry(shape, image[0], "reversing", replace(RULES, distinct=1e-6), kernels)
    assert found.alternatives
    assert all(each.orientation < 0 for each in (found.chosen, *found.alternatives))
