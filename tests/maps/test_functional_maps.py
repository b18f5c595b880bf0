"""Functional maps and point maps of shapes whose true map is known."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from prepared import PreparedPair, true_functional_map

from clalign.geometry.spectra import Spectrum
from clalign.maps.functional_maps import (
    functional_point_maps,
    polar_factor,
    singular_value_weighting,
    two_way_functional_map,
)
from clalign.maps.nearest import nearest_rows, point_maps
from clalign.maps.point_maps import PointMaps


class Renumbered(NamedTuple):
    """A spectrum, the same shape's in another numbering and basis, and what joins them."""

    source: Spectrum
    target: Spectrum
    maps: PointMaps
    functional: NDArray[np.float64]


@pytest.fixture
def renumbered(middle: PreparedPair, rng: np.random.Generator) -> Renumbered:
    """Vertex i of Y is vertex order[i] of X, and Ψ = Φ Q with an orthogonal Q, so that C = Qᵀ."""
    source = middle.source.basis.head(30)
    order = rng.permutation(len(source.mass))
    turn = np.linalg.qr(rng.normal(size=(30, 30)))[0]
    target = Spectrum(source.eigenvalues, source.functions[order] @ turn, source.mass[order])
    return Renumbered(source, target, PointMaps(np.argsort(order), order), turn.T)


def test_the_functional_map_of_a_permutation_is_exact(renumbered: Renumbered) -> None:
    source, target, maps, functional = renumbered
    np.testing.assert_allclose(true_functional_map(source, target, maps.source_of_target), functional, atol=1e-10)
    assert true_functional_map(source, target, maps.source_of_target, 12).shape == (12, 12)


def test_it_takes_coefficients_on_x_to_coefficients_on_y(renumbered: Renumbered, rng: np.random.Generator) -> None:
    source, target, maps, _ = renumbered
    coefficients = rng.normal(size=30)
    carried = target.functions @ (true_functional_map(source, target, maps.source_of_target) @ coefficients)
    np.testing.assert_allclose(carried, (source.functions @ coefficients)[maps.source_of_target], atol=1e-9)


def test_point_maps_come_back_in_both_directions(renumbered: Renumbered) -> None:
    source, target, maps, functional = renumbered
    found = functional_point_maps(functional, source.functions, target.functions)
    np.testing.assert_array_equal(found.target_of_source, maps.target_of_source)
    np.testing.assert_array_equal(found.source_of_target, maps.source_of_target)


def test_swapping_the_shapes_swaps_the_maps(rng: np.random.Generator) -> None:
    first, second = rng.normal(size=(70, 5)), rng.normal(size=(50, 5))
    there, back = point_maps(first, second), point_maps(second, first)
    np.testing.assert_array_equal(there.target_of_source, back.source_of_target)
    np.testing.assert_array_equal(there.source_of_target, back.target_of_source)
    assert there.target_of_source.shape == (70,)


def test_nearest_rows_are_nearest(rng: np.random.Generator) -> None:
    queries, points = rng.normal(size=(40, 6)), rng.normal(size=(90, 6))
    expected = ((queries[:, None] - points) ** 2).sum(axis=2).argmin(axis=1)
    np.testing.assert_array_equal(nearest_rows(queries, points), expected)


def test_two_way_equals_one_way_for_a_bijection_of_equal_areas(renumbered: Renumbered) -> None:
    source, target, maps, functional = renumbered
    np.testing.assert_allclose(two_way_functional_map(source, target, maps), functional, atol=1e-10)


def test_two_way_is_the_least_squares_solution(middle: PreparedPair) -> None:
    """Stacked and solved by numpy, for maps that are not inverse to each other."""
    rng = np.random.default_rng(5)
    source, target = middle.source.basis.head(12), middle.target.basis.head(12)
    noisy = [
        np.where(rng.random(len(m)) < 0.3, rng.integers(0, len(m), len(m)), m) for m in vars(middle.truth).values()
    ]
    maps = PointMaps(*noisy)
    root_x, root_y = np.sqrt(source.mass)[:, None], np.sqrt(target.mass)[:, None]
    left = np.concatenate([root_y * target.functions, root_x * target.functions[maps.target_of_source]])
    right = np.concatenate([root_y * source.functions[maps.source_of_target], root_x * source.functions])
    expected = np.linalg.lstsq(left, right, rcond=None)[0]
    np.testing.assert_allclose(two_way_functional_map(source, target, maps), expected, atol=1e-9)


def test_weighted_directions_of_an_isometry_find_its_map(renumbered: Renumbered) -> None:
    source, target, maps, functional = renumbered
    x, y = singular_value_weighting(functional)
    found = point_maps(source.functions @ x, target.functions @ y)
    np.testing.assert_array_equal(found.target_of_source, maps.target_of_source)
    np.testing.assert_array_equal(found.source_of_target, maps.source_of_target)


def test_the_polar_factor_is_the_nearest_orthogonal_matrix(rng: np.random.Generator) -> None:
    matrix = rng.normal(size=(6, 6))
    nearest = polar_factor(matrix)
    np.testing.assert_allclose(nearest @ nearest.T, np.eye(6), atol=1e-12)
    distance = np.linalg.norm(matrix - nearest)
    for _ in range(20):
        other = np.linalg.qr(nearest + 0.1 * rng.normal(size=(6, 6)))[0]
        other = other * np.sign(np.sum(other * nearest, axis=0))
        assert np.linalg.norm(matrix - other) >= distance
    # The polar factor's other half is symmetric and has no negative eigenvalue.
    half = nearest.T @ matrix
    np.testing.assert_allclose(half, half.T, atol=1e-12)
    assert np.linalg.eigvalsh(half).min() > 0


def test_weights_are_the_singular_values(rng: np.random.Generator) -> None:
    """V W Vᵀ and U W Vᵀ of C = U Σ Vᵀ with W = min(Σ, 1), for singular values from 0.1 to 1.3."""
    left, right = (np.linalg.qr(rng.normal(size=(9, 9)))[0] for _ in range(2))
    values = np.linspace(0.1, 1.3, 9)
    source, target = singular_value_weighting(left * values @ right.T)
    weights = np.minimum(values, 1.0)
    np.testing.assert_allclose(source, right * weights @ right.T, atol=1e-12)
    np.testing.assert_allclose(target, left * weights @ right.T, atol=1e-12)


@pytest.mark.parametrize("least", [0.5, 1e-3, 1e-7, 0.0])
def test_the_polar_factor_of_nearly_singular_matrices_is_orthogonal(rng: np.random.Generator, least: float) -> None:
    left, right = (np.linalg.qr(rng.normal(size=(9, 9)))[0] for _ in range(2))
    factor = polar_factor(left * np.linspace(least, 1.3, 9) @ right.T)
    np.testing.assert_allclose(factor @ factor.T, np.eye(9), atol=1e-9)
    if least:
        np.testing.assert_allclose(factor, left @ right.T, atol=1e-8)


def test_a_reflected_function_is_seen(renumbered: Renumbered) -> None:
    source, target, maps, functional = renumbered
    flipped = replace(source, functions=source.functions * np.where(np.arange(30) == 4, -1.0, 1.0))
    found = true_functional_map(flipped, target, maps.source_of_target)
    np.testing.assert_allclose(found[:, 4], -functional[:, 4], atol=1e-10)
