"""The alignment term from Gram matrices, and its gradients."""

from __future__ import annotations

import numpy as np
import pytest

from clalign.engine.reference import Reference


def gram_matrices(rng: np.random.Generator, d: int) -> tuple[np.ndarray, ...]:
    w = rng.random(2 * d + 5)
    source, target = rng.normal(size=(w.size, d)), rng.normal(size=(w.size, d))
    weighted = w[:, None] * target
    rotation = np.eye(d) + 0.3 * rng.normal(size=(d, d)) / np.sqrt(d)
    return rotation, source.T @ (w[:, None] * source), target.T @ weighted, source.T @ weighted, source, target, w


@pytest.mark.parametrize("d", [1, 17, 97, 257])
@pytest.mark.parametrize("one_sided", [False, True])
def test_matches_twin(check, rng, d, one_sided):
    check("alignment", *gram_matrices(rng, d)[:4], one_sided)


@pytest.mark.parametrize("one_sided", [False, True])
def test_twin_is_the_literal_norm(reference: Reference, rng, one_sided):
    rotation, g_x, g_y, g_xy, source, target, w = gram_matrices(rng, 8)
    right = target if one_sided else target @ rotation.T
    numerator, denominator, *_ = reference.alignment(rotation, g_x, g_y, g_xy, one_sided)
    assert float(numerator) == pytest.approx(w @ np.sum((source @ rotation - right) ** 2, axis=1), rel=1e-10)
    assert float(denominator) == pytest.approx(w @ np.sum(right**2, axis=1), rel=1e-10)


@pytest.mark.parametrize("one_sided", [False, True])
def test_gradient_twins_match_finite_differences(reference: Reference, rng, one_sided):
    rotation, *grams = gram_matrices(rng, 8)[:4]
    gradients = reference.alignment(rotation, *grams, one_sided)[2:]
    step = 1e-6
    for _ in range(3):
        direction = rng.normal(size=rotation.shape)
        ahead = reference.alignment(rotation + step * direction, *grams, one_sided)[:2]
        behind = reference.alignment(rotation - step * direction, *grams, one_sided)[:2]
        for plus, minus, gradient in zip(ahead, behind, gradients, strict=True):
            slope = (float(plus) - float(minus)) / (2 * step)
            assert slope == pytest.approx(float(np.sum(gradient * direction)), rel=1e-6, abs=1e-8)
