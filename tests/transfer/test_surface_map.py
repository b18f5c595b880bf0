"""Maps in the order of the meshes' own arrays."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from clalign.correspondence import Correspondence
from clalign.errors import ResultError
from clalign.transfer.surface_map import surface_map, vertex_map


def test_sub_vertex_matches_interpolate(small: Correspondence) -> None:
    rng = np.random.default_rng(2)
    count = small.source.file_count
    faces = rng.integers(0, small.target.n_faces, size=count)
    weights = rng.dirichlet(np.ones(3), size=count)
    fine = dataclasses.replace(small, source_faces=faces, source_barycentric=weights)
    pulled = surface_map(fine).pull(small.target.vertices)
    corners = small.target.vertices[small.target.faces[faces[1:]]]
    assert np.allclose(pulled, np.einsum("nc,ncd->nd", weights[1:], corners))


def test_map_that_does_not_fit_is_refused(small: Correspondence) -> None:
    with pytest.raises(ResultError, match="643 vertices"):
        vertex_map(np.zeros(3, dtype=np.int64), small.source, small.target)
    wrong = small.target_of_source.copy()
    wrong[7] = 643
    with pytest.raises(ResultError, match="vertex 7 of first is mapped to 643"):
        vertex_map(wrong, small.source, small.target)
