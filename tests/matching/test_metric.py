"""The exponent of the metric: as scale-invariant as the two shapes agree."""

from __future__ import annotations

import dataclasses

import numpy as np
from prepared import MIDDLE, PreparedPair

from clalign.alignment.band import funnel_band
from clalign.engine import Reference
from clalign.geometry.shape import with_scale_invariant
from clalign.maps.point_maps import PointMaps
from clalign.matching.metric import choose_metric
from clalign.rules import AlignmentRules

EXPONENTS = AlignmentRules().exponents


def chosen(pair: PreparedPair, maps: PointMaps, rules: AlignmentRules | None = None) -> tuple[float, np.ndarray]:
    band = funnel_band(40, MIDDLE.alignment)
    source, _, exponent = choose_metric(
        pair.source, pair.target, maps, band, MIDDLE.spectrum, rules or AlignmentRules(), Reference()
    )
    return exponent, source.scale_invariant.eigenvalues


def test_an_isometry_bears_the_largest_exponent(middle: PreparedPair) -> None:
    exponent, eigenvalues = chosen(middle, middle.truth)
    assert exponent == EXPONENTS[0]
    expected = with_scale_invariant(middle.source, dataclasses.replace(MIDDLE.spectrum, metric="power", xi=exponent))
    np.testing.assert_array_equal(eigenvalues, expected.scale_invariant.eigenvalues)


def test_a_map_without_sense_gets_the_smallest(middle: PreparedPair, rng: np.random.Generator) -> None:
    maps = PointMaps(rng.permutation(middle.truth.target_of_source), rng.permutation(middle.truth.source_of_target))
    assert chosen(middle, maps)[0] == EXPONENTS[-1]


def test_the_gate_decides(middle: PreparedPair) -> None:
    assert chosen(middle, middle.truth, AlignmentRules(least_singular_value=2.0))[0] == EXPONENTS[-1]
