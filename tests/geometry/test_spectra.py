"""Spectra against closed forms, dense solutions and the invariances they must have."""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable

import analytic
import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sparse
import shapes
from numpy.typing import NDArray
from scipy.sparse.linalg import ArpackNoConvergence, eigsh

from clalign.errors import ConvergenceError
from clalign.geometry import factors, lanczos, operators, spectra
from clalign.geometry.spectra import Spectrum, solve
from clalign.options import SpectrumOptions


def lbo(surface: analytic.Surface, count: int, threads: int = 1) -> Spectrum:
    return solve(operators.stiffness(*surface), operators.lumped_mass(*surface), count, threads)


@pytest.fixture
def without_block(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Call it, and from then on block Lanczos does not converge."""

    def fails(*_: object) -> None:
        raise ConvergenceError("a slice did not converge")

    return lambda: monkeypatch.setattr(spectra, "lowest_pairs", fails)


def scale_invariant_mass(surface: analytic.Surface, xi: float = 0.3) -> NDArray[np.float64]:
    mass = operators.lumped_mass(*surface)
    curvature = operators.gaussian_curvature(*surface, mass)
    return mass * operators.conformal_factor(curvature, mass, SpectrumOptions(xi=xi))


def dense_values(surface: analytic.Surface, mass: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    matrix = operators.stiffness(*surface).toarray() / np.sqrt(np.outer(mass, mass))
    return scipy.linalg.eigh(matrix, eigvals_only=True, subset_by_index=(0, count - 1))


def test_sphere_has_the_eigenvalues_of_spherical_harmonics() -> None:
    """l (l + 1), each 2l + 1 times; the discrete ones stay together in their groups."""
    values = lbo(analytic.sphere(4), 225).eigenvalues
    for degree in range(15):
        group = values[degree**2 : (degree + 1) ** 2]
        # The relative error of linear elements grows with the eigenvalue, by about 3.2e-4 at this edge length.
        exact = degree * (degree + 1)
        assert group == pytest.approx(exact * (1 - 3.2e-4 * exact), rel=0.02, abs=1e-8)


def test_rectangle_has_cosines() -> None:
    """Natural boundary conditions: π² (p²/w² + q²/h²)."""
    p, q = np.meshgrid(np.arange(12), np.arange(12))
    exact = np.sort((np.pi**2 * (p**2 / 2.0**2 + q**2)).ravel())[:30]
    values = lbo(analytic.rectangle(81, 41, 2.0, 1.0), 30).eigenvalues
    np.testing.assert_allclose(values, exact, rtol=0.01, atol=1e-8)


def test_cylinder_has_waves_around_and_cosines_along() -> None:
    """p² / r² twice for p > 0, plus π² q² / L²."""
    p, q = np.meshgrid(np.r_[0, np.repeat(np.arange(1, 9), 2)], np.arange(12))
    exact = np.sort((p**2 + np.pi**2 * q**2 / 3.0**2).ravel())[:30]
    values = lbo(analytic.cylinder(80, 40, 1.0, 3.0), 30).eigenvalues
    np.testing.assert_allclose(values, exact, rtol=0.01, atol=1e-8)


HARD = {
    "sphere, groups of many near-multiple pairs": (analytic.sphere(3), 0.0, 214),
    "bumpy": (analytic.bumpy(3), 0.3, 214),
    "curvature to the power 1": (analytic.bumpy(3), 1.0, 200),
    "symmetric tube": (analytic.cylinder(12, 80, 0.1, 10.0), 0.3, 300),
    "needle": (analytic.rectangle(250, 4, 100.0, 1.0), 0.0, 250),
    "torus": (analytic.torus(48, 24, 0.4), 0.3, 177),
    "slivers": (analytic.slivered(3), 0.3, 200),
}


@pytest.mark.parametrize("name", HARD)
def test_no_pair_is_missing_and_every_one_is_accurate(name: str, caplog: pytest.LogCaptureFixture) -> None:
    surface, xi, count = HARD[name]
    area = operators.lumped_mass(*surface)
    mass = scale_invariant_mass(surface, xi) if xi else area / area.sum()
    matrix = operators.stiffness(*surface)
    with caplog.at_level(logging.WARNING):
        spectrum = solve(matrix, mass, count)
    assert not caplog.records, "the block solver gave up"
    unit = 4 * np.pi
    exact = dense_values(surface, mass, count)
    np.testing.assert_array_less(np.abs(spectrum.eigenvalues - exact) / (exact + unit), 1e-8)
    gram = spectrum.functions.T @ (mass[:, None] * spectrum.functions)
    np.testing.assert_allclose(gram, np.eye(count), atol=1e-12)
    residual = matrix @ spectrum.functions - mass[:, None] * spectrum.functions * spectrum.eigenvalues
    relative = np.sqrt((residual**2 / mass[:, None]).sum(axis=0)) / (spectrum.eigenvalues + unit)
    assert relative.max() < 1e-7


def test_failure_of_block_lanczos_is_logged_and_arpack_finds_the_same_functions(
    without_block: Callable[[], None], caplog: pytest.LogCaptureFixture
) -> None:
    surface = analytic.bumpy(4)
    block = lbo(surface, 180)
    assert not caplog.records
    without_block()
    arpack = lbo(surface, 180)
    assert "ARPACK takes over" in caplog.text
    np.testing.assert_allclose(block.eigenvalues, arpack.eigenvalues, rtol=1e-9, atol=1e-8)
    np.testing.assert_allclose(block.functions, arpack.functions, atol=1e-5 * np.abs(arpack.functions).max())


def test_reproducible_bit_for_bit() -> None:
    surface = analytic.bumpy(3)
    first, again, threaded = (lbo(surface, 200, threads=threads) for threads in (1, 1, 2))
    for other in (again, threaded):
        np.testing.assert_array_equal(other.functions, first.functions)
        np.testing.assert_array_equal(other.eigenvalues, first.eigenvalues)


def test_renumbering_changes_rounding_only() -> None:
    vertices, faces = analytic.bumpy(3)
    shuffled_vertices, shuffled_faces, new_of_old = shapes.renumbered(vertices, faces, 3)
    first = lbo((vertices, faces), 150)
    second = lbo((shuffled_vertices, shuffled_faces.astype(np.int32)), 150)
    np.testing.assert_allclose(second.eigenvalues, first.eigenvalues, rtol=1e-9, atol=1e-8)
    # Functions may rotate within near-multiple pairs as far as residual over gap lets them.
    np.testing.assert_allclose(second.functions[new_of_old], first.functions, atol=1e-5)


def test_folding_a_sheet_keeps_the_spectrum() -> None:
    """An exact isometry: no face changes."""
    vertices, faces = analytic.rectangle(41, 21, 2.0, 1.0)
    bent = analytic.folded(vertices, vertices[20 * 21, 0], 1.0)
    flat, folded = (lbo((points, faces), 100).eigenvalues for points in (vertices, bent))
    np.testing.assert_allclose(folded, flat, rtol=1e-10, atol=1e-9)


@pytest.mark.parametrize("xi", [0.3, 1.0])
def test_scale_invariant_spectrum_ignores_size_place_and_pose(xi: float) -> None:
    vertices, faces = analytic.bumpy(3)
    rotation, _ = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))
    moved = 7.5 * vertices @ rotation.T + [1.0, -2.0, 3.0]
    before, after = (
        solve(operators.stiffness(points, faces), scale_invariant_mass((points, faces), xi), 120)
        for points in (vertices, moved)
    )
    np.testing.assert_allclose(after.eigenvalues, before.eigenvalues, rtol=1e-7, atol=1e-8)


def test_small_meshes_are_given_fewer_pairs(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, logger="clalign"):
        spectrum = lbo(analytic.sphere(2), 352)
    assert spectrum.count == 162 // 3
    assert "162 vertices" in caplog.text


@pytest.mark.parametrize("surface", [analytic.bumpy(1), analytic.rectangle(2, 2, 1.0, 1.0)])
def test_smallest_meshes(surface: analytic.Surface) -> None:
    spectrum = lbo(surface, 10)
    exact = dense_values(surface, operators.lumped_mass(*surface), spectrum.count)
    np.testing.assert_allclose(spectrum.eigenvalues, exact, atol=1e-9)
    assert spectrum.count == min(10, max(len(surface[0]) // 3, 1))


def test_inaccurate_pairs_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def careless(matrix: sparse.csc_matrix, count: int, unit: float, threads: int) -> tuple[object, object]:
        values, vectors = lanczos.lowest_pairs(matrix, count, unit, threads)
        vectors[:, 7] += 1e-4 * vectors[:, 20]
        return values, vectors

    monkeypatch.setattr(spectra, "lowest_pairs", careless)
    with pytest.raises(ConvergenceError, match="residual"):
        lbo(analytic.bumpy(3), 30)


def test_singular_operators_are_a_convergence_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """As SuperLU reports them: the pivot of a vertex without area or weights is exactly zero."""
    surface = analytic.bumpy(3)
    count = len(surface[0])
    weights = operators.stiffness(*surface).tolil()
    weights[5, :] = weights[:, 5] = 0.0
    mass = np.ones(count)
    # The shift of the factorisation would make the pivot positive.
    monkeypatch.setattr(factors.sparse, "eye_array", lambda size: sparse.csc_array((size, size)))
    with pytest.raises(ConvergenceError, match=r"singular.*clalign check") as caught:
        solve(weights.tocsr(), mass, 30)
    assert type(caught.value.__cause__) is RuntimeError
    with pytest.raises(ConvergenceError, match=r"singular.*clalign check"):
        operators.diffused(np.ones(count), mass, weights.tocsr(), 0.01)


def test_arpack_that_gives_up_is_a_convergence_error(
    without_block: Callable[[], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    without_block()
    monkeypatch.setattr(spectra, "eigsh", functools.partial(eigsh, maxiter=1, ncv=31, tol=1e-14))
    with pytest.raises(ConvergenceError, match=r"ARPACK gave up on 30 eigenpairs.*clalign check") as caught:
        lbo(analytic.bumpy(3), 30)
    assert isinstance(caught.value.__cause__, ArpackNoConvergence)


def test_a_dense_solver_that_gives_up_is_a_convergence_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def gives_up(*_: object, **__: object) -> None:
        raise np.linalg.LinAlgError("did not converge")

    monkeypatch.setattr(scipy.linalg, "eigh", gives_up)
    with pytest.raises(ConvergenceError, match=r"dense eigensolver gave up \(did not converge\).*clalign check"):
        lbo(analytic.bumpy(1), 10)


def test_inertia_counts_eigenvalues_below() -> None:
    surface = analytic.bumpy(3)
    mass = operators.lumped_mass(*surface)
    root = sparse.diags_array(1 / np.sqrt(mass))
    matrix = sparse.csc_matrix(root @ operators.stiffness(*surface) @ root)
    values = dense_values(surface, mass, 214)
    for index in (1, 10, 100, 200):
        middle = 0.5 * (values[index - 1] + values[index])
        assert factors.count_below(matrix, middle) == index


def test_signs_do_not_depend_on_the_solver(rng: np.random.Generator) -> None:
    spectrum = lbo(analytic.bumpy(3), 50)
    flipped = spectrum.functions * rng.choice([-1.0, 1.0], 50)
    np.testing.assert_array_equal(spectra.fix_signs(flipped, spectrum.mass), spectrum.functions)
    assert (spectrum.mass @ spectrum.functions**3)[1:].min() > -1e-5


def test_rounding_at_vertices_without_mass_is_forgiven_and_wrong_pairs_are_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """An error where there is hardly any mass costs hardly any energy; the same error elsewhere does."""
    surface = analytic.bumpy(2)
    stiffness, mass = operators.stiffness(*surface), operators.lumped_mass(*surface)
    mass = mass.copy()
    mass[7] *= 1e-6
    found = solve(stiffness, mass, 10)
    root = np.sqrt(mass)
    operator = sparse.csc_matrix(sparse.diags_array(1 / root) @ stiffness @ sparse.diags_array(1 / root))
    unit = spectra.eigenvalue_unit(mass)
    for vertex, forgiven in ((7, True), (8, False)):
        vectors = found.functions * root[:, None]
        vectors[vertex] += 1e-5 * root[vertex]
        plain = spectra._largest_residual(operator, found.eigenvalues, vectors, unit)
        energy = spectra._energy_residual(operator, found.eigenvalues, vectors, unit)
        assert plain > 1e-6
        assert energy <= plain
        assert (energy < 1e-3 * plain) == forgiven
    monkeypatch.setattr(spectra, "_largest_residual", lambda *_: 1e-3)
    np.testing.assert_array_equal(solve(stiffness, mass, 10).functions, found.functions)
    monkeypatch.setattr(spectra, "_energy_residual", lambda *_: 1e-3)
    with pytest.raises(ConvergenceError, match=r"residual 1\.0e-03"):
        solve(stiffness, mass, 10)
