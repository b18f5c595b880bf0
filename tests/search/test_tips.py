"""Candidates from matched extremities, on a ball with five limbs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray
from prepared import MIDDLE

from clalign.engine import Backend, Reference
from clalign.geometry.shape import Shape, prepare
from clalign.mesh.mesh import mesh_from_arrays
from clalign.refinement.zoomout import vertex_maps
from clalign.rules import SearchRules, TipRules
from clalign.search.batch import SampledShape, SamplePair
from clalign.search.find import find_isometry
from clalign.search.tips import assignments, tip_candidates, tip_initial_maps, tips

RULES = SearchRules()
LENGTHS = (1.4, 1.2, 1.6, 1.0, 1.8)
OTHERS = (1.7, 0.8, 1.1, 1.4, 1.3)
"""Limbs of quite other lengths, in another order."""

OPTIONS = MIDDLE.replace({"geodesics.search_samples": 400})


def prepared(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Shape:
    return prepare(mesh_from_arrays(vertices, faces), OPTIONS)


def found_tips(shape: Shape, rules: TipRules = RULES.tips) -> NDArray[np.int64]:
    return tips(shape.geodesics.distances, shape.geodesics.weights, rules)


def limbs(places: NDArray[np.float64]) -> list[int]:
    """Return which limb some points lie on; -1 is none. `places` are theirs before any motion."""
    along = shapes.LIMBS / np.linalg.norm(shapes.LIMBS, axis=1, keepdims=True)
    cosines = places @ along.T / np.linalg.norm(places, axis=1, keepdims=True)
    return [int(row.argmax()) if row.max() > 0.95 else -1 for row in cosines]


@pytest.fixture(scope="module")
def body() -> Shape:
    return prepared(*shapes.limbed_sphere(LENGTHS))


@pytest.fixture(scope="module")
def other() -> tuple[Shape, NDArray[np.int64]]:
    """The body with limbs of other lengths, renumbered."""
    vertices, faces, new_of_old = shapes.renumbered(*shapes.limbed_sphere(OTHERS), 5)
    return prepared(vertices, faces), new_of_old


def test_tips_are_the_ends_of_the_limbs_the_farthest_first(body: Shape) -> None:
    found = body.geodesics.samples[found_tips(body)]
    assert limbs(shapes.limbed_sphere(LENGTHS)[0][found]) == list(np.argsort(LENGTHS)[::-1])
    assert len(found_tips(body, TipRules(most=3))) == 3


def test_rules_of_tips_mean_what_they_say(body: Shape, other: tuple[Shape, NDArray[np.int64]]) -> None:
    assert len(found_tips(body, TipRules(radius=10.0))) == 1
    assert len(found_tips(body, TipRules(radius=0.02, most=100))) > 5
    pair = SampledShape.of(body), SampledShape.of(other[0])
    for rules in (TipRules(assigned=3, tried=7), TipRules(assigned=4, tried=50)):
        own, others = assignments(*pair, rules)
        assert own.shape == others.shape == (rules.tried, rules.assigned)
        assert all(len(set(row)) == rules.assigned for row in own)
    # Where all distances are nearer than the least one, all assignments cost the same, and the first are taken.
    own, _ = assignments(*pair, TipRules(assigned=3, tried=5, least_distance=100.0))
    ordered = found_tips(body)
    assert [set(row) for row in own] == 5 * [set(ordered[:3])]


def test_tips_do_not_depend_on_numbers_place_and_size(body: Shape) -> None:
    vertices, faces = shapes.limbed_sphere(LENGTHS)
    rotation = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    moved, other_faces, new_of_old = shapes.renumbered(1000.0 * vertices @ rotation.T + 7.0, faces, 4)
    copy = prepared(moved, other_faces)
    there = found_tips(copy)
    own = found_tips(body)
    np.testing.assert_array_equal(copy.geodesics.samples[there], new_of_old[body.geodesics.samples[own]])


def test_the_right_assignment_is_among_the_first(body: Shape, other: tuple[Shape, NDArray[np.int64]]) -> None:
    """Of 120; with itself it is the very first, and costs nothing."""
    source, target = SampledShape.of(body), SampledShape.of(other[0])
    own, same = assignments(source, source, TipRules())
    np.testing.assert_array_equal(own[0], same[0])
    assert own.shape == (120, 5)
    places = shapes.limbed_sphere(LENGTHS)[0], shapes.limbed_sphere(OTHERS)[0][np.argsort(other[1])]
    right = [
        limbs(places[0][body.geodesics.samples[x]]) == limbs(places[1][other[0].geodesics.samples[y]])
        for x, y in zip(*assignments(source, target, TipRules()), strict=True)
    ]
    assert sum(right) == 1
    assert right.index(True) < 20


def test_first_maps_lead_to_the_nearest_in_distances_to_tips(
    body: Shape, other: tuple[Shape, NDArray[np.int64]], kernels: Backend
) -> None:
    """The product that searches all assignments at once does what a loop over them does."""
    source, target = SampledShape.of(body), SampledShape.of(other[0])
    rules = replace(TipRules(), tried=7)
    found = tip_initial_maps(SamplePair(source, target, kernels), rules)
    queries, points = found.index.shape[0], min(rules.first.points, source.count)
    for candidate, (x, y) in enumerate(zip(*assignments(source, target, rules), strict=True)):
        of_source = source.distances[:, x] / (source.weights @ source.distances[:, x])
        of_target = target.distances[:, y] / (target.weights @ target.distances[:, y])
        squares = np.sum((of_target[:queries, None] - of_source[None, :points]) ** 2, axis=2)
        reached = squares[np.arange(queries), found.index[:, candidate]]
        np.testing.assert_allclose(reached, squares.min(axis=1), atol=1e-5)


def test_limbs_of_other_lengths_are_matched(
    body: Shape, other: tuple[Shape, NDArray[np.int64]], kernels: Backend
) -> None:
    """Every limb goes to its own, in one of the candidates from tips and in what the search takes."""
    target, new_of_old = other
    pair = SamplePair.of(body, target, kernels)
    places = shapes.limbed_sphere(OTHERS)[0][np.argsort(new_of_old)]
    ends = body.geodesics.samples[found_tips(body)]

    def reached(functional: NDArray[np.floating]) -> list[int]:
        return limbs(places[vertex_maps(body, target, functional.astype(float), Reference()).target_of_source[ends]])

    candidates = tip_candidates(pair, RULES)
    right = list(np.argsort(LENGTHS)[::-1])
    assert 0 < len(candidates) <= RULES.tips.kept
    assert right in [reached(each) for each in candidates]
    chosen = find_isometry(body, target, "preserving", RULES, kernels).chosen.functional
    matched = vertex_maps(body, target, chosen, Reference()).target_of_source
    # Any wrong isometry is off by 0.35 on average.
    assert np.linalg.norm(target.mesh.vertices[matched] - target.mesh.vertices[new_of_old], axis=1).mean() < 0.05


def test_a_ball_has_no_tips_to_start_from(kernels: Backend) -> None:
    ball = prepared(*shapes.icosphere(2))
    pair = SamplePair.of(ball, ball, kernels)
    few = replace(RULES, tips=replace(RULES.tips, most=2))
    assert tip_candidates(pair, few).shape[0] == 0
    assert tip_initial_maps(pair, few.tips).index.shape[1] == 0


def test_what_trees_find_stays_as_they_found_it(body: Shape, kernels: Backend) -> None:
    """Tips that lead to the same map add nothing: the chosen one is the trees', bit by bit."""
    without = replace(RULES, tips=replace(RULES.tips, most=2))
    alone = find_isometry(body, body, "preserving", without, kernels)
    both = find_isometry(body, body, "preserving", RULES, kernels)
    np.testing.assert_array_equal(both.chosen.functional, alone.chosen.functional)
    assert both.chosen.score == alone.chosen.score
