"""The alignment term from Gram matrices, and its gradients."""

from __future__ import annotations

import numpy as np
import pytest

from clalign.engine.band import Band
from clalign.engine.reference import Reference


def wide_band(d: int) -> Band:
    """About half of the matrix."""
    rows = np.arange(d)
    return Band.from_limits(np.maximum(rows - d // 3, 0), np.minimum(rows + d // 4 + 1, d))


def with_transpose(reference: Reference, rotation: np.ndarray, band: Band) -> tuple[np.ndarray, np.ndarray]:
    """R inside the band and its transpose."""
    inside = reference.band_expand(reference.band_gather(rotation, band), band)
    return inside, np.ascontiguousarray(inside.T)


def gram_matrices(rng: np.random.Generator, d: int) -> tuple[np.ndarray, ...]:
    w = rng.random(2 * d + 5)
    source, target = rng.normal(size=(w.size, d)), rng.normal(size=(w.size, d))
    weighted = w[:, None] * target
    rotation = np.eye(d) + 0.3 * rng.normal(size=(d, d)) / np.sqrt(d)
    return rotation, source.T @ (w[:, None] * source), target.T @ weighted, source.T @ weighted, source, target, w


@pytest.mark.parametrize("d", [1, 17, 97, 257])
@pytest.mark.parametrize("one_sided", [False, True])
def test_matches_twin(check, reference: Reference, rng, d, one_sided):
    band = wide_band(d)
    rotation, *grams = gram_matrices(rng, d)[:4]
    check("alignment", *with_transpose(reference, rotation, band), *grams, band, one_sided, inside=band)


@pytest.mark.parametrize("one_sided", [False, True])
def test_twin_is_the_literal_norm(reference: Reference, rng, one_sided):
    band = wide_band(8)
    rotation, *grams, source, target, w = gram_matrices(rng, 8)
    rotation, transposed = with_transpose(reference, rotation, band)
    right = target if one_sided else target @ transposed
    numerator, denominator, *_ = reference.alignment(rotation, transposed, *grams, band, one_sided)
    assert float(numerator) == pytest.approx(w @ np.sum((source @ rotation - right) ** 2, axis=1), rel=1e-10)
    assert float(denominator) == pytest.approx(w @ np.sum(right**2, axis=1), rel=1e-10)


@pytest.mark.parametrize("one_sided", [False, True])
def test_gradient_twins_match_finite_differences(reference: Reference, rng, one_sided):
    band = wide_band(8)
    rotation, *grams = gram_matrices(rng, 8)[:4]
    gradients = reference.alignment(*with_transpose(reference, rotation, band), *grams, band, one_sided)[2:]
    step = 1e-6
    for _ in range(3):
        direction = rng.normal(size=rotation.shape)
        direction, _ = with_transpose(reference, direction, band)
        ahead, behind = (
            reference.alignment(
                *with_transpose(reference, rotation + change * direction, band), *grams, band, one_sided
            )[:2]
            for change in (step, -step)
        )
        for plus, minus, gradient in zip(ahead, behind, gradients, strict=True):
            slope = (float(plus) - float(minus)) / (2 * step)
            assert slope == pytest.approx(float(np.sum(gradient * direction)), rel=1e-6, abs=1e-8)
