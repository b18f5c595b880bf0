from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from clalign.benchmark.perturb import renumber
from clalign.correspondence import Correspondence
from clalign.engine import open_backend
from clalign.evaluation.spectral import (
    alignment_errors,
    as_computed,
    coupling_spread,
    energy_inside,
    most_rotated_pair,
    pair_rotation,
    recovered_rotation,
    spectral_errors,
    support_areas,
    true_rotation,
)
from clalign.evaluation.truth import Truth, true_maps
from clalign.geometry import operators
from clalign.geometry.shape import prepare_pair
from clalign.geometry.spectra import Spectrum, solve
from clalign.matching.pair import match_shapes
from clalign.mesh.mesh import Mesh, mesh_from_arrays
from clalign.options import Options

if TYPE_CHECKING:
    from conftest import Pair

COUNT = 24


def spectrum(mesh: Mesh) -> Spectrum:
    mass = operators.lumped_mass(mesh.vertices, mesh.faces)
    return solve(operators.stiffness(mesh.vertices, mesh.faces), mass, COUNT)


@pytest.fixture(scope="module")
def twins() -> tuple[Spectrum, Spectrum, NDArray[np.int64], NDArray[np.int64]]:
    """Spectra of a shape and of a rotated, renumbered copy, and the true maps both ways."""
    vertices, faces = shapes.bumpy_sphere(3)
    mesh = mesh_from_arrays(vertices, faces, "shape")
    turned = mesh_from_arrays(Rotation.from_euler("xyz", [0.4, 1.0, 2.0]).apply(vertices), faces, "copy")
    copy = renumber(turned, seed=3)
    maps = true_maps(mesh, copy.mesh, copy.truth)
    return spectrum(mesh), spectrum(copy.mesh), maps.source_of_target, maps.target_of_source


def planted(functions: NDArray[np.float64], first: int, degrees: float) -> NDArray[np.float64]:
    """The functions with two neighbours turned within their span."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turned = functions.copy()
    turned[:, first : first + 2] = functions[:, first : first + 2] @ np.array([[c, -s], [s, c]])
    return turned


def test_identical_functions_have_no_error_and_opposite_ones_two(twins: tuple[Spectrum, ...]) -> None:
    functions, mass = twins[0].functions, twins[0].mass
    same = np.arange(len(mass))
    np.testing.assert_array_equal(alignment_errors(functions, functions, same, mass), 0.0)
    np.testing.assert_allclose(alignment_errors(-functions, functions, same, mass), 2.0)
    shifted = alignment_errors(functions[:, :-1], functions[:, 1:], same, mass)
    np.testing.assert_allclose(shifted, np.sqrt(2.0), rtol=1e-8)


def test_errors_are_relative(twins: tuple[Spectrum, ...]) -> None:
    source, target, _, forward = twins
    other = target.functions[:, ::-1] + 0.3
    errors = alignment_errors(source.functions, other, forward, source.mass)
    scaled = alignment_errors(3.0 * source.functions, 3.0 * other, forward, source.mass)
    np.testing.assert_allclose(scaled, errors, rtol=1e-12)


def test_true_rotation_of_an_isometric_copy_is_signs_only(twins: tuple[Spectrum, ...]) -> None:
    source, target, backward, forward = twins
    rotation = true_rotation(source.functions, target, backward)
    signs = np.sign(np.diag(rotation))
    np.testing.assert_allclose(rotation, np.diag(signs), atol=1e-7)
    np.testing.assert_allclose(coupling_spread(rotation), 0.0, atol=1e-5)
    errors = alignment_errors(source.functions * signs, target.functions, forward, source.mass)
    np.testing.assert_allclose(errors, 0.0, atol=1e-7)


@pytest.mark.parametrize("degrees", [-70.0, 25.0, 40.0])
def test_a_planted_rotation_is_read_off(twins: tuple[Spectrum, ...], degrees: float) -> None:
    source, target, backward, _ = twins
    signs = np.sign(np.diag(true_rotation(source.functions, target, backward)))
    turned = Spectrum(target.eigenvalues, planted(target.functions, 5, degrees), target.mass)
    rotation = true_rotation(source.functions * signs, turned, backward)
    pair = pair_rotation(rotation, 5)
    assert pair.angle == pytest.approx(degrees, abs=1e-4)
    assert pair.kept == pytest.approx(1.0, abs=1e-6)
    assert not pair.reflected
    assert most_rotated_pair(rotation) == 5
    mirrored = pair_rotation(np.diag([1.0] * 6 + [-1.0] + [1.0] * (COUNT - 7)) @ rotation, 5)
    assert mirrored.reflected
    assert mirrored.angle == pytest.approx(degrees, abs=1e-4)


def test_a_pair_on_a_small_part_counts_less() -> None:
    rotation = np.eye(8)
    for first, degrees in ((2, 40.0), (5, 45.0)):
        rotation = planted(rotation, first, degrees)
    assert most_rotated_pair(rotation) == 5
    assert most_rotated_pair(rotation, support=np.array([1.0] * 5 + [0.1] * 3)) == 2
    assert most_rotated_pair(rotation, largest=4) == 2


def test_support_areas() -> None:
    mass = np.full(100, 0.01)
    functions = np.ones((100, 2))
    functions[25:, 1] = 0.0
    np.testing.assert_allclose(support_areas(functions, mass), [1.0, 0.25])


def test_funnel_measures() -> None:
    matrix = np.zeros((6, 6))
    matrix[2, 2], matrix[2, 4] = 3.0, 4.0
    assert energy_inside(matrix, np.eye(6, dtype=bool)) == pytest.approx(9 / 25)
    assert coupling_spread(matrix)[2] == pytest.approx(2 * 4 / 5)


OPTIONS = Options().replace(
    {
        "spectrum.basis": 40,
        "spectrum.refinement": 60,
        "spectrum.scale_invariant": 40,
        "geodesics.search_samples": 300,
        "geodesics.factor_samples": 40,
        "search.method": "tree",
        "alignment.outer_iterations": 1,
        "alignment.iterations": 8,
        "engine.backend": "reference",
    }
)


def test_the_method_recovers_a_planted_rotation(bumpy_pair: Pair) -> None:
    """Two neighbours of the source are turned by 45 degrees, which no change of signs undoes; the match undoes it."""
    source_mesh = mesh_from_arrays(*bumpy_pair.source, name="source")
    target_mesh = mesh_from_arrays(*bumpy_pair.target, name="target")
    source, target = prepare_pair(source_mesh, target_mesh, OPTIONS)
    own = source.scale_invariant
    turned = Spectrum(own.eigenvalues, planted(own.functions, 3, 45.0), own.mass)
    result = match_shapes(replace(source, scale_invariant=turned), target, open_backend(OPTIONS.engine), OPTIONS)
    maps = true_maps(source_mesh, target_mesh, Truth.from_index(bumpy_pair.truth))
    np.testing.assert_array_equal(maps.target_of_source, bumpy_pair.truth)
    true = true_rotation(
        as_computed(result.source_scale_invariant), result.target_scale_invariant, maps.source_of_target
    )
    wanted, found = pair_rotation(true, 3), pair_rotation(recovered_rotation(result), 3)
    assert min(abs(abs(wanted.angle) % 90 - 45), 45) < 15
    assert found.reflected == wanted.reflected
    assert abs((found.angle - wanted.angle + 180) % 360 - 180) < 8
    errors = spectral_errors(result, maps)
    assert (errors.signed <= errors.unaligned).all()
    assert (errors.signed[3:5] > 0.5).all()
    assert (errors.aligned[3:5] < 0.25).all()
    assert errors.aligned[:30].mean() < 0.5 * errors.signed[:30].mean()


def test_signs_folded_into_a_result_are_taken_out(true_correspondence: Correspondence) -> None:
    folded = true_correspondence.source_scale_invariant
    np.testing.assert_array_equal(
        as_computed(folded), as_computed(Spectrum(folded.eigenvalues, -folded.functions, folded.mass))
    )
