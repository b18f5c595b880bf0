"""Hard maps from R and from C."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from prepared import Bound

from clalign.alignment.readout import argmax_map, hard_map, read_out
from clalign.engine import Backend, Reference


@pytest.mark.parametrize("on_device", [False, True])
def test_argmax_reads_the_largest_entry_of_each_column(
    rng: np.random.Generator, kernels: Backend, on_device: bool
) -> None:
    """Eq. 16: of w_i (ψ_i · C φ_j)², at odd sizes."""
    source, target, functional = rng.normal(size=(71, 9)), rng.normal(size=(53, 7)), rng.normal(size=(7, 9))
    weights = rng.uniform(0.5, 1.5, 53)
    soft = weights[:, None] * (target @ functional @ source.T) ** 2
    backend = kernels if on_device else Reference()
    np.testing.assert_array_equal(argmax_map(functional, source, target, weights, backend), soft.argmax(axis=0))


@pytest.mark.parametrize("readout", ["aligned", "argmax"])
def test_a_map_that_is_known_is_taken_as_it_is(bind_small: Callable[..., Bound], readout: str) -> None:
    problem, rotation, truth = bind_small()
    known = truth.target_of_source[::-1].copy()
    maps = read_out(problem, rotation, readout, known)  # type: ignore[arg-type]
    assert maps.target_of_source is known
    found = read_out(problem, rotation, readout)  # type: ignore[arg-type]
    np.testing.assert_array_equal(maps.source_of_target, found.source_of_target)
    np.testing.assert_array_equal(found.target_of_source, hard_map(problem, rotation, readout))  # type: ignore[arg-type]
