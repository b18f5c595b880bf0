"""One mesh with everything that is computed from it once."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from clalign.options import Options

from . import operators
from .geodesics import DistanceFactors, Geodesics, farthest_point_geodesics, low_rank
from .mesh import Mesh
from .spectra import Spectrum, solve

logger = logging.getLogger(__name__)

#: Functions that the orientation tensor is computed for.
ORIENTATION_FUNCTIONS = 30
#: Diffusion times of the signatures and of the smoothed curvatures, in units of area.
SIGNATURE_TIMES = np.geomspace(0.002, 0.05, 6)
CURVATURE_TIME = 0.001
CURVATURE_QUANTILE = 0.98


@dataclass(frozen=True)
class Shape:
    """A mesh of unit area with its operators, spectra, distances and descriptors.

    Attributes
    ----------
    mesh : the surface.
    stiffness : (n, n) cotangent matrix.
    mass : (n,) vertex areas, summing to 1.
    curvature : (n,) Gaussian curvature.
    basis : Laplace–Beltrami eigenfunctions.
    descriptors : scale-invariant eigenfunctions; their own mass is the conformal factor times `mass`.
    geodesics : distances from farthest-point samples.
    factors : low-rank factors of all distances.
    orientation : (p, p, p) triple products of the first p ≤ 30 functions of the basis.
    signatures : (n, 6) logarithm of the heat kernel signature at `SIGNATURE_TIMES`.
    curvatures : (n, 2) smoothed mean and Gaussian curvature.
    """

    mesh: Mesh
    stiffness: sparse.csr_matrix
    mass: NDArray[np.float64]
    curvature: NDArray[np.float64]
    basis: Spectrum
    descriptors: Spectrum
    geodesics: Geodesics
    factors: DistanceFactors
    orientation: NDArray[np.float64]
    signatures: NDArray[np.float64]
    curvatures: NDArray[np.float64]


def prepare(mesh: Mesh, options: Options, cache: object | None = None) -> Shape:
    """Compute everything that matching needs to know about one mesh."""
    vertices, faces = mesh.vertices, mesh.faces
    weights = operators.stiffness(vertices, faces)
    mass = operators.lumped_mass(vertices, faces)
    curvature = operators.gaussian_curvature(vertices, faces, mass)
    basis = solve(weights, mass, max(options.spectrum.basis, options.spectrum.refinement), options.spectrum.solver)
    factor = operators.conformal_factor(curvature, mass, options.spectrum, basis)
    descriptors = solve(weights, mass * factor, options.spectrum.descriptors, options.spectrum.solver)
    geodesics = farthest_point_geodesics(mesh, options.geodesics.search_samples, options.geodesics.factor_samples)
    mean = operators.mean_curvature(vertices, faces, mass, weights)
    return Shape(
        mesh=mesh,
        stiffness=weights,
        mass=mass,
        curvature=curvature,
        basis=basis,
        descriptors=descriptors,
        geodesics=geodesics,
        factors=low_rank(geodesics, mass),
        orientation=operators.orientation_tensor(faces, basis.functions[:, :ORIENTATION_FUNCTIONS]),
        signatures=heat_signatures(basis, SIGNATURE_TIMES),
        curvatures=smoothed_curvatures(basis, mean, curvature),
    )


def heat_signatures(basis: Spectrum, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (n, len(times)) logarithms of h_t(x, x) = Σ exp(−λ_i t) φ_i(x)²."""
    decay = np.exp(-np.outer(basis.eigenvalues, times))
    return np.log(np.square(basis.functions) @ decay)


def smoothed_curvatures(
    basis: Spectrum, mean: NDArray[np.float64], gaussian: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return (n, 2) mean and Gaussian curvature, cut at a quantile and diffused for `CURVATURE_TIME`.

    Curvature estimates have a few wild values at slivers and spikes; cutting first keeps them from spreading.
    """
    both = np.stack([mean, gaussian], axis=1)
    limit = np.quantile(np.abs(both), CURVATURE_QUANTILE, axis=0)
    coefficients = basis.functions.T @ (basis.mass[:, None] * np.clip(both, -limit, limit))
    return basis.functions @ (np.exp(-CURVATURE_TIME * basis.eigenvalues)[:, None] * coefficients)
