"""The objective: its gradient, its variants, and the fast way against the literal one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from dense_losses import DenseTerms
from numpy.typing import NDArray
from prepared import MIDDLE, SMALL, Bound, PreparedPair, bound, prepared_pair, tiny_pair
from shapes import Pair

from clalign.alignment import soft_map
from clalign.alignment.losses import CycleLoss, DistortionLoss, FixedCorrespondence
from clalign.alignment.objective import Evaluation, Objective
from clalign.alignment.soft_map import MomentsSoftMap, StreamedSoftMap, evaluation_cost, streaming_pays
from clalign.engine import Backend, Reference
from clalign.geometry.shape import Shape
from clalign.options import Options

VARIANTS: dict[str, dict[str, Any]] = {
    "plain": {},
    "cycle": {"alignment.cycle": True},
    "one-sided": {"alignment.sides": "one"},
    "one-sided cycle": {"alignment.sides": "one", "alignment.cycle": True},
    "uniform": {"alignment.weights": "uniform"},
    "uniform cycle": {"alignment.weights": "uniform", "alignment.cycle": True},
    "unitarity": {"alignment.unitarity": 3.0},
    "fixed denominator": {"alignment.denominator": "fixed"},
    "differentiated denominator": {"alignment.denominator": "differentiated"},
    "fixed one-sided": {"alignment.denominator": "fixed", "alignment.sides": "one"},
    "all vertices": {"alignment.samples": 0},
    "dense R": {"alignment.band": "none"},
    "diagonal R": {"alignment.band": "diagonal"},
    "literal": {},
    "literal cycle": {"alignment.cycle": True},
    "literal uniform cycle": {
        "alignment.cycle": True,
        "alignment.weights": "uniform",
        "alignment.samples": 0,
    },
}


def started(
    pair: Bound, rng: np.random.Generator, weight: float = 200.0
) -> tuple[FixedCorrespondence, NDArray[np.float64]]:
    """Return a fixed correspondence and a point beside its start, so that no term is stationary."""
    fixed = pair.problem.fix(pair.rotation, pair.truth.target_of_source, weight)
    x = pair.problem.pack(pair.rotation)
    return fixed, x + 0.02 * rng.normal(size=x.size)


def soft_map_of(pair: Bound) -> object:
    """Return the soft map from X to Y of Eq. 22."""
    terms = pair.problem.distortion_terms
    assert isinstance(terms, DistortionLoss)
    return terms._soft_map


@pytest.fixture
def streaming(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Choose the form of the soft map by the parameter, whatever it costs."""
    monkeypatch.setattr(soft_map, "streaming_pays", lambda *_: request.param)


STREAMED = [name for name, changes in VARIANTS.items() if "alignment.cycle" not in changes and name != "literal"]
BOTH_FORMS = [*((name, False) for name in VARIANTS), *((name, True) for name in STREAMED)]


@pytest.mark.parametrize(("name", "streaming"), BOTH_FORMS, indirect=["streaming"])
@pytest.mark.usefixtures("streaming")
def test_gradient_is_the_slope_of_the_value(
    bind_small: Callable[..., Bound], rng: np.random.Generator, name: str
) -> None:
    pair = bind_small(VARIANTS[name], dense=name.startswith("literal"))
    fixed, x = started(pair, rng)
    gradient = pair.problem.value_and_gradient(x, fixed).gradient
    assert np.linalg.norm(gradient) > 1e-6
    step = 1e-5
    for _ in range(3):
        direction = rng.normal(size=x.size)
        ahead, behind = (
            pair.problem.value_and_gradient(x + sign * step * direction, fixed).total for sign in (1.0, -1.0)
        )
        slope = (ahead - behind) / (2 * step)
        assert slope == pytest.approx(gradient @ direction, rel=1e-5, abs=1e-7 * np.linalg.norm(gradient))


@pytest.mark.parametrize("name", STREAMED)
def test_both_forms_of_the_soft_map_give_the_same_objective(
    bind_small: Callable[..., Bound], monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    def evaluate(streamed: bool) -> Evaluation:
        monkeypatch.setattr(soft_map, "streaming_pays", lambda *_: streamed)
        pair = bind_small(VARIANTS[name])
        assert isinstance(soft_map_of(pair), StreamedSoftMap if streamed else MomentsSoftMap)
        fixed, x = started(pair, np.random.default_rng(3))
        return pair.problem.value_and_gradient(x, fixed)

    streamed, quadratic = evaluate(True), evaluate(False)
    assert streamed.terms["unsup"] == pytest.approx(quadratic.terms["unsup"], rel=1e-10)
    error = np.linalg.norm(streamed.gradient - quadratic.gradient)
    assert error <= 1e-10 * np.linalg.norm(quadratic.gradient)


def test_the_form_of_the_soft_map_is_the_one_of_fewer_operations(
    small: PreparedPair, monkeypatch: pytest.MonkeyPatch
) -> None:
    # With 50 samples, 16 functions and rank 20: 2 · 136 · 20 operations a row against 162 · (3 · 16 + 2 · 20).
    assert evaluation_cost(50, 162, 16, 20) == (50 * 2 * 136 * 20, 50 * 162 * (3 * 16 + 2 * 20))
    assert isinstance(soft_map_of(bound(small, SMALL)), MomentsSoftMap)
    many = SMALL.replace({"spectrum.basis": 50, "spectrum.refinement": 50, "spectrum.scale_invariant": 60})
    prepared = prepared_pair(tiny_pair(), many)
    cycle = bound(prepared, many.replace({"alignment.cycle": True})).problem.distortion_terms
    assert isinstance(cycle, CycleLoss)
    assert isinstance(cycle._distortion._soft_map, MomentsSoftMap)
    monkeypatch.setattr(Reference, "packed_moments", lambda *_: pytest.fail("moments that nobody reads"))
    assert isinstance(soft_map_of(bound(prepared, many)), StreamedSoftMap)


def test_streaming_pays_for_many_functions_and_few_vertices() -> None:
    """Break-even of a match's usual sizes, k = 120 and r = 50: 1,578 vertices, however many samples there are."""
    for rows in (1, 1000):
        assert streaming_pays(rows, 1578, 120, 50)
        assert not streaming_pays(rows, 1579, 120, 50)
    assert not streaming_pays(1000, 6890, 200, 100)


@pytest.mark.parametrize(
    ("name", "streaming"),
    [
        *((name, False) for name in ("plain", "cycle", "one-sided", "uniform cycle", "fixed denominator", "unitarity")),
        ("plain", True),
        ("uniform", True),
    ],
    indirect=["streaming"],
)
@pytest.mark.usefixtures("streaming")
def test_single_precision_kernels_agree_with_the_reference(
    bind_small: Callable[..., Bound], rng: np.random.Generator, kernels: Backend, name: str
) -> None:
    exact, single = bind_small(VARIANTS[name]), bind_small(VARIANTS[name], kernels)
    fixed, x = started(exact, rng)
    truth = exact.problem.value_and_gradient(x, fixed)
    fixed, _ = started(single, rng)
    result = single.problem.value_and_gradient(x, fixed)
    assert result.total == pytest.approx(truth.total, rel=1e-3)
    assert result.terms.keys() == truth.terms.keys()
    for term, value in truth.terms.items():
        assert result.terms[term] == pytest.approx(value, rel=1e-3, abs=1e-6), term
    assert np.linalg.norm(result.gradient - truth.gradient) <= 1e-3 * np.linalg.norm(truth.gradient)
    np.testing.assert_allclose(
        single.problem.functional_map(single.rotation), exact.problem.functional_map(exact.rotation), atol=1e-3
    )


@pytest.mark.parametrize("dense", [False, True])
def test_a_vertex_without_functions_leaves_the_gradient_finite(
    bind_small: Callable[..., Bound], rng: np.random.Generator, dense: bool
) -> None:
    """A row φ_j = 0 gives c_j = 0 and s_j = 0: its column of the soft map is 0, and so is its slope."""
    pair = bind_small({"alignment.cycle": True}, dense=dense)
    bound_pair = pair.problem
    basis = bound_pair.source.basis.copy()
    basis[bound_pair.factors.vertices[3]] = 0
    arguments = replace(bound_pair.source, basis=basis), bound_pair.target, bound_pair.factors
    shared = bound_pair.band, bound_pair.backend, bound_pair.options, bound_pair.rules
    terms = bound_pair.distortion_terms
    literal = DenseTerms(*arguments, terms.distances, bound_pair.backend) if isinstance(terms, DenseTerms) else None
    problem = Objective(*arguments, *shared, distortion_terms=literal)
    fixed, x = started(pair._replace(problem=problem), rng)
    evaluation = problem.value_and_gradient(x, fixed)
    assert np.isfinite(evaluation.total)
    assert np.isfinite(evaluation.gradient).all()


def test_an_evaluation_moves_only_its_point_and_its_gradient(
    bind_small: Callable[..., Bound], kernels: Backend, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    pair = bind_small({"alignment.cycle": True}, kernels)
    fixed, x = started(pair, rng)
    moved: list[tuple[str, int]] = []
    array, read = type(kernels).array, type(kernels).read
    monkeypatch.setattr(type(kernels), "array", lambda self, v: moved.append(("up", np.size(v))) or array(self, v))
    monkeypatch.setattr(type(kernels), "read", lambda self, v: moved.append(("down", v[0].size)) or read(self, v))
    pair.problem.value_and_gradient(x, fixed)
    pair.problem.value_and_gradient(x, fixed)
    # What the first evaluation uploads for good (tables of the band) is not uploaded again.
    assert moved[-2:] == [("up", x.size), ("down", x.size)]


def human_options() -> Options:
    return Options().replace(
        {
            "spectrum.basis": 60,
            "spectrum.refinement": 60,
            "spectrum.scale_invariant": 80,
            "geodesics.factor_samples": 100,
            "geodesics.search_samples": 300,
            "alignment.samples": 300,
        }
    )


@pytest.fixture(scope="module")
def human(human_pair: Pair) -> PreparedPair:
    return prepared_pair(human_pair, human_options())


def test_low_rank_distances_agree_with_the_literal_loss(human: PreparedPair, rng: np.random.Generator) -> None:
    """Two poses of a human at 1,500 vertices, N = 100 samples: l_unsup and l_cyc within 2 %."""
    options = human_options().replace({"alignment.cycle": True})
    low_rank, literal = bound(human, options), bound(human, options, dense=True)
    fixed, x = started(low_rank, rng)
    fast, slow = (pair.problem.value_and_gradient(x, fixed) for pair in (low_rank, literal))
    assert fast.terms["unsup"] == pytest.approx(slow.terms["unsup"], rel=0.02)
    assert fast.terms["cycle"] == pytest.approx(slow.terms["cycle"], rel=0.02)
    assert fast.terms["align"] == pytest.approx(slow.terms["align"], rel=1e-9)
    assert np.linalg.norm(fast.gradient - slow.gradient) <= 0.05 * np.linalg.norm(slow.gradient)


def test_literal_loss_is_equation_22(small: PreparedPair, bind_small: Callable[..., Bound]) -> None:
    """From the formulas as printed: |Psi C Phi^T|, columns normalised, squared; uniform weights."""
    pair = bind_small({"alignment.weights": "uniform", "alignment.samples": 0}, dense=True)
    problem = pair.problem
    assert isinstance(problem.distortion_terms, DenseTerms)
    distances = problem.distortion_terms.distances
    fixed = problem.fix(pair.rotation, pair.truth.target_of_source, 1.0)
    reported = problem.value_and_gradient(problem.pack(pair.rotation), fixed).terms["unsup"]
    basis = [shape.basis.functions[:, : SMALL.spectrum.basis] for shape in (small.source, small.target)]
    soft = np.abs(basis[1] @ problem.functional_map(pair.rotation) @ basis[0].T)
    soft = (soft / np.linalg.norm(soft, axis=0)) ** 2
    np.testing.assert_allclose(soft.sum(axis=0), 1.0)
    residual = distances.source - soft.T @ distances.target @ soft
    assert reported == pytest.approx(np.sum(residual**2) / len(residual) ** 2, rel=1e-9)


def test_unitarity_is_equation_23(bind_small: Callable[..., Bound], rng: np.random.Generator) -> None:
    pair = bind_small({"alignment.unitarity": 0.0})
    fixed, x = started(pair, rng)
    evaluation = pair.problem.value_and_gradient(x, fixed)
    rotation = pair.problem.unpack(x)
    size = len(rotation)
    expected = np.sum((rotation @ rotation.T - np.eye(size)) ** 2) / size**2
    assert evaluation.terms["unitarity"] == pytest.approx(expected, rel=1e-10)
    # Reported, not part of the sum.
    terms = evaluation.terms
    assert evaluation.total == pytest.approx(terms["align"] + 200.0 * terms["unsup"], rel=1e-12)


def test_alignment_term_is_equation_21(bind_small: Callable[..., Bound], rng: np.random.Generator) -> None:
    pair = bind_small({})
    problem = pair.problem
    fixed, x = started(pair, rng)
    rotation = problem.unpack(x)
    turned = problem.source.scale_invariant @ rotation
    carried = problem.target.scale_invariant[pair.truth.target_of_source] @ rotation.T
    mass = problem.source.loss_weights[:, None]
    expected = np.sum(mass * (turned - carried) ** 2) / np.sum(mass * carried**2)
    assert problem.value_and_gradient(x, fixed).terms["align"] == pytest.approx(expected, rel=1e-9)


def test_the_cycle_term_halves_the_weight(bind_small: Callable[..., Bound], rng: np.random.Generator) -> None:
    pair = bind_small({"alignment.cycle": True, "alignment.unitarity": 0.0})
    fixed, x = started(pair, rng, weight=70.0)
    evaluation = pair.problem.value_and_gradient(x, fixed)
    terms = evaluation.terms
    assert evaluation.total == pytest.approx(terms["align"] + 35.0 * (terms["unsup"] + terms["cycle"]), rel=1e-12)


def test_an_isometry_of_a_shape_with_itself_has_no_alignment_error(bind_small: Callable[..., Bound]) -> None:
    """The identity on R leaves Φ̃ and Ψ̃ as they are; for one shape they are equal."""
    pair = bind_small({})
    source = pair.problem.source
    same = pair.problem
    problem = Objective(source, source, same.factors, same.band, same.backend, same.options, same.rules)
    rotation = np.eye(problem.band.size)
    fixed = problem.fix(rotation, np.arange(len(source.basis)), 200.0)
    evaluation = problem.value_and_gradient(problem.pack(rotation), fixed)
    assert abs(evaluation.terms["align"]) < 1e-12
    np.testing.assert_allclose(problem.functional_map(rotation), np.eye(source.basis.shape[1]), atol=1e-3)


def test_shapes_are_left_as_they_were(middle: PreparedPair) -> None:
    """Values flow one way: evaluating changes nothing that was passed in."""

    def fingerprint(shape: Shape) -> tuple[float, ...]:
        return (float(np.abs(shape.basis.functions).sum()), float(np.abs(shape.scale_invariant.functions).sum()))

    before = fingerprint(middle.source), fingerprint(middle.target)
    pair = bound(middle, MIDDLE)
    fixed = pair.problem.fix(pair.rotation, pair.truth.target_of_source, 200.0)
    pair.problem.value_and_gradient(pair.problem.pack(pair.rotation), fixed)
    assert (fingerprint(middle.source), fingerprint(middle.target)) == before


def test_no_more_functions_are_used_than_there_are_descriptors(bind_small: Callable[..., Bound]) -> None:
    """Otherwise α αᵀ is singular, and single precision turns the least squares into noise."""
    problem, rotation, truth = bind_small({"spectrum.basis": 16, "spectrum.scale_invariant": 12})
    assert problem.source.basis.shape[1] == problem.target.basis.shape[1] == 12
    fixed = problem.fix(rotation, truth.target_of_source, 50.0)
    assert np.isfinite(problem.value_and_gradient(problem.pack(rotation), fixed).gradient).all()
