"""From a functional map to R: square roots of rotations, signs, and a planted R found again."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from numpy.typing import NDArray
from prepared import PreparedPair

from clalign.alignment.band import band_mask, funnel_band
from clalign.alignment.rotation import (
    least_squares_start,
    orthogonal_square_root,
    random_rotation,
    starting_rotation,
)
from clalign.engine import HOST
from clalign.maps.nearest import point_maps
from clalign.options import AlignmentOptions


def random_orthogonal(size: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a random orthogonal matrix of determinant +1."""
    q, r = np.linalg.qr(rng.normal(size=(size, size)))
    q *= np.sign(np.diag(r))
    q[:, 0] *= np.linalg.det(q)
    return q


def planar(angles: list[float], size: int, rng: np.random.Generator | None = None) -> NDArray[np.float64]:
    """Return a rotation by the given angles in orthogonal planes, random ones if `rng` is given."""
    rotation = np.eye(size)
    for number, angle in enumerate(angles):
        plane = slice(2 * number, 2 * number + 2)
        rotation[plane, plane] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    if rng is None:
        return rotation
    frame = random_orthogonal(size, rng)
    return frame @ rotation @ frame.T


@pytest.mark.parametrize("size", [1, 2, 3, 8, 51])
def test_the_root_squares_to_the_rotation(size: int, rng: np.random.Generator) -> None:
    for _ in range(5):
        rotation = random_orthogonal(size, rng)
        root = orthogonal_square_root(rotation)
        np.testing.assert_allclose(root @ root, rotation, atol=1e-10)
        np.testing.assert_allclose(root @ root.T, np.eye(size), atol=1e-10)


@pytest.mark.parametrize(
    "angles",
    [[np.pi], [np.pi, np.pi], [np.pi, 0.3, np.pi], [np.pi - 1e-9, 0.4], [1e-9], [np.pi, np.pi, np.pi, 3.0, 0.0]],
    ids=["half-turn", "two half-turns", "half-turns and more", "nearly a half-turn", "nearly nothing", "mixture"],
)
@pytest.mark.parametrize("turned", [False, True])
def test_roots_of_half_turns(angles: list[float], turned: bool, rng: np.random.Generator) -> None:
    rotation = planar(angles, 2 * len(angles) + 1, rng if turned else None)
    root = orthogonal_square_root(rotation)
    np.testing.assert_allclose(root @ root, rotation, atol=1e-7)
    np.testing.assert_allclose(root @ root.T, np.eye(len(root)), atol=1e-9)


def test_the_root_is_the_principal_one() -> None:
    np.testing.assert_allclose(orthogonal_square_root(planar([0.8, -3.0], 5)), planar([0.4, -1.5], 5), atol=1e-12)


def test_a_planted_rotation_is_found(rng: np.random.Generator) -> None:
    """Φ̃ S R R = Ψ̃ with a banded R near the identity: both S and R come back."""
    size = 40
    mask = band_mask(funnel_band(size, AlignmentOptions()))
    planted = planar(list(rng.uniform(-0.7, 0.7, size=size // 2)), size)
    signs = rng.choice([-1.0, 1.0], size)
    functional = (signs[:, None] * planted @ planted).T
    found = starting_rotation(functional, mask)
    np.testing.assert_array_equal(found.signs, signs)
    np.testing.assert_allclose(found.rotation, planted, atol=1e-12)
    one_sided = starting_rotation(functional, mask, one_sided=True)
    np.testing.assert_allclose(one_sided.rotation, planted @ planted, atol=1e-12)


def test_a_rotation_wider_than_two_is_found(rng: np.random.Generator) -> None:
    """R = exp(K) with K antisymmetric and tridiagonal decays away from its diagonal and so fits the funnel."""
    size = 40
    mask = band_mask(funnel_band(size, AlignmentOptions(band_offset=8)))
    steps = rng.uniform(-0.2, 0.2, size - 1)
    planted = scipy.linalg.expm(np.diag(steps, 1) - np.diag(steps, -1))
    found = starting_rotation((planted @ planted).T, mask)
    np.testing.assert_array_equal(found.signs, 1.0)
    np.testing.assert_allclose(found.rotation, planted, atol=1e-6)


def test_signs_fold_into_the_source(rng: np.random.Generator) -> None:
    """Flipping a source function flips its sign and leaves R alone."""
    size = 20
    mask = np.ones((size, size), dtype=bool)
    functional = (planar(list(rng.uniform(-0.5, 0.5, size // 2)), size) @ np.eye(size)).T
    flips = rng.choice([-1.0, 1.0], size)
    plain, flipped = starting_rotation(functional, mask), starting_rotation(functional * flips, mask)
    np.testing.assert_array_equal(flipped.signs, plain.signs * flips)
    np.testing.assert_allclose(flipped.rotation, plain.rotation, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_any_map_gives_a_real_rotation(seed: int) -> None:
    """Also where the determinant is −1 after the signs are taken out: then one more sign is."""
    rng = np.random.default_rng(seed)
    mask = np.ones((9, 9), dtype=bool)
    functional = random_orthogonal(9, rng) * rng.choice([-1.0, 1.0], 9)
    found = starting_rotation(functional, mask)
    assert set(np.unique(found.signs)) <= {-1.0, 1.0}
    np.testing.assert_allclose(found.signs[:, None] * (found.rotation @ found.rotation), functional.T, atol=1e-9)


def test_nothing_leaves_the_funnel(rng: np.random.Generator) -> None:
    mask = band_mask(funnel_band(30, AlignmentOptions(band_offset=0)))
    found = starting_rotation(np.eye(30) + 0.3 * rng.normal(size=(30, 30)), mask)
    assert not found.rotation[~mask].any()


def test_random_start_is_the_papers() -> None:
    start = random_rotation(50, 3)
    np.testing.assert_array_equal(np.abs(start), np.eye(50))
    assert 10 < (np.diag(start) > 0).sum() < 40
    np.testing.assert_array_equal(start, random_rotation(50, 3))
    assert not np.array_equal(start, random_rotation(50, 4))


@pytest.mark.parametrize("one_sided", [False, True])
def test_the_least_squares_start_aligns(middle: PreparedPair, one_sided: bool) -> None:
    """Nearest neighbours among the functions it aligns are the true matches, or next to them."""
    source, target, truth = middle
    count = 40
    band = funnel_band(count, AlignmentOptions())
    start = least_squares_start(source.scale_invariant, target.scale_invariant, truth, band, HOST, one_sided=one_sided)
    assert not start.rotation[~band_mask(band)].any()
    aligned = source.scale_invariant.functions[:, :count] * start.signs @ start.rotation
    other = target.scale_invariant.functions[:, :count]
    found = point_maps(aligned, other if one_sided else other @ start.rotation.T)
    assert (found.target_of_source == truth.target_of_source).mean() > 0.8
    before = point_maps(source.scale_invariant.functions[:, :count], other)
    assert (before.target_of_source == truth.target_of_source).mean() < 0.2
