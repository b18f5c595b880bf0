"""Labels come over without what the map has scattered, and with what was drawn."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from fabricated import small
from numpy.typing import NDArray

from clalign.correspondence import Correspondence
from clalign.transfer.transfer import carried_labels, carry_labels, carry_values


@pytest.fixture(scope="module")
def drawn() -> NDArray[np.int64]:
    """Three regions, a line one vertex wide, and a single vertex, on the source's file."""
    vertices = small().source.file_positions()
    labels = np.digitize(vertices[:, 0], np.quantile(vertices[1:, 0], [0.3, 0.7]))
    line = (vertices[:, 0] < np.quantile(vertices[1:, 0], 0.2)) & (np.abs(vertices[:, 2]) < 0.03)
    labels[line] = 3
    labels[np.argmax(vertices[1:, 0]) + 1] = 4
    return labels


def _scattered(result: Correspondence, share: float) -> Correspondence:
    """The true map with some matches sent anywhere."""
    rng = np.random.default_rng(2)
    backward = result.source_of_target.copy()
    wrong = np.flatnonzero(rng.random(len(backward)) < share)
    wrong = wrong[wrong > 0]
    backward[wrong] = rng.integers(1, len(result.source_of_target), len(wrong))
    return dataclasses.replace(result, source_of_target=backward)


def test_a_true_map_changes_nothing(drawn: NDArray[np.int64]) -> None:
    result = small()
    carried, said = carried_labels(result, drawn)
    np.testing.assert_array_equal(carried[1:], drawn[result.source_of_target[1:]])
    assert said.startswith("0 vertices took the label")
    assert "; 0 islands with 0 vertices" in said


def test_speckles_go_and_what_was_drawn_stays(drawn: NDArray[np.int64]) -> None:
    result = small()
    truth = drawn[result.source_of_target[1:]]
    rough = _scattered(result, 0.05)
    raw = carry_labels(rough, drawn, speckles=True)[1:]
    carried, said = carried_labels(rough, drawn)
    assert (raw != truth).sum() > 15
    assert (carried[1:] != truth).sum() < 0.5 * (raw != truth).sum()
    assert set(np.unique(carried[1:])) == {0, 1, 2, 3, 4}
    assert " 0 vertices took" not in f" {said}"
    assert carried[0] == -1


def test_precise_values_are_smoother_both_ways() -> None:
    """A map rounded to vertices steps; between them the values of a linear function are the function's."""
    result = small()
    for origin, mesh in (("source", result.source), ("target", result.target)):
        there = result.target if origin == "source" else result.source
        back = result.source_of_target if origin == "source" else result.target_of_source
        values = mesh.file_positions()
        found = carry_values(result, values, origin=origin, route="precise")  # type: ignore[arg-type]
        truth = values[back]
        edge = np.linalg.norm(values[mesh.file_faces[:, 0]] - values[mesh.file_faces[:, 1]], axis=1).mean()
        on = there.file_index
        assert np.linalg.norm(found[on] - truth[on], axis=1).mean() < 0.35 * edge
        assert (np.linalg.norm(found[on] - truth[on], axis=1) > 1e-9).any()
