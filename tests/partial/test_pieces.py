"""What a part is compared with its whole by: distances as intervals, balls, the side that a map shows, coverage."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray

from clalign.mesh.mesh import Mesh, mesh_from_arrays
from clalign.partial.coverage import covered
from clalign.partial.descriptors import ball_profiles, curvature_fields, look_costs
from clalign.partial.extent import openness, suspected_part
from clalign.partial.facing import orientation
from clalign.partial.growth import grown, stretch
from clalign.partial.intervals import Intervals, misfits, tolerances
from clalign.partial.search import Assignment, search
from clalign.partial.surface import SampledSurface, part_surface, whole_surface
from clalign.partial.whole import sample_bounds
from clalign.rules.parts import PartRules, PartSearchRules, PartStart

FEW = PartRules(samples=dataclasses.replace(PartRules().samples, places=150, functions=60, samples=25))
LENGTHS = (1.4, 1.2, 1.6, 1.0, 1.8)


@cache
def body() -> Mesh:
    return mesh_from_arrays(*shapes.limbed_sphere(LENGTHS), "body")


@cache
def upper() -> tuple[Mesh, NDArray[np.int64]]:
    """The part of the body above a plane, and the vertex of the body of each of its vertices."""
    whole = body()
    faces = whole.faces[whole.vertices[whole.faces].mean(axis=1)[:, 2] > -0.05]
    used, compact = np.unique(faces, return_inverse=True)
    part = mesh_from_arrays(whole.vertices[used], compact.reshape(-1, 3), "upper")
    return part, used[part.file_index]


@cache
def whole_surface_of_body() -> SampledSurface:
    return whole_surface(body(), FEW)


@cache
def part() -> SampledSurface:
    mesh, _ = upper()
    return part_surface(mesh, 0.02, 40, FEW).scaled(mesh.scale)


def test_intervals_that_meet_fit_and_those_far_apart_do_not() -> None:
    rules = PartSearchRules()
    bounds = Intervals(np.array([[0.2, 0.2, 0.2]], np.float32), np.array([[0.4, 0.4, 0.4]], np.float32))
    there = np.array([[0.3, 0.45, 3.0]], np.float32)
    found = misfits(bounds, Intervals(there, there), tolerances(bounds.upper, rules))[0]
    width = rules.tolerance + rules.slope * 0.4
    np.testing.assert_allclose(found, [0.0, 1.0 - np.exp(-0.5 * (0.05 / width) ** 2), 1.0], rtol=1e-5)


def test_lower_bounds_hold_where_a_part_goes_round_what_was_cut_out() -> None:
    """A flat U: along it the ends of its arms are far apart, on the whole plate they are not."""
    size = 21
    grid = np.stack(np.meshgrid(np.arange(size), np.arange(size), indexing="ij"), axis=-1).reshape(-1, 2)
    corner = np.arange(size * size).reshape(size, size)
    a, b, c, d = corner[:-1, :-1].ravel(), corner[1:, :-1].ravel(), corner[1:, 1:].ravel(), corner[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    middle = grid[faces].mean(axis=1)
    faces = faces[~((middle[:, 0] > 6) & (middle[:, 0] < 14) & (middle[:, 1] > 6))]
    used, compact = np.unique(faces, return_inverse=True)
    plate = mesh_from_arrays(np.column_stack([grid[used], np.zeros(len(used))]), compact.reshape(-1, 3))
    surface = part_surface(plate, 0.0, 10, FEW)
    straight = np.linalg.norm(surface.vertices[surface.samples][:, None] - surface.vertices[None], axis=2)
    lower = surface.lower_rows()
    assert np.all(lower <= surface.rows + 1e-6)
    # Fronts and paths along edges of the grid are a little longer than straight, never shorter.
    assert np.all(lower <= 1.08 * straight + 0.05)
    assert np.all(lower >= straight - 1e-3)
    assert np.max(surface.rows / np.maximum(straight, 1e-6) * (straight > 0.3)) > 1.5
    assert whole_surface_of_body().lower_rows() is whole_surface_of_body().rows


def test_scaling_a_surface_scales_lengths_areas_and_functions() -> None:
    one, two = part(), part().scaled(2.0)
    assert two.area == pytest.approx(4.0 * one.area)
    np.testing.assert_allclose(two.lower_rows(), 2.0 * one.lower_rows(), rtol=1e-5)
    np.testing.assert_allclose(two.basis.eigenvalues, one.basis.eigenvalues / 4.0)
    gram = two.basis.functions.T @ (two.basis.mass[:, None] * two.basis.functions)
    np.testing.assert_allclose(gram, np.eye(len(gram)), atol=1e-8)
    np.testing.assert_allclose(two.curvature, one.curvature / 2.0)
    assert one.area == pytest.approx(upper()[0].scale ** 2)


def test_a_ball_of_the_part_has_no_more_area_and_the_true_place_looks_alike() -> None:
    own, whole = part(), whole_surface_of_body()
    true = upper()[1][own.samples]
    mine, other = ball_profiles(own, FEW.descriptors), ball_profiles(whole, FEW.descriptors)
    look = look_costs(mine, other, FEW.descriptors)
    nearest = whole.rows[:, true].argmin(axis=0)
    rank = np.array([(row < row[place]).mean() for row, place in zip(look, nearest, strict=True)])
    assert np.median(rank) < 0.06
    assert np.median(look) == pytest.approx(FEW.descriptors.area + FEW.descriptors.curvature, rel=0.2)
    assert np.all((mine.trust >= 0) & (mine.trust <= 1))
    assert np.all(other.trust == 1.0)


def test_mean_curvature_of_a_ball_is_one_over_its_radius_in_the_fields() -> None:
    ball = whole_surface(mesh_from_arrays(*shapes.icosphere(3)), FEW)
    expected = np.log(np.sqrt(4.0 * np.pi))
    np.testing.assert_allclose(curvature_fields(ball, FEW.growth.times), expected, atol=0.03)


def test_the_search_finds_the_places_of_samples_that_are_places() -> None:
    """Distances alone settle it: looks are the same everywhere but for noise."""
    whole = whole_surface_of_body()
    bounds = sample_bounds(whole)
    true = np.random.default_rng(5).permutation(150)[:25]
    look = np.random.default_rng(6).uniform(0.5, 1.0, (25, 150))
    look[np.arange(25), true] = 0.6
    found = search(Assignment(bounds.at(true, true), bounds, look, FEW.search))
    np.testing.assert_array_equal(found.places[0], true)
    assert np.all(np.diff(found.scores) >= 0)


def test_a_mirrored_body_faces_the_other_way() -> None:
    whole = whole_surface_of_body()
    turned = body()
    mirrored = mesh_from_arrays(turned.vertices * [-1.0, 1.0, 1.0], turned.faces[:, [0, 2, 1]])
    other = whole_surface(mirrored, FEW)
    few = np.arange(25)
    own = dataclasses.replace(whole, samples=whole.samples[few], rows=whole.rows[few])
    bounds = sample_bounds(whole).at(few, few)
    there = other.rows[:, whole.samples[few]].argmin(axis=0)
    assert orientation(own, whole, bounds, few[None], FEW.facing)[0] == pytest.approx(1.0)
    assert orientation(own, other, bounds, there[None], FEW.facing)[0] < -0.6


def test_a_map_grows_from_some_vertices_to_the_part() -> None:
    own, whole, true = part(), whole_surface_of_body(), upper()[1]
    fields = tuple(np.zeros((len(side.vertices), 1)) for side in (own, whole))
    anchors = np.arange(0, len(true), 4)
    found = grown(own, whole, (fields[0], fields[1]), (anchors, true[anchors]), PartStart(0.0, 10), FEW.growth)
    off = np.linalg.norm(whole.vertices[found.whole_of_part] - whole.vertices[true], axis=1)
    assert off.mean() < 0.02
    assert np.mean(off < 1e-9) > 0.5
    assert found.functional.shape[1] > found.functional.shape[0]
    assert stretch(own, whole, true, FEW.growth.torn) == pytest.approx(0.0, abs=1e-12)
    torn = stretch(own, whole, np.random.default_rng(0).permutation(true), FEW.growth.torn)
    assert torn > 0.8 * FEW.growth.torn


def test_a_part_covers_its_own_area_and_no_more() -> None:
    own, whole, true = part(), whole_surface_of_body(), upper()[1]
    region = covered(own, whole, true, FEW.coverage)
    belongs = np.zeros(len(region), dtype=bool)
    belongs[true] = True
    assert whole.mass[region & belongs].sum() / whole.mass[region | belongs].sum() > 0.9
    unmatched = covered(own, whole, np.full(len(true), -1), FEW.coverage)
    assert not unmatched.any()


def test_openness_is_the_area_of_the_caps() -> None:
    vertices, faces = shapes.icosphere(4)
    cap = mesh_from_arrays(vertices, faces[vertices[faces].mean(axis=1)[:, 2] > 0.0])
    assert openness(cap) == pytest.approx(0.5, rel=0.05)
    assert openness(body()) == 0.0


def test_a_part_is_suspected_by_its_boundary_and_its_area() -> None:
    rules, whole, (piece, _) = PartRules().extent, body(), upper()
    assert suspected_part(piece, whole, rules) == "source"
    assert suspected_part(whole, piece, rules) == "target"
    assert suspected_part(whole, whole, rules) is None
    assert suspected_part(piece, piece, rules) is None
    larger = mesh_from_arrays(1.3 * piece.file_positions(), piece.file_faces)
    assert suspected_part(piece, larger, rules) == "source"
    assert suspected_part(larger, piece, rules) == "target"
    pierced = mesh_from_arrays(whole.vertices, whole.faces[1:], "pierced")
    assert suspected_part(pierced, whole, rules) is None
