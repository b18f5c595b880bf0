"""Results made from a known truth, for tests of what is done with results."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy.linalg
import shapes
from numpy.typing import NDArray

from clalign.correspondence import Alternative, Correspondence
from clalign.geometry.operators import conformal_factor, gaussian_curvature, lumped_mass, stiffness
from clalign.geometry.spectra import Spectrum, solve
from clalign.mesh.mesh import Mesh, mesh_from_arrays
from clalign.options import Options, SpectrumOptions

Fabricate = Callable[..., Correspondence]
Arrays = tuple[NDArray[np.float64], NDArray[np.int64]]

FUNCTIONS = 12


def correspondence(source: Arrays, target: Arrays, truth: NDArray[np.int64]) -> Correspondence:
    """Return a complete result whose maps are the truth; LBO functions stand in for the scale-invariant ones."""
    source_mesh, target_mesh = mesh_from_arrays(*source, name="source"), mesh_from_arrays(*target, name="target")
    source_basis, target_basis = _basis(source_mesh), _basis(target_mesh)
    pulled = target_basis.functions[truth]
    functional_map = np.linalg.lstsq(pulled, source_basis.functions, rcond=None)[0]
    left, _, right = np.linalg.svd(functional_map.T)
    signs = np.sign(np.diag(functional_map))
    backward = np.argsort(truth)
    rolled = np.roll(truth, 1)
    return Correspondence(
        source=source_mesh,
        target=target_mesh,
        target_of_source=truth,
        source_of_target=backward,
        functional_map=functional_map * signs,
        rotation=left @ right * signs[:, None],
        source_basis=replace(source_basis, functions=source_basis.functions * signs),
        target_basis=target_basis,
        source_scale_invariant=replace(source_basis, functions=source_basis.functions * signs),
        target_scale_invariant=target_basis,
        history=(
            {"outer_iteration": 0.0, "evaluation": 0.0, "total": 3.0, "align": 1.0, "unsup": 0.01},
            {"outer_iteration": 0.0, "evaluation": 1.0, "total": 2.5, "align": 0.9, "unsup": 0.008, "cycle": 0.5},
        ),
        losses={"total": 2.5, "align": 0.9, "unsup": 0.008, "cycle": float("nan")},
        confidence=0.75,
        orientation=0.98,
        distortion=np.linspace(0.0, 0.1, source_mesh.n_vertices),
        alternatives=(Alternative(rolled, np.argsort(rolled), 0.5, -0.25, 0.3),),
        timings={"source": 0.5, "target": 0.25},
        warnings=("a warning with an umlaut: ü",),
        device="none",
        options=Options().replace({"alignment.weight": 50.0, "seed": 7}),
        versions={"clalign": "0.0", "numpy": np.__version__},
        source_faces=np.arange(source_mesh.file_count) % target_mesh.n_faces,
        source_barycentric=np.full((source_mesh.file_count, 3), 1 / 3),
        score=0.4,
    )


def _basis(mesh: Mesh) -> Spectrum:
    mass = lumped_mass(mesh.vertices, mesh.faces)
    return solve(stiffness(mesh.vertices, mesh.faces), mass, FUNCTIONS)


def spectra(mesh: Mesh, basis: int, scale_invariant: int) -> tuple[Spectrum, Spectrum]:
    """LBO and scale-invariant eigenfunctions of a mesh."""
    weights = stiffness(mesh.vertices, mesh.faces)
    mass = lumped_mass(mesh.vertices, mesh.faces)
    curvature = gaussian_curvature(mesh.vertices, mesh.faces, mass)
    functions = solve(weights, mass, basis)
    factor = conformal_factor(curvature, mass, SpectrumOptions(), functions)
    return functions, solve(weights, mass * factor, scale_invariant)


def fabricate(
    source: Mesh,
    target: Mesh,
    target_of_source: NDArray[np.int64],
    source_of_target: NDArray[np.int64],
    *,
    basis: int = 20,
    scale_invariant: int = 16,
    alternatives: int = 1,
    spectra_of: Callable[[Mesh, int, int], tuple[Spectrum, Spectrum]] = spectra,
) -> Correspondence:
    """The result that a match with these maps (in file numbering) would give: C and R by least squares from them."""
    source_basis, source_si = spectra_of(source, basis, scale_invariant)
    target_basis, target_si = spectra_of(target, basis, scale_invariant)
    pulled = target.map_from_file(source, source_of_target)
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
        source_scale_invariant=Spectrum(source_si.eigenvalues, source_si.functions * signs, source_si.mass),
        target_scale_invariant=target_si,
        history=tuple(
            {"outer_iteration": step // 8, "evaluation": step, "total": 3.0 * 0.9**step + 1, "align": 0.2 * 0.95**step}
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


@functools.cache
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
