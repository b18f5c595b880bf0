"""Results put together from a known map, so that presentation is tested without running a match."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import scipy.linalg
import shapes
from numpy.typing import NDArray

from clalign.correspondence import Alternative, Correspondence
from clalign.geometry.operators import conformal_factor, gaussian_curvature, lumped_mass, stiffness
from clalign.geometry.spectra import Spectrum, solve
from clalign.mesh.mesh import Mesh, mesh_from_arrays
from clalign.options import Options, SpectrumOptions

Fabricate = Callable[..., Correspondence]


def spectra(mesh: Mesh, basis: int, descriptors: int) -> tuple[Spectrum, Spectrum]:
    """LBO and scale-invariant eigenfunctions of a mesh."""
    weights = stiffness(mesh.vertices, mesh.faces)
    mass = lumped_mass(mesh.vertices, mesh.faces)
    curvature = gaussian_curvature(mesh.vertices, mesh.faces, mass)
    functions = solve(weights, mass, basis)
    factor = conformal_factor(curvature, mass, SpectrumOptions(), functions)
    return functions, solve(weights, mass * factor, descriptors)


def fabricate(
    source: Mesh,
    target: Mesh,
    target_of_source: NDArray[np.int64],
    source_of_target: NDArray[np.int64],
    *,
    basis: int = 20,
    descriptors: int = 16,
    alternatives: int = 1,
    spectra_of: Callable[[Mesh, int, int], tuple[Spectrum, Spectrum]] = spectra,
) -> Correspondence:
    """The result that a match with these maps (in file numbering) would give: C and R by least squares from them."""
    source_basis, source_si = spectra_of(source, basis, descriptors)
    target_basis, target_si = spectra_of(target, basis, descriptors)
    compact = np.full(source.file_count, -1)
    compact[source.file_index] = np.arange(source.n_vertices)
    pulled = compact[source_of_target[target.file_index]]
    functional_map = target_basis.functions.T @ (target_basis.mass[:, None] * source_basis.functions[pulled])
    turned = source_si.functions[pulled].T @ (target_si.mass[:, None] * target_si.functions)
    signs = np.where(np.diag(turned) < 0, -1.0, 1.0)
    rotation = np.real(scipy.linalg.sqrtm(_nearest_rotation(signs[:, None] * turned)))
    rng = np.random.default_rng(5)
    shuffled = rng.permutation(len(target_of_source))
    return Correspondence(
        source=source,
        target=target,
        target_of_source=target_of_source,
        source_of_target=source_of_target,
        functional_map=functional_map,
        rotation=rotation,
        source_basis=source_basis,
        target_basis=target_basis,
        source_descriptors=Spectrum(source_si.eigenvalues, source_si.functions * signs, source_si.mass),
        target_descriptors=target_si,
        history=tuple(
            {"round": step // 8, "evaluation": step, "total": 3.0 * 0.9**step + 1, "align": 0.2 * 0.95**step}
            | {"unsup": 0.014 * 0.9**step + 0.004, "cycle": 0.0, "unitarity": 0.01 + 0.001 * step}
            for step in range(20)
        ),
        losses={"total": 1.2, "align": 0.09, "unsup": 0.005},
        confidence=0.62,
        orientation=0.97,
        distortion=rng.gamma(2.0, 0.02, size=source.n_vertices) + 0.1 * np.abs(source.vertices[:, 1]),
        alternatives=tuple(
            Alternative(target_of_source[shuffled], source_of_target, 0.4 + rank, -0.9, 0.33)
            for rank in range(alternatives)
        ),
        timings={"load": 0.1, "spectra": 6.2, "search": 2.3, "alignment": 4.4, "readout": 0.3},
        warnings=('the name <b>"x"</b> & </script> is only text',),
        device="a device",
        options=Options(),
        versions={"clalign": "0.1.0", "numpy": np.__version__},
        score=0.31,
    )


def _nearest_rotation(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    left, _, right = np.linalg.svd(matrix)
    return np.asarray(left @ right)


@pytest.fixture(scope="session")
def fabricated() -> Fabricate:
    return fabricate


@pytest.fixture(scope="session")
def small() -> Correspondence:
    """A bumpy sphere of 642 vertices and a bent copy, numbered differently, each with one vertex off its surface."""
    vertices, faces = shapes.bumpy_sphere(3)
    first, first_faces, first_of_old = shapes.renumbered(vertices, faces, 1)
    second, second_faces, second_of_old = shapes.renumbered(shapes.bent(vertices, 0.4), faces, 2)
    target_of_source = np.concatenate([[-1], 1 + second_of_old[np.argsort(first_of_old)]])
    source_of_target = np.concatenate([[-1], 1 + first_of_old[np.argsort(second_of_old)]])
    lone = np.array([[9.0, 9.0, 9.0]])
    source = mesh_from_arrays(np.concatenate([lone, first]), first_faces + 1, "first")
    target = mesh_from_arrays(np.concatenate([lone, second]), second_faces + 1, "second")
    return fabricate(source, target, target_of_source, source_of_target)


def waves(mesh: Mesh, basis: int, descriptors: int) -> tuple[Spectrum, Spectrum]:
    """Smooth functions in place of eigenfunctions, for meshes on which these would take too long."""
    mass = lumped_mass(mesh.vertices, mesh.faces)
    frequencies = np.random.default_rng(8).normal(scale=4.0, size=(3, max(basis, descriptors)))
    functions = np.cos(mesh.vertices @ frequencies)
    functions /= np.sqrt(mass @ functions**2)
    values = np.arange(functions.shape[1], dtype=np.float64)
    return Spectrum(values[:basis], functions[:, :basis], mass), Spectrum(
        values[:descriptors], functions[:, :descriptors], mass
    )


def torus(around: int, across: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """A bent, uneven ring of around * across vertices."""
    u, v = np.meshgrid(np.arange(around) / around, np.arange(across) / across, indexing="ij")
    u, v = 2 * np.pi * u.ravel(), 2 * np.pi * v.ravel()
    thick = 0.35 + 0.12 * np.cos(u)
    radius = 1.0 + thick * np.cos(v)
    vertices = np.stack([1.2 * radius * np.cos(u), 1.7 * radius * np.sin(u), thick * np.sin(v)], axis=1)
    i, j = np.divmod(np.arange(around * across), across)
    here, right = i * across + j, (i + 1) % around * across + j
    up, both = i * across + (j + 1) % across, (i + 1) % around * across + (j + 1) % across
    return vertices, np.concatenate([np.stack([here, right, both], 1), np.stack([here, both, up], 1)])


@pytest.fixture(scope="session")
def large() -> Correspondence:
    """Two rings of 50,176 vertices, the second bent and numbered in another order."""
    vertices, faces = torus(256, 196)
    other, other_faces, new_of_old = shapes.renumbered(shapes.bent(vertices, 0.5), faces, 6)
    meshes = mesh_from_arrays(vertices, faces, "ring"), mesh_from_arrays(other, other_faces, "bent ring")
    return fabricate(*meshes, new_of_old, np.argsort(new_of_old), descriptors=100, spectra_of=waves)
