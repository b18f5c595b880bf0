"""The search by cells finds what the search everywhere finds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from clalign.engine import Reference
from clalign.errors import InputError
from clalign.maps.inverted_file import nearest_in_cells


@pytest.mark.parametrize(("m", "p", "probes"), [(1, 1, 16), (50, 3, 16), (7, 200, 200), (300, 200, 4)])
def test_with_all_cells_or_few_dimensions_it_is_exact(reference: Reference, rng, m, p, probes):
    points = rng.normal(size=(p, 2))
    queries = points[rng.integers(0, p, m)] + 1e-3 * rng.normal(size=(m, 2))
    assert np.array_equal(nearest_in_cells(reference, queries, points, probes), cKDTree(points).query(queries)[1])


def test_a_surface_embedded_by_waves(kernels, rng):
    """Points of a torus in 80 dimensions: nearly all true neighbours, and the others nearly as near."""
    waves = rng.integers(-6, 7, size=(40, 2))

    def embedded(count: int) -> np.ndarray:
        phase = rng.uniform(0, 2 * np.pi, (count, 2)) @ waves.T
        return np.concatenate([np.cos(phase), np.sin(phase)], axis=1)

    points, queries = embedded(4000), embedded(1500)
    distance, truth = cKDTree(points).query(queries)
    found = nearest_in_cells(kernels, queries, points)
    assert (found == truth).mean() > 0.99
    assert np.linalg.norm(points[found] - queries, axis=1).mean() < 1.01 * distance.mean()
    assert np.array_equal(found, nearest_in_cells(kernels, queries, points))


def test_ties_go_to_the_lowest_index(reference: Reference, rng):
    points = np.repeat(rng.normal(size=(40, 3)), 5, axis=0)
    found = nearest_in_cells(reference, points, points)
    assert np.array_equal(found, np.arange(200) // 5 * 5)


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("name", ["queries", "points"])
def test_what_is_not_finite_is_refused(reference: Reference, rng, name, value):
    """Otherwise the query would find the point behind the last one."""
    rows = {"queries": rng.normal(size=(7, 3)), "points": rng.normal(size=(20, 3))}
    rows[name][5, 1] = value
    with pytest.raises(InputError, match=rf"1 of \d+ {name} are not finite, the first is row 5"):
        nearest_in_cells(reference, rows["queries"], rows["points"])
