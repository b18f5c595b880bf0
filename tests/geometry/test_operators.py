"""Operators on surfaces whose curvature, area and Laplacian are known."""

from __future__ import annotations

import analytic
import numpy as np
import pytest
import scipy.sparse as sparse
import shapes

from clalign.benchmark.damage import needled
from clalign.errors import InputError
from clalign.geometry import operators
from clalign.geometry.spectra import Spectrum, solve
from clalign.mesh.topology import face_areas
from clalign.options import SpectrumOptions

SURFACES = {
    "sphere": (analytic.sphere(3), 4 * np.pi),
    "bumpy": (analytic.bumpy(3), 4 * np.pi),
    "torus": (analytic.torus(40, 20, 0.4), 0.0),
    "cylinder": (analytic.cylinder(24, 12, 1.0, 2.0), 0.0),
    "rectangle": (analytic.rectangle(9, 7, 2.0, 1.0), 2 * np.pi),
}


def lbo(surface: analytic.Surface, count: int) -> Spectrum:
    return solve(operators.stiffness(*surface), operators.lumped_mass(*surface), count)


@pytest.mark.parametrize("name", SURFACES)
def test_gauss_bonnet(name: str) -> None:
    surface, total = SURFACES[name]
    mass = operators.lumped_mass(*surface)
    assert mass @ operators.gaussian_curvature(*surface, mass) == pytest.approx(total, abs=1e-9)


@pytest.mark.parametrize("name", SURFACES)
def test_stiffness_is_the_dirichlet_energy(name: str, rng: np.random.Generator) -> None:
    """fᵀWf = Σ area |∇f|², with the gradient of each face from its own two edges."""
    (vertices, faces), _ = SURFACES[name]
    values = rng.normal(size=len(vertices))
    corners, at = vertices[faces], values[faces]
    edges = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=1)
    rises = np.stack([at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]], axis=1)
    metric = edges @ edges.transpose(0, 2, 1)
    squared = np.einsum("fi,fi->f", rises, np.linalg.solve(metric, rises[:, :, None])[:, :, 0])
    energy = face_areas(vertices, faces) @ squared
    matrix = operators.stiffness(vertices, faces)
    assert values @ (matrix @ values) == pytest.approx(energy, rel=1e-12)
    assert np.abs(matrix.sum(axis=1)).max() < 1e-12
    assert abs(matrix - matrix.T).max() == 0.0


def test_mass_sums_to_the_area() -> None:
    assert operators.lumped_mass(*analytic.rectangle(5, 9, 2.0, 3.0)).sum() == pytest.approx(6.0, rel=1e-14)
    assert operators.lumped_mass(*analytic.sphere(5)).sum() == pytest.approx(4 * np.pi, rel=1e-3)


@pytest.mark.parametrize("radius", [0.3, 2.0])
def test_curvature_of_a_sphere(radius: float) -> None:
    vertices, faces = analytic.sphere(4)
    surface = radius * vertices, faces
    mass = operators.lumped_mass(*surface)
    for curvature, exact in (
        (operators.gaussian_curvature(*surface, mass), 1 / radius**2),
        (operators.mean_curvature(*surface, mass, operators.stiffness(*surface)), 1 / radius),
    ):
        assert np.median(curvature) == pytest.approx(exact, rel=2e-3)
        # Barycentric areas are too small by a seventh at the twelve vertices of five faces.
        assert curvature == pytest.approx(exact, rel=0.15)


def test_mean_curvature_changes_sign_with_the_orientation() -> None:
    vertices, faces = analytic.bumpy(3)
    mass = operators.lumped_mass(vertices, faces)
    weights = operators.stiffness(vertices, faces)
    outward = operators.mean_curvature(vertices, faces, mass, weights)
    inward = operators.mean_curvature(vertices, faces[:, ::-1], mass, weights)
    np.testing.assert_allclose(inward, -outward, rtol=1e-9, atol=1e-9)


def test_slivers_leave_everything_finite_and_the_stiffness_positive() -> None:
    surface = analytic.slivered(3)
    mass = operators.lumped_mass(*surface)
    matrix = operators.stiffness(*surface)
    assert np.isfinite(matrix.data).all()
    assert (mass > 0).all()
    assert np.isfinite(operators.gaussian_curvature(*surface, mass)).all()
    assert np.isfinite(operators.mean_curvature(*surface, mass, matrix)).all()
    values = np.linalg.eigvalsh(matrix.toarray())
    assert values[0] > -1e-12 * values[-1]
    factor = operators.conformal_factor(operators.gaussian_curvature(*surface, mass), mass, SpectrumOptions())
    assert np.isfinite(factor).all()
    assert (factor > 0).all()


@pytest.mark.parametrize("metric", ["euclidean", "regularized", "power", "heat-kernel", "auto"])
def test_metric_does_not_depend_on_the_size(metric: str) -> None:
    """The mass of the scale-invariant operator is the same for a mesh three times as large."""
    options = SpectrumOptions(metric=metric)  # type: ignore[arg-type]
    vertices, faces = analytic.bumpy(3)
    masses = []
    for size in (1.0, 3.0):
        surface = size * vertices, faces
        mass = operators.lumped_mass(*surface)
        curvature = operators.gaussian_curvature(*surface, mass)
        masses.append(mass * operators.conformal_factor(curvature, mass, options, lbo(surface, 100)))
        assert masses[-1].sum() == pytest.approx(1.0, rel=1e-12)
        assert masses[-1].min() > 0
    np.testing.assert_allclose(masses[1], masses[0], rtol=1e-7)


def test_diffusion_decays_each_eigenfunction_by_its_eigenvalue() -> None:
    """(M + tW)⁻¹ M φ = φ / (1 + λ t ΣM), whatever the size, and the total is kept."""
    time = 0.01
    vertices, faces = analytic.bumpy(3)
    for size in (1.0, 3.0):
        surface = size * vertices, faces
        mass, weights = operators.lumped_mass(*surface), operators.stiffness(*surface)
        basis = lbo(surface, 20)
        for value, function in zip(basis.eigenvalues, basis.functions.T, strict=True):
            expected = function / (1.0 + value * time * mass.sum())
            np.testing.assert_allclose(operators.diffused(function, mass, weights, time), expected, atol=1e-8 / size)
        values = np.random.default_rng(0).standard_normal(len(mass))
        assert mass @ operators.diffused(values, mass, weights, time) == pytest.approx(mass @ values, rel=1e-9)
        assert operators.diffused(values, mass, weights, 0.0) is values


def test_diffusion_takes_the_noise_off_the_curvature() -> None:
    """Noise of a tenth of an edge along the normals of a sphere, whose curvature is 1: more than nine tenths go."""
    vertices, faces = analytic.sphere(5)
    rng = np.random.default_rng(0)
    edge = np.linalg.norm(vertices[faces[:, 0]] - vertices[faces[:, 1]], axis=1).mean()
    surface = vertices * (1.0 + 0.1 * edge * rng.standard_normal((len(vertices), 1))), faces
    mass, weights = operators.lumped_mass(*surface), operators.stiffness(*surface)
    raw = operators.gaussian_curvature(*surface, mass)
    smooth = operators.diffused(raw, mass, weights, 0.002)
    assert np.std(raw) > 1.0
    assert np.std(smooth) < 0.1 * np.std(raw)


def test_defects_of_neighbours_correlate_without_noise_only() -> None:
    vertices, faces = analytic.bumpy(5)
    rng = np.random.default_rng(0)
    edge = np.linalg.norm(vertices[faces[:, 0]] - vertices[faces[:, 1]], axis=1).mean()
    correlations = []
    for amount in (0.0, 0.02, 0.1):
        surface = vertices + amount * edge * rng.standard_normal(vertices.shape), faces
        mass = operators.lumped_mass(*surface)
        correlations.append(operators.defect_correlation(operators.gaussian_curvature(*surface, mass), mass, faces))
    assert 0.9 < correlations[0] <= 1.0
    assert correlations[0] > correlations[1] > correlations[2]
    assert -1.0 <= correlations[2] < 0.0
    assert operators.defect_correlation(np.zeros(len(vertices)), mass, faces) == 1.0


def test_power_is_the_clamped_power_of_the_curvature() -> None:
    surface = analytic.bumpy(3)
    mass = operators.lumped_mass(*surface)
    curvature = operators.gaussian_curvature(*surface, mass)
    for xi, clamp in ((0.3, 0.02), (1.0, 0.1)):
        factor = operators.conformal_factor(curvature, mass, SpectrumOptions(xi=xi, clamp=clamp))
        low, high = np.quantile(np.abs(curvature), [clamp, 1 - clamp])
        expected = np.clip(np.abs(curvature), low, high) ** xi
        np.testing.assert_allclose(factor, expected / (mass @ expected), rtol=1e-12)
        assert factor.max() / factor.min() == pytest.approx((high / low) ** xi, rel=1e-9)


def test_heat_kernel_metric_asks_for_the_spectrum() -> None:
    with pytest.raises(InputError, match="spectrum"):
        operators.conformal_factor(np.ones(4), np.full(4, 0.25), SpectrumOptions(metric="heat-kernel"))


@pytest.mark.parametrize("radius", [0.5, 1.0])
def test_heat_kernel_curvature_from_the_exact_spectrum_of_a_sphere(radius: float) -> None:
    """Σ φ² over the pairs of degree l is (2l + 1) / 4πr² everywhere; what is left is the next term, K² t / 5."""
    degree = np.arange(20.0)
    area = 4 * np.pi * radius**2
    flat = np.tile(np.sqrt((2 * degree + 1) / area), (3, 1))
    exact = Spectrum(degree * (degree + 1) / radius**2, flat, np.full(3, area / 3))
    following = operators.HEAT_TIME * area / radius**4 / 5
    expected = 1 / radius**2 + following
    np.testing.assert_allclose(operators.heat_kernel_curvature(exact), expected, rtol=1e-3)


def test_heat_kernel_curvature_of_a_mesh_converges() -> None:
    """The error of the mesh falls with the square of the edge length, so by four with each subdivision."""
    errors = []
    for subdivisions in (3, 4):
        spectrum = lbo(analytic.sphere(subdivisions), 200)
        errors.append(spectrum.mass @ operators.heat_kernel_curvature(spectrum) / spectrum.mass.sum() - 1.0)
    assert 3.0 < errors[0] / errors[1] < 5.0


def test_orientation_of_the_coordinates_on_a_sphere() -> None:
    """n·(∇x × ∇y) = n_z = z on the unit sphere, and the integral of z² is 4π/3."""
    vertices, faces = analytic.sphere(4)
    tensor = operators.orientation_tensor(faces, vertices)
    levi_civita = np.zeros((3, 3, 3))
    levi_civita[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
    levi_civita[[1, 2, 0], [0, 1, 2], [2, 0, 1]] = -1.0
    np.testing.assert_allclose(tensor, levi_civita * 4 * np.pi / 3, atol=0.02)


def test_orientation_agrees_with_gradients(rng: np.random.Generator) -> None:
    """The same integral from gradients in space and unit normals."""
    vertices, faces = analytic.bumpy(3)
    functions = rng.normal(size=(len(vertices), 4))
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    doubled = np.linalg.norm(normals, axis=1)
    unit = normals / doubled[:, None]
    opposite = corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]
    hats = np.cross(unit[:, None, :], opposite) / doubled[:, None, None]
    gradients = np.einsum("fix,fip->fpx", hats, functions[faces])
    products = np.einsum("fx,fabx->fab", unit, np.cross(gradients[:, :, None], gradients[:, None, :]))
    expected = np.einsum("f,fab,fc->abc", doubled / 2, products, functions[faces].mean(axis=1))
    tensor = operators.orientation_tensor(faces, functions)
    np.testing.assert_allclose(tensor, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())
    np.testing.assert_array_equal(tensor, -tensor.transpose(1, 0, 2))


def test_orientation_changes_sign_under_a_mirror_and_not_under_renumbering(rng: np.random.Generator) -> None:
    vertices, faces = analytic.bumpy(3)
    functions = rng.normal(size=(len(vertices), 5))
    tensor = operators.orientation_tensor(faces, functions)
    # A mirrored surface keeps its functions; its outward faces run the other way round.
    np.testing.assert_allclose(operators.orientation_tensor(faces[:, ::-1], functions), -tensor, atol=1e-12)
    _, shuffled, new_of_old = shapes.renumbered(vertices, faces, 5)
    moved = np.zeros_like(functions)
    moved[new_of_old] = functions
    np.testing.assert_allclose(operators.orientation_tensor(shuffled.astype(np.int32), moved), tensor, atol=1e-11)


def test_orientation_of_many_faces_is_summed_in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    vertices, faces = analytic.bumpy(2)
    whole = operators.orientation_tensor(faces, vertices)
    monkeypatch.setattr(operators, "_FACES_AT_ONCE", 37)
    np.testing.assert_allclose(operators.orientation_tensor(faces, vertices), whole, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("name", ["sphere", "torus"])
def test_the_intrinsic_operator_is_that_of_cotangents_on_delaunay_triangles(name: str) -> None:
    (vertices, faces), _ = SURFACES[name]
    plain = operators.stiffness(vertices, faces)
    between = plain - sparse.diags(plain.diagonal())
    matrix, mass = operators.intrinsic_operators(vertices, faces)
    if between.max() <= 1e-9:
        np.testing.assert_allclose(matrix.toarray(), plain.toarray(), atol=1e-4)
        np.testing.assert_allclose(mass, operators.lumped_mass(vertices, faces), rtol=1e-4)
    assert abs(matrix.sum(axis=1)).max() < 1e-9
    assert (matrix - sparse.diags(matrix.diagonal())).max() <= 1e-9, "no weight between vertices is negative"
    assert mass.sum() == pytest.approx(face_areas(vertices, faces).sum(), rel=1e-4)


def test_needles_hardly_change_intrinsic_eigenvalues(rng: np.random.Generator) -> None:
    """On a mesh of which edges were cut very near their ends, low eigenvalues stay."""
    vertices, faces = analytic.bumpy(3)
    damaged = needled(vertices, faces.astype(np.int64), rng)
    before = solve(*operators.intrinsic_operators(vertices, faces), 20).eigenvalues
    after = solve(*operators.intrinsic_operators(damaged.vertices, damaged.faces.astype(np.int32)), 20).eigenvalues
    np.testing.assert_allclose(after[1:], before[1:], rtol=0.01)
