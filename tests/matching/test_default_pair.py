"""The bundled humans matched with default options: what a newcomer gets from the first command."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from skips import backend

from clalign import match
from clalign.correspondence import Correspondence
from clalign.data import bundled_pair
from clalign.evaluation.errors import evaluate
from clalign.evaluation.truth import Truth
from clalign.options import Options

OWN = np.arange(6890)


@pytest.fixture(scope="module")
def result() -> Correspondence:
    pair = bundled_pair()
    return match(pair.source, pair.target, Options().replace({"engine.backend": backend()}))


@pytest.fixture(scope="module")
def truth() -> NDArray[np.int64]:
    return np.loadtxt(bundled_pair().truth, dtype=np.int64)


def test_source_to_target_is_right(result: Correspondence, truth: NDArray[np.int64]) -> None:
    found = evaluate(result, Truth(OWN, truth))
    assert 100 * found.mean <= 0.15
    assert found.errors.max() < 0.05
    assert np.mean(result.target_of_source == truth) >= 0.88


def test_target_to_source_is_right(result: Correspondence, truth: NDArray[np.int64]) -> None:
    inverse = np.argsort(truth)
    found = evaluate(result.source_of_target, Truth(OWN, inverse), source=result.target, target=result.source)
    assert 100 * found.mean <= 0.15
    assert found.errors.max() < 0.05
    assert np.mean(result.source_of_target == inverse) >= 0.88


def test_both_maps_agree(result: Correspondence) -> None:
    """A vertex comes back to itself or, where it shares its match, to a neighbour: edges are 0.015 long."""
    back = result.source_of_target[result.target_of_source]
    assert np.mean(back == OWN) > 0.94
    assert np.linalg.norm(result.source.vertices[back] - result.source.vertices, axis=1).max() < 0.05


def test_the_result_knows_that_it_is_right(result: Correspondence) -> None:
    assert result.orientation > 0.98
    assert result.confidence > 0.5
    assert result.warnings == ()
