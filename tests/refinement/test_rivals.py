"""The choice among candidates that were grown, on a ball with five limbs and on a body with symmetries."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray
from prepared import MIDDLE, PreparedPair, true_functional_map
from scipy.spatial import cKDTree

from clalign.engine import Backend
from clalign.geometry.shape import Shape, prepare
from clalign.matching.loop import Clock, run_stages
from clalign.matching.stages import STAGES
from clalign.matching.state import MatchState, required
from clalign.mesh.mesh import mesh_from_arrays
from clalign.options import Options
from clalign.refinement.rivals import choose_grown, in_doubt, stretch_energy
from clalign.rules import RivalRules, Rules
from clalign.search.find import Candidate, SearchResult, find_isometry

RULES = Rules()
OPTIONS = MIDDLE.replace({"geodesics.search_samples": 400})


def limbed(lengths: tuple[float, ...], seed: int) -> tuple[Shape, NDArray[np.int64]]:
    """Return a prepared ball with limbs, renumbered, and the new number of every old vertex."""
    vertices, faces, new_of_old = shapes.renumbered(*shapes.limbed_sphere(lengths), seed)
    return prepare(mesh_from_arrays(vertices, faces), OPTIONS), new_of_old


@pytest.fixture(scope="module")
def pair() -> tuple[Shape, Shape, NDArray[np.int64]]:
    """Two bodies with limbs of other lengths, and the truth."""
    source, of_source = limbed((1.4, 1.2, 1.6, 1.0, 1.8), 1)
    target, of_target = limbed((1.0, 1.2, 1.2, 1.4, 1.4), 2)
    return source, target, of_target[np.argsort(of_source)]


def swapped_limbs(shape: Shape) -> NDArray[np.int64]:
    """Return the map of a limbed ball to itself that exchanges two limbs and keeps the rest."""
    directions = shape.mesh.vertices - shape.mass @ shape.mesh.vertices
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    along = shapes.LIMBS / np.linalg.norm(shapes.LIMBS, axis=1, keepdims=True)
    axis = along[0] + along[1]
    axis /= np.linalg.norm(axis)
    half_turn = 2.0 * np.outer(axis, axis) - np.eye(3)
    moved = (directions @ along[:2].T > 0.8).any(axis=1)
    _, nearest = cKDTree(directions).query(directions[moved] @ half_turn.T)
    index = np.arange(len(directions))
    index[moved] = nearest
    return index


def test_what_keeps_lengths_has_no_energy_and_a_swapped_limb_tears() -> None:
    rules = RivalRules()
    body, new_of_old = limbed((1.4, 1.2, 1.6, 1.0, 1.8), 3)
    same = prepare(mesh_from_arrays(*shapes.limbed_sphere((1.4, 1.2, 1.6, 1.0, 1.8))), OPTIONS)
    assert stretch_energy(same, body, new_of_old, rules) == pytest.approx(0.0, abs=1e-12)
    vertices, faces = shapes.limbed_sphere((1.5, 1.5, 1.5, 1.0, 1.8))
    equal = prepare(mesh_from_arrays(vertices, faces), OPTIONS)
    bent = prepare(mesh_from_arrays(shapes.bent(vertices, 0.3), faces), OPTIONS)
    torn = stretch_energy(equal, equal, swapped_limbs(equal), rules)
    assert torn > 3 * stretch_energy(equal, bent, np.arange(equal.mesh.n_vertices), rules) > 0
    assert torn > stretch_energy(equal, equal, swapped_limbs(equal), replace(rules, largest_stretch=2.0)) > 0


def test_what_collapses_has_energy_the_other_way(rng: np.random.Generator) -> None:
    body = limbed((1.4, 1.2, 1.6, 1.0, 1.8), 3)[0]
    count = body.mesh.n_vertices
    few = rng.choice(count, 5)
    assert stretch_energy(body, body, np.full(count, few[0]), RivalRules()) == 0.0
    assert stretch_energy(body, body, few[rng.integers(0, 5, count)], RivalRules()) > 1.0


def candidate(functional: NDArray[np.float64], score: float) -> Candidate:
    return Candidate(functional, score, 0.9, 0.0)


def test_the_right_one_of_two_is_chosen_whatever_the_scores_of_the_search(
    pair: tuple[Shape, Shape, NDArray[np.int64]], kernels: Backend
) -> None:
    source, target, truth = pair
    found = find_isometry(source, target, "preserving", RULES.search, kernels)
    right = true_functional_map(source.basis, target.basis, np.argsort(truth), 60)
    wrong = found.alternatives[0].functional
    doubted = SearchResult(candidate(wrong, 1e-4), (candidate(right, 2e-4),), 0.1)
    assert in_doubt(doubted, 1.0, RULES)
    judged = choose_grown(source, target, doubted, 1.0, RULES, kernels)
    apart = np.linalg.norm(judged.chosen.functional - right), np.linalg.norm(judged.chosen.functional - wrong)
    assert apart[0] < 0.7 * apart[1]
    assert len(judged.alternatives) == 1
    assert judged.chosen.orientation > 0.9
    assert judged.alternatives[0].distance > 0.2
    assert judged.confidence > 0.3


def test_rivals_that_grow_into_one_map_are_one(
    pair: tuple[Shape, Shape, NDArray[np.int64]], kernels: Backend, rng: np.random.Generator
) -> None:
    source, target, truth = pair
    right = true_functional_map(source.basis, target.basis, np.argsort(truth), 60)
    disturbed = [right + 0.05 * rng.normal(size=right.shape) for _ in range(3)]
    doubted = SearchResult(candidate(right, 1e-4), tuple(candidate(each, 1.1e-4) for each in disturbed), 0.1)
    judged = choose_grown(source, target, doubted, 1.0, RULES, kernels)
    assert judged.alternatives == ()
    assert judged.confidence == 1.0


def searched(source: Shape, target: Shape, options: Options, backend: Backend) -> MatchState:
    stages = [stage for stage in STAGES if stage.name in ("search", "choice")]
    return run_stages(MatchState(source, target, options, options.spectrum.xi), backend, Clock(), stages)


def test_an_exact_copy_of_a_symmetric_body_has_no_confidence(kernels: Backend) -> None:
    """Three half-turns are as exact as the identity, and are listed."""
    directions, faces = shapes.icosphere(3)
    vertices = directions * np.array([1.0, 0.7, 0.45])
    source = prepare(mesh_from_arrays(vertices, faces), OPTIONS)
    target = prepare(mesh_from_arrays(*shapes.renumbered(vertices, faces, 6)[:2]), OPTIONS)
    state = searched(source, target, OPTIONS, kernels)
    found = required(state.found)
    assert state.rivals_grown
    assert found.confidence == 0.0
    assert sum(each.distance > 0.2 and each.orientation > 0.9 for each in found.alternatives) >= 3


def test_an_exact_copy_of_a_body_without_symmetry_is_beyond_doubt(kernels: Backend) -> None:
    source, target = limbed((1.4, 1.2, 1.6, 1.0, 1.8), 1)[0], limbed((1.4, 1.2, 1.6, 1.0, 1.8), 2)[0]
    assert required(searched(source, target, OPTIONS, kernels).found).confidence > 0.9


def test_an_ordinary_pair_is_left_as_the_search_found_it(middle: PreparedPair, kernels: Backend) -> None:
    found = find_isometry(middle.source, middle.target, "preserving", RULES.search, kernels)
    state = searched(middle.source, middle.target, OPTIONS, kernels)
    assert found.confidence > RULES.rivals.doubtful
    assert not state.rivals_grown
    np.testing.assert_array_equal(required(state.found).chosen.functional, found.chosen.functional)
    assert required(state.found).margin == found.margin
