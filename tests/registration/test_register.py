"""The source lying on the target: on bodies whose true map is known, whole and with parts missing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import shapes
from fabricated import fabricate, small
from numpy.typing import NDArray

from clalign.correspondence import Correspondence
from clalign.errors import InputError
from clalign.mesh.mesh import mesh_from_arrays
from clalign.mesh.topology import boundary_edges, boundary_vertices, side_lengths
from clalign.registration.places import at_vertices
from clalign.registration.register import Registration, register

ANGLE = 0.5


def _pair(source_kept: NDArray[np.bool_], target_kept: NDArray[np.bool_]) -> tuple[Correspondence, NDArray[np.float64]]:
    """Match parts of a bumpy sphere (masks of its faces) with parts of its bent copy; and the true places (n, 3).

    A vertex whose counterpart is missing is matched with the nearest vertex that there is.
    """
    vertices, faces = shapes.bumpy_sphere(3)
    moved = shapes.bent(vertices, ANGLE)
    meshes = [
        mesh_from_arrays(points, faces[kept], name)
        for points, kept, name in ((vertices, source_kept, "whole"), (moved, target_kept, "part"))
    ]

    def nearest(here: NDArray[np.int64], there: NDArray[np.int64]) -> NDArray[np.int64]:
        apart = np.linalg.norm(moved[here][:, None] - moved[there][None], axis=2)
        return there[apart.argmin(axis=1)]

    source, target = meshes
    forward, backward = np.full(len(vertices), -1), np.full(len(vertices), -1)
    forward[source.file_index] = nearest(source.file_index, target.file_index)
    backward[target.file_index] = nearest(target.file_index, source.file_index)
    return fabricate(source, target, forward, backward), moved


def _edge(result: Correspondence) -> float:
    target = result.target
    return float(side_lengths(target.vertices, target.faces).mean() * target.scale)


def _errors(found: Registration, truth: NDArray[np.float64], result: Correspondence) -> NDArray[np.float64]:
    """Distances of registered vertices from their true places, in mean edges; NaN for those without a place."""
    return np.linalg.norm(found.vertices - truth, axis=1) / _edge(result)


@pytest.fixture(scope="module")
def everything() -> NDArray[np.bool_]:
    return np.ones(len(shapes.bumpy_sphere(3)[1]), dtype=bool)


def test_a_true_map_puts_every_vertex_at_its_counterpart() -> None:
    result = small()
    found = register(result)
    assert found.quality.flipped == found.quality.collapsed == found.quality.filled == 0.0
    assert found.quality.distance < 1e-9
    known = result.target_of_source >= 0
    positions = result.target.file_positions()[result.target_of_source[known]]
    error = np.linalg.norm(found.vertices[known] - positions, axis=1) / _edge(result)
    # Sixteen eigenfunctions place points within faces by a seventh of an edge.
    assert error.mean() < 0.2
    assert np.isnan(found.vertices[~known]).all()
    np.testing.assert_array_equal(found.faces, result.source.file_faces)


def test_places_say_where_the_vertices_are() -> None:
    found = register(small())
    on = found.target_faces >= 0
    target = found.target
    corners = target.file_positions()[target.file_faces[found.target_faces[on]]]
    np.testing.assert_allclose(
        np.einsum("nc,nck->nk", found.barycentric[on], corners), found.vertices[on], atol=1e-9 * target.scale
    )


def test_a_rough_map_with_wrong_matches_folds_nothing(everything: NDArray[np.bool_]) -> None:
    """Matches jump by an edge or two, and a fifth of them anywhere."""
    result, truth = _pair(everything, everything)
    rng = np.random.default_rng(3)
    target = result.target
    apart = np.linalg.norm(target.vertices[:, None] - target.vertices[None], axis=2)
    near = np.argsort(apart, axis=1)[:, :12]
    forward = near[np.arange(len(near)), rng.integers(0, 12, len(near))]
    astray = rng.random(len(near)) < 0.2
    forward[astray] = rng.integers(0, len(near), astray.sum())
    rough = fabricate(result.source, target, forward, np.argsort(forward))
    matched = np.linalg.norm(target.file_positions()[forward] - truth, axis=1) / _edge(result)
    found = register(rough)
    assert found.quality.flipped == 0.0
    assert found.quality.distance < 0.05
    error = _errors(found, truth, result)
    assert error.mean() < 0.6 * matched.mean()
    assert np.median(error) < 0.6


def _above(share: float) -> NDArray[np.bool_]:
    """Faces of the bumpy sphere below a height: all but a cap around its longest limb."""
    vertices, faces = shapes.bumpy_sphere(3)
    height = vertices[faces].mean(axis=1)[:, 0]
    return np.asarray(height < np.quantile(height, share))


def test_a_rim_stays_a_rim() -> None:
    result, truth = _pair(_above(0.8), _above(0.8))
    found = register(result)
    assert found.quality.flipped == 0.0
    assert found.quality.filled < 0.005
    target = result.target
    rim = boundary_vertices(result.source.faces, result.source.n_vertices)
    edges = target.file_positions()[target.file_index[boundary_edges(target.faces, target.n_vertices)]]
    on_rim = found.vertices[result.source.file_index[rim]]
    along = edges[:, 1] - edges[:, 0]
    share = np.clip(((on_rim[:, None] - edges[:, 0]) * along).sum(axis=2) / (along**2).sum(axis=1), 0, 1)
    off = np.linalg.norm(on_rim[:, None] - edges[:, 0] - share[:, :, None] * along, axis=2).min(axis=1)
    assert off.max() < 1e-9
    assert np.nanmean(_errors(found, truth, result)) < 0.3


@pytest.mark.parametrize("told", [True, False])
def test_what_the_target_lacks_is_filled_smoothly(everything: NDArray[np.bool_], told: bool) -> None:
    """A hole, whose vertices the map leaves without a match, or crowds at its edge."""
    result, truth = _pair(everything, _above(0.93))
    missing = np.setdiff1d(result.source.file_index, result.target.file_index)
    if told:
        forward = result.target_of_source.copy()
        forward[missing] = -1
        result = dataclasses.replace(result, target_of_source=forward)
    found = register(result)
    assert found.quality.flipped == found.quality.collapsed == 0.0
    assert 0.5 * len(missing) <= found.quality.filled * result.source.n_vertices <= 1.5 * len(missing)
    error = _errors(found, truth, result)
    assert error[missing].mean() < (0.7 if told else 1.0)
    assert np.delete(error, missing).mean() < 0.35


def test_a_template_is_completed_at_the_size_of_a_part(everything: NDArray[np.bool_]) -> None:
    """Both meshes have unit area, so that a whole is much smaller than its part until it is laid on it."""
    result, truth = _pair(everything, _above(0.4))
    missing = np.setdiff1d(result.source.file_index, result.target.file_index)
    forward = result.target_of_source.copy()
    forward[missing] = -1
    # Few eigenfunctions of a part say little within faces.
    places = at_vertices(result.target, np.maximum(result.source.map_from_file(result.target, forward), 0))
    known = dataclasses.replace(
        result,
        target_of_source=forward,
        source_faces=result.source.to_file(places.faces, -1),
        source_barycentric=result.source.to_file(places.barycentric, 0.0),
    )
    found = register(known)
    assert found.quality.flipped == 0.0
    error = _errors(found, truth, result)
    assert np.delete(error, missing).mean() < 0.2
    size, true_size = (np.linalg.norm(np.ptp(points, axis=0)) for points in (found.vertices, truth))
    assert size == pytest.approx(true_size, rel=0.1)


def test_a_map_without_a_match_has_nothing_to_lay() -> None:
    result = small()
    none = dataclasses.replace(result, target_of_source=np.full_like(result.target_of_source, -1))
    with pytest.raises(InputError, match=r"first: no vertex has a match on second"):
        register(none)


def test_loose_pieces_and_lone_vertices_come_along() -> None:
    from assembled import assembled, matched

    source, target = assembled(), assembled(0.3, seed=4)
    result = matched(source, target)
    found = register(result)
    counterpart = target.vertices[target.new_of_old]
    edge = _edge(result)
    assert np.linalg.norm(found.vertices[source.carried] - counterpart[source.carried], axis=1).mean() < edge
    assert np.isin(source.carried, found.faces).all()
    everywhere = found.positions(source.vertices)
    crumb = source.left_out[:3]
    assert np.linalg.norm(everywhere[crumb] - counterpart[crumb], axis=1).max() < 2 * edge
    np.testing.assert_array_equal(everywhere[source.carried], found.vertices[source.carried])
