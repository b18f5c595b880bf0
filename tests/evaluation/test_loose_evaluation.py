"""Errors of maps between files with seams, pinched vertices and loose pieces."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from assembled import assembled, matched, truth

from clalign.errors import ResultError
from clalign.evaluation.errors import evaluate
from clalign.evaluation.truth import Truth, true_maps

SOURCE, TARGET = assembled(), assembled(0.3, seed=4)


def test_a_right_map_has_no_error_on_either_side_of_a_seam() -> None:
    result = matched(SOURCE, TARGET)
    known = Truth.from_index(truth(SOURCE, TARGET))
    found = evaluate(result, known, points=10_000)
    assert found.mean == 0.0
    assert found.exact == 1.0
    off = len(SOURCE.carried) + len(SOURCE.left_out)
    assert (found.skipped, found.unmatched) == (off, 0)
    assert found.points.size == len(SOURCE.vertices) - off
    assert np.isin(SOURCE.seam, found.points).all()
    assert found.quality.covered_vertices == 1.0


def test_a_wrong_match_of_a_joined_vertex_counts_and_one_of_a_carried_vertex_does_not() -> None:
    result = matched(SOURCE, TARGET)
    known = Truth.from_index(truth(SOURCE, TARGET))
    changed = result.target_of_source.copy()
    changed[SOURCE.loose] = TARGET.shared
    assert evaluate(dataclasses.replace(result, target_of_source=changed), known, points=10_000).mean == 0.0
    # Of joined vertices the first is what the surface has.
    changed[SOURCE.seam[0]] = TARGET.shared
    found = evaluate(dataclasses.replace(result, target_of_source=changed), known, points=10_000)
    np.testing.assert_array_equal(np.sort(found.points[found.errors > 0]), np.sort(SOURCE.seam[0]))


def test_a_map_from_the_surface_to_a_loose_piece_is_refused() -> None:
    result = matched(SOURCE, TARGET)
    index = result.target_of_source.copy()
    index[SOURCE.shared] = TARGET.loose[0]
    with pytest.raises(ResultError, match=f"vertex {SOURCE.shared} is matched to a target vertex that is not on the"):
        evaluate(index, Truth.from_index(truth(SOURCE, TARGET)), source=result.source, target=result.target)


def test_true_maps_of_such_files_join_what_reading_joined() -> None:
    result = matched(SOURCE, TARGET)
    maps = true_maps(result.source, result.target, Truth.from_index(truth(SOURCE, TARGET)))
    expected = result.source.map_from_file(result.target, result.target_of_source)
    np.testing.assert_array_equal(maps.target_of_source, expected)
    np.testing.assert_array_equal(maps.source_of_target, np.argsort(expected))
