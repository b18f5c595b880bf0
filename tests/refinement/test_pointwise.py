"""Pointwise descriptors: equal at matching vertices, and able to tell the halves of a part with a mirror."""

from __future__ import annotations

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray
from prepared import MIDDLE, PreparedPair, true_functional_map
from scipy.spatial import Delaunay

from clalign.engine import Reference
from clalign.geometry.operators import lumped_mass, orientation_products
from clalign.geometry.shape import prepare
from clalign.maps.point_maps import PointMaps
from clalign.maps.sampling import SampledBasis
from clalign.mesh.mesh import mesh_from_arrays
from clalign.refinement.patches import Orientations, best_patches
from clalign.refinement.pointwise import oriented_descriptors, pointwise_descriptors
from clalign.refinement.zoomout import grown_map, vertex_maps
from clalign.rules import RefinementRules, ZoomOutSchedule

RULES = RefinementRules()


def correlation(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.sum(x * y, axis=0) / np.sqrt(np.sum(x**2, axis=0) * np.sum(y**2, axis=0))


def test_orientation_products_of_coordinates_in_the_plane() -> None:
    """n · (∇x × ∇y) = 1, with the other order or the other orientation −1, of a function with itself 0."""
    places, at = np.meshgrid(np.linspace(0.0, 3.0, 7), np.linspace(0.0, 1.0, 5))
    vertices = np.stack([places.ravel(), at.ravel(), np.zeros(35)], axis=1)
    faces = Delaunay(vertices[:, :2]).simplices.astype(np.int32)
    upward = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])[
        :, 2
    ]
    faces[upward < 0] = faces[upward < 0, ::-1]
    mass = lumped_mass(vertices, faces)
    first, second = np.array([0, 1, 0]), np.array([1, 0, 0])
    for oriented, sign in ((faces, 1.0), (faces[:, ::-1], -1.0)):
        products = orientation_products(oriented, mass, vertices[:, :2], first, second)
        np.testing.assert_allclose(products, sign * np.tile([1.0, -1.0, 0.0], (len(vertices), 1)), atol=1e-12)


@pytest.mark.parametrize("kind", ["curvatures", "signatures", "oriented"])
def test_descriptors_agree_at_matching_vertices(middle: PreparedPair, kind: str) -> None:
    source, target, truth = middle
    functional = true_functional_map(source.basis, target.basis, truth.source_of_target, 12)
    x, y = pointwise_descriptors(source, target, functional, kind, RULES)  # type: ignore[arg-type]
    assert np.abs(x).max() <= 3.0
    assert np.median(correlation(x, y[truth.target_of_source])) > 0.95


def snout() -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.int64], NDArray[np.bool_]]:
    """Return a body with a part that is its own mirror image, the mirror image of every vertex, and where the part is.

    The body has no symmetry.
    """
    directions, faces = shapes.icosphere(4)
    x, y, z = directions.T
    part = 1.0 / (1.0 + np.exp(-30.0 * (z - 0.75)))
    body = 1.0 + 0.25 * np.sin(2.0 * x + 1.0) * y + 0.15 * np.cos(3.0 * x - z)
    lump = 2.2 + 0.4 * y - 1.2 * x**2
    vertices = directions * ((1.0 - part) * body + part * lump)[:, None]
    flipped = directions * [-1.0, 1.0, 1.0]
    mirror = np.argmin(np.linalg.norm(directions[:, None] - flipped[None], axis=2), axis=1)
    return vertices, faces, mirror, z > 0.8


def test_oriented_descriptors_tell_the_halves_of_a_part_from_each_other() -> None:
    vertices, faces, mirror, inside = snout()
    shape = prepare(mesh_from_arrays(vertices, faces), MIDDLE)
    at, across = np.flatnonzero(inside), mirror[inside]
    signatures, _ = pointwise_descriptors(shape, shape, np.eye(12), "signatures", RULES)
    assert correlation(signatures[at], signatures[across]).min() > 0.85
    oriented, _ = pointwise_descriptors(shape, shape, np.eye(12), "oriented", RULES)
    strongest = np.argmax(np.mean(oriented[at] ** 2, axis=0))
    assert correlation(oriented[at], oriented[across])[strongest] < -0.7


def test_a_patch_that_is_turned_inside_out_is_seen_and_taken_from_another_map() -> None:
    """Of the true map and one that exchanges the halves of the part, the patches of the part come from the true one."""
    vertices, faces, mirror, inside = snout()
    shape = prepare(mesh_from_arrays(vertices, faces), MIDDLE)
    backend = Reference()
    samples = shape.samples(250)
    patches = shape.patches(samples.vertices, 25)
    low, high = (SampledBasis.of(each, samples, shape.order, backend) for each in (shape.basis, shape.scale_invariant))
    orientations = Orientations(low, low, shape.orientation, shape.orientation, RULES)
    vertices_of_samples = low.samples.vertices
    exchanged = np.where(inside, mirror, np.arange(len(vertices)))[vertices_of_samples]
    right, wrong = (PointMaps(each, each) for each in (vertices_of_samples, exchanged))
    deep = (directions_of(vertices)[vertices_of_samples, 2] > 0.9) & (
        np.abs(directions_of(vertices)[vertices_of_samples, 0]) > 0.1
    )
    assert np.mean(orientations.agreements(right)[0] > 0) > 0.95
    assert np.mean(orientations.agreements(wrong)[0][deep] < 0) > 0.9
    for candidates in ([right, wrong], [wrong, right]):
        chosen = best_patches(high, high, (patches, patches), candidates, RULES, orientations)
        np.testing.assert_array_equal(chosen.target_of_source[deep], right.target_of_source[deep])


def directions_of(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(vertices / np.linalg.norm(vertices, axis=1, keepdims=True))


def test_oriented_zoomout_sharpens_a_coarse_map(middle: PreparedPair) -> None:
    source, target, truth = middle
    coarse = true_functional_map(source.basis, target.basis, truth.source_of_target, 12)
    grown = grown_map(source, target, coarse, 60, ZoomOutSchedule(12, 20, 0.5, "oriented"), RULES, Reference())
    found = vertex_maps(source, target, grown, Reference()).target_of_source
    assert np.mean(found == truth.target_of_source) > 0.9


def test_a_map_that_mirrors_everything_gets_the_same_descriptors(middle: PreparedPair) -> None:
    source, target, truth = middle
    functional = true_functional_map(source.basis, target.basis, truth.source_of_target, 12)
    reversed_faces = prepare(mesh_from_arrays(target.mesh.file_vertices(), target.mesh.faces[:, ::-1]), MIDDLE)
    x, y = oriented_descriptors(source, target, functional, RULES)
    again_x, again_y = oriented_descriptors(source, reversed_faces, functional, RULES)
    np.testing.assert_allclose(again_x, x, atol=1e-6)
    np.testing.assert_allclose(again_y, y, atol=1e-6)
