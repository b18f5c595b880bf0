"""The exponent of the metric: as scale-invariant as the two shapes agree."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from prepared import MIDDLE, PreparedPair

from clalign.alignment import metric
from clalign.alignment.band import funnel_band
from clalign.alignment.metric import EXPONENTS, choose_metric
from clalign.engine import Reference
from clalign.geometry.shape import with_descriptors
from clalign.maps.functional_maps import PointMaps


def chosen(pair: PreparedPair, maps: PointMaps) -> tuple[float, np.ndarray]:
    band = funnel_band(40, MIDDLE.alignment)
    source, _, exponent = choose_metric(Reference(), pair.source, pair.target, maps, band, MIDDLE.spectrum)
    return exponent, source.descriptors.eigenvalues


def test_an_isometry_bears_the_largest_exponent(middle: PreparedPair) -> None:
    exponent, eigenvalues = chosen(middle, middle.truth)
    assert exponent == EXPONENTS[0]
    expected = with_descriptors(middle.source, dataclasses.replace(MIDDLE.spectrum, metric="power", xi=exponent))
    np.testing.assert_array_equal(eigenvalues, expected.descriptors.eigenvalues)


def test_a_map_without_sense_gets_the_smallest(middle: PreparedPair, rng: np.random.Generator) -> None:
    maps = PointMaps(rng.permutation(middle.truth.target_of_source), rng.permutation(middle.truth.source_of_target))
    assert chosen(middle, maps)[0] == EXPONENTS[-1]


def test_the_gate_decides(middle: PreparedPair, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(metric, "LEAST_SINGULAR_VALUE", 2.0)
    assert chosen(middle, middle.truth)[0] == EXPONENTS[-1]
