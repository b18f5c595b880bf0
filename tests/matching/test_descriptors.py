"""Descriptors of a user: what is read of them, and what they decide."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray
from prepared import MIDDLE, PreparedPair

from clalign.engine import Backend
from clalign.errors import InputError, OptionError
from clalign.matching.pair import match
from clalign.mesh.descriptors import descriptors_of
from clalign.mesh.mesh import Mesh, mesh_from_arrays
from clalign.options import Options
from clalign.refinement.zoomout import BoundSpectra
from clalign.search.batch import SamplePair, up_sample
from clalign.search.score import map_scores
from clalign.search.tips import given_candidates

OPTIONS = MIDDLE.replace({"geodesics.search_samples": 150, "alignment.outer_iterations": 1})


@pytest.fixture(scope="module")
def ellipsoids() -> tuple[Mesh, Mesh, NDArray[np.int64]]:
    """A body that half-turns about three axes carry to itself, and a renumbered copy."""
    directions, faces = shapes.icosphere(3)
    vertices = directions * [1.0, 0.7, 0.45]
    other, other_faces, new_of_old = shapes.renumbered(vertices, faces, 3)
    return mesh_from_arrays(vertices, faces, "one"), mesh_from_arrays(other, other_faces, "other"), new_of_old


@pytest.mark.filterwarnings("ignore::clalign.errors.ConfidenceWarning")
@pytest.mark.parametrize("turn", [[1, -1, -1], [-1, -1, 1]])
def test_descriptors_settle_a_symmetry(ellipsoids: tuple[Mesh, Mesh, NDArray[np.int64]], turn: list[int]) -> None:
    """Of four maps they take the one that carries them along, and are sure of it."""
    source, target, new_of_old = ellipsoids
    points = source.file_positions()
    given = (points * turn @ [[0.5], [0.6], [0.9]], target.file_positions() @ [[0.5], [0.6], [0.9]])
    result = match(source, target, OPTIONS, descriptors=given)
    expected = new_of_old[np.linalg.norm(points[:, None] * turn - points[None], axis=2).argmin(axis=1)]
    places = target.vertices
    assert np.linalg.norm(places[result.target_of_source] - places[expected], axis=1).mean() < 0.05
    assert result.confidence > 0.5


def with_given(pair: PreparedPair, weight: float, noise: float = 0.0) -> PreparedPair:
    """The pair with coordinates of the source as descriptors of both shapes."""
    values = pair.source.mesh.file_positions()
    other = values[pair.truth.source_of_target]
    other = other + noise * np.random.default_rng(5).standard_normal(other.shape)
    given = descriptors_of((values, other), pair.source.mesh, pair.target.mesh, weight)
    assert given is not None
    source, target = (replace(shape, given=each) for shape, each in zip(pair[:2], given, strict=True))
    return pair._replace(source=source, target=target)


def test_the_score_counts_differences_by_their_weight(middle: PreparedPair, kernels: Backend) -> None:
    """At the weight 1/8 a score is that without descriptors times difference and floor, at 1/4 times their square."""
    rules = Options().rules.search
    pair = SamplePair.of(*middle[:2], kernels)
    level = pair.fitted(rules.joined)
    turned = np.diag([1.0, -1.0, *np.ones(level.size - 2)])
    batch = up_sample(pair, np.stack([np.eye(level.size), turned]), [level])
    plain = map_scores(pair, batch, level.points, rules)
    factors = []
    for weight in (0.125, 0.25):
        given = SamplePair.of(*with_given(middle, weight, noise=0.1)[:2], kernels)
        factors.append(map_scores(given, batch, level.points, rules) / plain)
    np.testing.assert_allclose(factors[1], factors[0] ** 2, rtol=1e-6)
    weights = pair.target.prefix_weights(level.queries)
    own = SamplePair.of(*with_given(middle, 0.125, noise=0.1)[:2], kernels)
    assert own.source.given is not None
    assert own.target.given is not None
    differences = own.source.given.values[batch.index[:, 0]] - own.target.given.values[: level.queries]
    expected = np.sqrt(weights @ np.square(differences).sum(axis=1)) + rules.given_floor
    assert factors[0][0] == pytest.approx(expected)


def test_descriptors_alone_start_a_candidate(middle: PreparedPair, kernels: Backend) -> None:
    rules = Options().rules.search
    assert not len(given_candidates(SamplePair.of(*middle[:2], kernels), rules))
    pair = SamplePair.of(*with_given(middle, 1.0)[:2], kernels)
    (functional,) = given_candidates(pair, rules)
    level = pair.fitted(rules.joined)
    batch = up_sample(pair, functional[None], [level])
    samples = middle.source.geodesics.samples[batch.index[:, 0]]
    truth = middle.truth.source_of_target[middle.target.geodesics.samples[: level.queries]]
    places = middle.source.mesh.vertices
    assert np.linalg.norm(places[samples] - places[truth], axis=1).mean() < 0.1


def test_they_stand_beside_the_functions_with_their_share(middle: PreparedPair, reference: Backend) -> None:
    """Weight 1: the variances of the columns beside sum to that of the embedding; without any nothing is added."""
    pair = with_given(middle, 1.0)
    spectra = BoundSpectra.of(pair.source.scale_invariant, pair.target.scale_invariant, reference)
    functional = np.eye(pair.source.scale_invariant.count)
    without, _ = spectra.weighted(functional, reference)
    within, _ = spectra.with_given(*pair[:2]).weighted(functional, reference)
    count = without.shape[1]
    np.testing.assert_array_equal(within[:, :count], without)
    assert within.shape[1] == count + 3
    added = np.square(within[:, count:]).sum(axis=1).mean()
    assert added == pytest.approx(count, rel=0.2)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (lambda x, y: (x[:-1], y), "descriptors of the source: 641 rows, and one has 642 vertices"),
        (lambda x, y: (x, y[:, :1]), "2 columns for the source and 1 for the target"),
        (
            lambda x, y: (x, np.where(np.arange(642)[:, None] == 7, np.nan, y)),
            "of the target: 1 rows hold values that are",
        ),
        (lambda x, y: (np.zeros_like(x), np.zeros_like(y)), "all rows are the same"),
        (lambda x, y: (x.astype(str), y), "of the source: expected numbers"),
        (lambda x, y: x, r"expected two arrays \(F_x, F_y\)"),
        (lambda x, y: (x[:, :0], y[:, :0]), "expected numbers"),
    ],
)
def test_what_does_not_fit_is_refused(ellipsoids, changed, words) -> None:
    source, target, _ = ellipsoids
    given = changed(source.file_positions()[:, :2], target.file_positions()[:, :2])
    with pytest.raises(InputError, match=words):
        match(source, target, OPTIONS, descriptors=given)


def test_weights(ellipsoids) -> None:
    source, target, _ = ellipsoids
    given = source.file_positions(), target.file_positions()
    with pytest.raises(InputError, match="descriptor_weight must not be negative"):
        descriptors_of(given, source, target, -1.0)
    assert descriptors_of(given, source, target, 0.0) is None
    with pytest.raises(OptionError, match="descriptors have no part in"):
        match(source, target, Options.preset("paper"), descriptors=given)
    # Whatever the unit and the origin, the same is left.
    first, second = (
        descriptors_of((scale * given[0] + 3.0, scale * given[1] + 3.0), source, target, 1.0) for scale in (1.0, 100.0)
    )
    assert first is not None
    assert second is not None
    np.testing.assert_allclose(first[0].values, second[0].values, atol=1e-9)
