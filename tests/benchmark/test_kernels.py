"""The timing of kernels: every function is covered, figures are consistent."""

from __future__ import annotations

import pytest

from clalign.benchmark.kernels import Size, ceilings, measure, measure_kernels
from clalign.engine.kernels import Kernels


def test_every_costly_kernel_is_measured(kernels: Kernels, rng, monkeypatch):
    monkeypatch.setattr("clalign.benchmark.kernels.ceilings", lambda *_: iter(()))
    records = list(measure_kernels(kernels, [Size(100, 12, 20, 7)], repeats=1))
    names = {record.kernel for record in records}
    assert names == {
        "product",
        "banded_product",
        "weighted_gram",
        "solve_right",
        "packed_moments",
        "packed_moments_gradient",
        "soft_map",
        "soft_map_gradient",
        "soft_map_streamed",
        "soft_map_streamed_gradient",
        "soft_map_argmax",
        "distortion",
        "alignment",
        "nearest",
        "distortion_batch",
        "map_distance",
        "value_and_gradient",
    }
    for record in records:
        assert record.seconds > 0
        assert record.rate * record.seconds == pytest.approx(record.other_rate * record.other_seconds)
        assert record.ratio == pytest.approx(record.rate / record.other_rate)


def test_the_ceilings_are_a_copy_and_a_product(kernels: Kernels, rng):
    cases = list(ceilings(kernels, rng))
    assert [(case.kernel, case.unit) for case in cases] == [("copy", "GB/s"), ("product", "GFLOP/s")]
    assert measure(kernels, cases[0], 1).rate > 0.05
