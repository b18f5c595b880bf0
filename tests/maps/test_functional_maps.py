"""Functional maps and point maps of shapes whose true map is known."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from prepared import PreparedPair

from clalign.engine import Reference
from clalign.geometry.spectra import Spectrum
from clalign.maps.functional_maps import (
    PointMaps,
    argmax_map,
    coherent_directions,
    functional_map,
    functional_point_maps,
    nearest_rows,
    orthogonalised,
    point_maps,
    two_way_functional_map,
    wavelet_filtered,
)


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


@pytest.fixture
def backend() -> Reference:
    return Reference()


def test_the_functional_map_of_a_permutation_is_exact(renumbered: Renumbered) -> None:
    source, target, maps, functional = renumbered
    np.testing.assert_allclose(functional_map(source, target, maps.source_of_target), functional, atol=1e-10)
    assert functional_map(source, target, maps.source_of_target, 12).shape == (12, 12)


def test_it_takes_coefficients_on_x_to_coefficients_on_y(renumbered: Renumbered, rng: np.random.Generator) -> None:
    source, target, maps, _ = renumbered
    coefficients = rng.normal(size=30)
    carried = target.functions @ (functional_map(source, target, maps.source_of_target) @ coefficients)
    np.testing.assert_allclose(carried, (source.functions @ coefficients)[maps.source_of_target], atol=1e-9)


def test_point_maps_come_back_in_both_directions(renumbered: Renumbered, backend: Reference) -> None:
    source, target, maps, functional = renumbered
    found = functional_point_maps(backend, functional, source.functions, target.functions)
    np.testing.assert_array_equal(found.target_of_source, maps.target_of_source)
    np.testing.assert_array_equal(found.source_of_target, maps.source_of_target)


def test_swapping_the_shapes_swaps_the_maps(rng: np.random.Generator, backend: Reference) -> None:
    first, second = rng.normal(size=(70, 5)), rng.normal(size=(50, 5))
    there, back = point_maps(backend, first, second), point_maps(backend, second, first)
    np.testing.assert_array_equal(there.target_of_source, back.source_of_target)
    np.testing.assert_array_equal(there.source_of_target, back.target_of_source)
    assert there.target_of_source.shape == (70,)


def test_nearest_rows_are_nearest(rng: np.random.Generator, backend: Reference) -> None:
    queries, points = rng.normal(size=(40, 6)), rng.normal(size=(90, 6))
    expected = ((queries[:, None] - points) ** 2).sum(axis=2).argmin(axis=1)
    np.testing.assert_array_equal(nearest_rows(backend, queries, points), expected)


def test_argmax_reads_the_largest_entry_of_each_column(
    renumbered: Renumbered, rng: np.random.Generator, backend: Reference
) -> None:
    source, target, _, functional = renumbered
    weights = rng.uniform(0.5, 1.5, len(target.mass))
    soft = weights[:, None] * (target.functions @ functional @ source.functions.T) ** 2
    found = argmax_map(backend, functional, source.functions, target.functions, weights)
    np.testing.assert_array_equal(found, soft.argmax(axis=0))


def test_two_way_equals_one_way_for_a_bijection_of_equal_areas(renumbered: Renumbered, backend: Reference) -> None:
    source, target, maps, functional = renumbered
    np.testing.assert_allclose(two_way_functional_map(backend, source, target, maps), functional, atol=1e-10)


def test_two_way_is_the_least_squares_solution(middle: PreparedPair, backend: Reference) -> None:
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
    np.testing.assert_allclose(two_way_functional_map(backend, source, target, maps), expected, atol=1e-9)


def test_wavelet_filters_are_a_tight_frame(middle: PreparedPair) -> None:
    """Σ_s g_s² = 1: a map that joins equal frequencies passes unchanged, others are damped, none grows."""
    values = middle.source.basis.eigenvalues
    np.testing.assert_allclose(wavelet_filtered(np.eye(len(values)), values, values), np.eye(len(values)), atol=1e-12)
    ones = wavelet_filtered(np.ones((len(values), len(values))), values, values)
    np.testing.assert_allclose(np.diag(ones), 1.0)
    assert (ones > -1e-12).all()
    assert ones.max() < 1 + 1e-12
    # From the second function to the last lie several octaves.
    assert abs(ones[1, -1]) < 1e-12
    assert ones[-2, -1] > 0.9


def test_coherent_directions_of_an_isometry_find_its_map(renumbered: Renumbered, backend: Reference) -> None:
    source, target, maps, functional = renumbered
    directions = coherent_directions(functional)
    found = point_maps(backend, source.functions @ directions.source, target.functions @ directions.target)
    np.testing.assert_array_equal(found.target_of_source, maps.target_of_source)
    np.testing.assert_array_equal(found.source_of_target, maps.source_of_target)


def test_orthogonalised_is_the_nearest_orthogonal_matrix(rng: np.random.Generator) -> None:
    matrix = rng.normal(size=(6, 6))
    nearest = orthogonalised(matrix)
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


def test_a_reflected_function_is_seen(renumbered: Renumbered) -> None:
    source, target, maps, functional = renumbered
    flipped = replace(source, functions=source.functions * np.where(np.arange(30) == 4, -1.0, 1.0))
    found = functional_map(flipped, target, maps.source_of_target)
    np.testing.assert_allclose(found[:, 4], -functional[:, 4], atol=1e-10)
