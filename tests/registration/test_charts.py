"""Charts, folds told in them, and the springs that hold a shape together."""

from __future__ import annotations

import numpy as np
import pytest
import shapes

from clalign.mesh.mesh import Mesh, mesh_from_arrays
from clalign.mesh.topology import face_areas
from clalign.refinement.precise import SurfacePoints
from clalign.registration.chart import Chart, signed_areas
from clalign.registration.measures import relative_areas, stretches
from clalign.registration.places import Projection, at_vertices, interpolated, nearest_corner, walked, with_some
from clalign.registration.rigidity import Solver, Springs
from clalign.registration.untangling import turned_over, untangled


@pytest.fixture(scope="module")
def body() -> Mesh:
    return mesh_from_arrays(*shapes.bumpy_sphere(3))


def _patch(mesh: Mesh, low: float, high: float) -> np.ndarray:
    place = mesh.vertices[mesh.faces].mean(axis=1)[:, 0]
    return np.flatnonzero((place > np.quantile(place, low)) & (place < np.quantile(place, high)))


@pytest.mark.parametrize(("low", "high"), [(-1.0, 0.9), (0.8, 2.0), (0.3, 0.6)], ids=["most", "cap", "tube"])
def test_a_chart_folds_nothing_and_leads_back(body: Mesh, low: float, high: float) -> None:
    faces = _patch(body, max(low, 0.0) if low > 0 else 0.0, min(high, 1.0))
    chart = Chart.of(body.vertices, body.faces, faces)
    assert chart is not None
    assert signed_areas(chart.flat, chart.corners).min() > 0
    rng = np.random.default_rng(0)
    points = SurfacePoints(rng.choice(faces, 300), rng.dirichlet([1.0, 1.0, 1.0], 300))
    back = chart.lifted(chart.laid(points))
    np.testing.assert_allclose(
        interpolated(body.vertices, body.faces, back), interpolated(body.vertices, body.faces, points), atol=1e-7
    )


def test_what_has_no_rim_or_a_handle_has_no_chart(body: Mesh) -> None:
    assert Chart.of(body.vertices, body.faces, np.arange(body.n_faces)) is None
    u, v = (part.ravel() for part in np.meshgrid(*[2 * np.pi * np.arange(12) / 12] * 2, indexing="ij"))
    ring = np.stack([(2 + np.cos(v)) * np.cos(u), (2 + np.cos(v)) * np.sin(u), np.sin(v)], axis=1)
    i, j = np.divmod(np.arange(144), 12)
    right, up, both = (i + 1) % 12 * 12 + j, i * 12 + (j + 1) % 12, (i + 1) % 12 * 12 + (j + 1) % 12
    faces = np.concatenate([np.stack([12 * i + j, right, both], 1), np.stack([12 * i + j, both, up], 1)])
    assert Chart.of(ring, faces, np.arange(1, len(faces))) is None


def test_a_fold_is_told_and_taken_out(body: Mesh) -> None:
    """Vertices of a patch sent to the mirror image of the patch, and two neighbours exchanged elsewhere."""
    everywhere = np.ones(body.n_vertices, dtype=bool)
    places = at_vertices(body, np.arange(body.n_vertices))
    assert not turned_over(body.faces, body, places, everywhere).any()
    one, other = body.faces[100, :2]
    swapped = with_some(places, np.array([one, other]), at_vertices(body, np.array([other, one])))
    turned = turned_over(body.faces, body, swapped, everywhere)
    assert turned[100]
    assert np.isin(body.faces[turned], [one, other]).any(axis=1).all()
    middle = body.vertices[500]
    disc = np.flatnonzero(np.linalg.norm(body.vertices - middle, axis=1) < 0.12)
    along = body.vertices[disc[0]] - middle
    along /= np.linalg.norm(along)
    mirrored = body.vertices[disc] - 2 * np.outer((body.vertices[disc] - middle) @ along, along)
    folded = with_some(swapped, disc, Projection(body)(mirrored, np.zeros((len(disc), 3)), at_vertices(body, disc)))
    turned = turned_over(body.faces, body, folded, everywhere)
    inside = np.isin(body.faces, disc).all(axis=1)
    assert turned[inside].mean() > 0.5
    mended = untangled(body.vertices, body.faces, body, folded, everywhere)
    assert not turned_over(body.faces, body, mended, everywhere).any()
    moved = np.linalg.norm(interpolated(body.vertices, body.faces, mended) - body.vertices, axis=1)
    near = np.linalg.norm(body.vertices - middle, axis=1) < 0.3
    near |= np.linalg.norm(body.vertices - body.vertices[one], axis=1) < 0.3
    assert moved[~near].max() < 1e-12
    # Vertices that do not lie on the target have no places that could be folded.
    assert not turned_over(body.faces, body, folded, np.zeros_like(everywhere)).any()


def test_a_walk_finds_the_nearest_point_and_stays_on_its_sheet(body: Mesh) -> None:
    rng = np.random.default_rng(1)
    true = SurfacePoints(rng.integers(0, body.n_faces, 200), rng.dirichlet([1.0, 1.0, 1.0], 200))
    points = interpolated(body.vertices, body.faces, true)
    found = walked(points, body, nearest_corner(body.faces, true))
    np.testing.assert_allclose(interpolated(body.vertices, body.faces, found), points, atol=1e-9)
    # Two sheets that all but touch: a point on the upper one is not drawn to the lower one.
    grid = np.stack(np.meshgrid(np.arange(6.0), np.arange(6.0), indexing="ij"), axis=-1).reshape(-1, 2)
    here = (6 * np.arange(5)[:, None] + np.arange(5)).ravel()
    sheet = np.concatenate([np.stack([here, here + 6, here + 7], 1), np.stack([here, here + 7, here + 1], 1)])
    upper = np.column_stack([grid, np.full(36, 0.2)])
    lower = np.column_stack([grid, np.zeros(36)])
    both = np.concatenate([upper, lower])
    double = type("Sheets", (), {"vertices": both, "faces": np.concatenate([sheet, sheet[:, ::-1] + 36])})()
    query = np.array([[3.4, 2.2, 0.05]])
    place = walked(query, double, np.array([0]))
    np.testing.assert_allclose(interpolated(both, double.faces, place), [[3.4, 2.2, 0.2]], atol=1e-12)


def test_springs_are_at_rest_in_any_similar_copy(body: Mesh) -> None:
    springs = Springs.of(body.vertices, body.faces)
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    turn[:, 0] *= np.sign(np.linalg.det(turn))
    copy = 1.3 * body.vertices @ turn + [1.0, 2.0, 3.0]
    np.testing.assert_allclose(springs.rotations(copy), np.broadcast_to(turn, (body.n_vertices, 3, 3)), atol=1e-7)
    np.testing.assert_allclose(springs.scales(copy), 1.3, rtol=1e-9)
    held = np.zeros(body.n_vertices)
    held[:3] = 1.0
    solved = Solver(springs, held)(copy, copy, np.zeros(body.n_vertices, dtype=bool))
    np.testing.assert_allclose(solved, copy, atol=1e-8)


def test_stretches_are_singular_values() -> None:
    rng = np.random.default_rng(4)
    rest, faces = rng.normal(size=(30, 3)), rng.integers(0, 30, size=(40, 3))
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    linear = rng.normal(size=(3, 3))
    found = stretches(rest @ linear, rest, faces)
    for (a, b, c), values in zip(faces, found, strict=True):
        plane = np.linalg.qr(np.stack([rest[b] - rest[a], rest[c] - rest[a]], axis=1))[0]
        np.testing.assert_allclose(np.linalg.svd(linear.T @ plane, compute_uv=False), values, rtol=1e-6)
    grown = relative_areas(rest @ linear, rest, faces)
    areas = face_areas(rest, faces)
    assert grown @ areas / areas.sum() == pytest.approx(1.0)
