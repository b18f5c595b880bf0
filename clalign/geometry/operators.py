"""Discrete differential operators of a triangle mesh, as functions over (n, 3) vertices and (m, 3) faces.

The stiffness and the lumped mass are those of linear finite elements, so that the Laplace–Beltrami operator of the
mesh is A⁻¹W. The scale-invariant operator has the same W (it is conformally invariant in two dimensions) and a mass
multiplied by a conformal factor made from the Gaussian curvature.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from clalign.errors import InputError
from clalign.geometry.factors import factorise
from clalign.mesh.topology import boundary_vertices, vertex_areas, vertex_normals
from clalign.options import SpectrumOptions

if TYPE_CHECKING:
    from clalign.geometry.spectra import Spectrum

#: A face whose doubled area is below this fraction of its longest squared edge counts as having that area.
SLIVER = 1e-5
#: A vertex area below this fraction of the mean one is raised to it, so that the mass matrix can be inverted.
SMALLEST_MASS = 1e-8
#: Angle defects are cut at this quantile of their magnitudes before they are correlated.
DEFECT_QUANTILE = 0.98
#: Diffusion time of the "heat-kernel" metric in units of the surface area.
HEAT_TIME = 5e-3

_FACES_AT_ONCE = 1024


def stiffness(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> sparse.csr_matrix:
    """Return the (n, n) cotangent matrix W, positive semi-definite with zero row sums, free of units.

    The matrix of one face is the Gram matrix of its edge vectors over twice its doubled area, e_i·e_j / (2 |e_i×e_j|).
    In this form a sliver is tamed by raising the area alone: cotangents stay finite and the matrix positive.
    """
    corners = vertices[faces]
    edges = corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]
    doubled = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    longest = np.einsum("fij,fij->fi", edges, edges).max(axis=1)
    doubled = np.maximum(doubled, np.maximum(SLIVER * longest, np.finfo(np.float64).tiny))
    local = np.einsum("fix,fjx->fij", edges, edges) / (2.0 * doubled[:, None, None])
    n = len(vertices)
    rows = np.repeat(faces, 3, axis=1).ravel()
    columns = np.tile(faces, (1, 3)).ravel()
    matrix = sparse.coo_matrix((local.ravel(), (rows, columns)), shape=(n, n)).tocsr()
    # Rounding differs between the two sides of the diagonal when faces are added in another order.
    return sparse.csr_matrix((matrix + matrix.T) * 0.5)


def intrinsic_operators(
    vertices: NDArray[np.float64], faces: NDArray[np.int32]
) -> tuple[sparse.csr_matrix, NDArray[np.float64]]:
    """Return the stiffness (n, n) and the lumped mass (n,) of the intrinsic Delaunay triangulation of a surface.

    Edges are flipped along the surface until none of its cotangent weights is negative; triangles that are no triangles
    in floating point are mollified (Sharp & Crane 2020, "A Laplacian for nonmanifold triangle meshes").

    Raises
    ------
    InputError
        The package robust-laplacian is not installed.
    """
    try:
        import robust_laplacian
    except ImportError as error:
        raise InputError(
            "spectrum.laplacian=intrinsic needs the package robust-laplacian: pip install 'clalign[robust]'"
        ) from error
    matrix, mass = robust_laplacian.mesh_laplacian(vertices, faces.astype(np.int64))
    diagonal = np.asarray(mass.diagonal(), dtype=np.float64)
    return sparse.csr_matrix((matrix + matrix.T) * 0.5), np.maximum(diagonal, SMALLEST_MASS * diagonal.mean())


def lumped_mass(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return the (n,) vertex areas, a third of the faces around each vertex: positive, summing to the surface area."""
    mass = vertex_areas(vertices, faces)
    return np.maximum(mass, SMALLEST_MASS * mass.mean())


def gaussian_curvature(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], mass: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the (n,) angle defects of the vertices over their areas, in units of 1/area.

    The full angle is 2π inside and π on the boundary, so that the mass-weighted sum is 2π times the Euler
    characteristic (Gauss–Bonnet) up to the turning of the boundary, which is included.
    """
    corners = vertices[faces]
    angles = np.zeros(faces.shape, dtype=np.float64)
    for corner in range(3):
        first = corners[:, (corner + 1) % 3] - corners[:, corner]
        second = corners[:, (corner + 2) % 3] - corners[:, corner]
        across = np.linalg.norm(np.cross(first, second), axis=1)
        angles[:, corner] = np.arctan2(across, np.einsum("fx,fx->f", first, second))
    around = np.bincount(faces.ravel(), weights=angles.ravel(), minlength=len(vertices))
    full = np.where(boundary_vertices(faces, len(vertices)), np.pi, 2.0 * np.pi)
    return (full - around) / mass


def mean_curvature(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    mass: NDArray[np.float64],
    weights: sparse.csr_matrix,
) -> NDArray[np.float64]:
    """Return the (n,) mean curvature H = n·(A⁻¹W x) / 2, in 1/length, positive on a sphere with outward faces."""
    return np.einsum("nx,nx->n", vertex_normals(vertices, faces), weights @ vertices) / (2.0 * mass)


def defect_correlation(curvature: NDArray[np.float64], mass: NDArray[np.float64], faces: NDArray[np.int32]) -> float:
    """Return the correlation of the angle defects of neighbours: how far the curvature of vertices can be trusted.

    On a surface that is sampled well curvature varies little from a vertex to the next. Noise that lifts a vertex
    raises its defect and lowers those around it, so it correlates negatively. On humans and animals without noise the
    value is 0.3 to 0.7, with noise of a tenth of the edges 0.04, with two tenths −0.14; after splitting every flat face
    into four it is 0, and 1 for a surface without curvature.

    curvature, mass : (n,) angle defects over areas, and the areas.
    """
    defects = curvature * mass
    limit = np.quantile(np.abs(defects), DEFECT_QUANTILE)
    defects = np.clip(defects, -limit, limit)
    first, second = defects[faces], defects[np.roll(faces, 1, axis=1)]
    variance = 0.5 * np.sum(first**2 + second**2)
    return float(np.sum(first * second) / variance) if variance > 0 else 1.0


def diffused(
    values: NDArray[np.float64], mass: NDArray[np.float64], weights: sparse.csr_matrix, time: float
) -> NDArray[np.float64]:
    """Return (n,) values after one implicit step of the heat equation, (M + t W) f = M values.

    Unlike smoothing over neighbours this forgets what is finer than about sqrt(2t), whatever the mesh; the total
    ``mass @ values`` is kept.

    Parameters
    ----------
    mass : (n,) vertex areas, the diagonal of M.
    weights : (n, n) stiffness matrix W.
    time : t in units of the surface's area ΣM; 0 returns the values.

    Raises
    ------
    ConvergenceError
        M + t W is singular to working precision.
    """
    if time == 0:
        return values
    # M + tW = t √M (A + 1/t) √M with A = √M⁻¹ W √M⁻¹, the symmetric operator that the spectra are solved with.
    root = np.sqrt(mass)
    inverse_root = sparse.diags_array(1.0 / root)
    shift = 1.0 / (time * mass.sum())
    solved = factorise(sparse.csc_matrix(inverse_root @ weights @ inverse_root), -shift).solve(shift * root * values)
    return np.asarray(solved / root, dtype=np.float64)


def conformal_factor(
    curvature: NDArray[np.float64],
    mass: NDArray[np.float64],
    options: SpectrumOptions,
    spectrum: Spectrum | None = None,
) -> NDArray[np.float64]:
    """Return the (n,) positive factor that the metric is multiplied by to make it scale-invariant.

    "euclidean" is 1 (Eq. 3); "regularized" is sqrt(K² + epsilon²) (Eq. 7); "power" is |K|^xi (Eq. 29) with |K| clamped
    to its quantiles, as xi near 1 otherwise puts a fifth of the area on a hundredth of the vertices; "heat-kernel" is
    "power" with the curvature of `heat_kernel_curvature`; "auto" is "power" with the given xi. In every case the result
    is divided by its total, so that the weighted mass sums to 1 whatever the size of the mesh.

    Parameters
    ----------
    curvature, mass : (n,) Gaussian curvature, smoothed or not, and vertex areas.
    options : metric, xi, clamp and epsilon are read.
    spectrum : eigenfunctions of the Laplace–Beltrami operator, needed by "heat-kernel" only.

    Raises
    ------
    InputError
        "heat-kernel" without a spectrum.
    """
    if options.metric == "euclidean":
        factor = np.ones_like(mass)
    elif options.metric == "regularized":
        factor = np.sqrt((curvature * mass.sum()) ** 2 + options.epsilon**2)
    elif options.metric == "heat-kernel":
        if spectrum is None:
            raise InputError("the heat-kernel metric needs the Laplace–Beltrami spectrum of the shape; pass it")
        factor = _clamped_power(heat_kernel_curvature(spectrum), mass, options)
    else:
        factor = _clamped_power(curvature, mass, options)
    return factor / (mass @ factor)


def _clamped_power(
    curvature: NDArray[np.float64], mass: NDArray[np.float64], options: SpectrumOptions
) -> NDArray[np.float64]:
    magnitude = np.abs(curvature)
    low, high = np.quantile(magnitude, [options.clamp, 1.0 - options.clamp])
    # A flat region of more than the quantile's share would leave a mass of zero: keep a small multiple of 1/area.
    floor = max(low, 1e-3 / mass.sum())
    return np.clip(magnitude, floor, max(high, floor)) ** options.xi


def heat_kernel_curvature(spectrum: Spectrum) -> NDArray[np.float64]:
    """Return (n,) Gaussian curvature, in 1/area, read off the heat kernel and smoothed over the diffusion length.

    For small t, h_t(x, x) = (1 + K t / 3 + O(t²)) / (4πt), so K = (3 / t) (4πt h_t(x, x) − 1), where
    h_t(x, x) = Σ exp(−λ_i t) φ_i(x)². The spectrum is cut at the eigenvalue Λ of its last pair. By Weyl's law what
    lies above contributes exp(−Λt) / (4πt) on average over the surface, which is added. The time is proportional to
    the area, `HEAT_TIME` times it, or longer where Λ is so small that the added tail would exceed exp(−6): so K is
    covariant under scaling, and the metric |K|^xi made from it changes by a constant only.
    """
    last = float(spectrum.eigenvalues[-1])
    time = max(HEAT_TIME * float(spectrum.mass.sum()), 6.0 / max(last, np.finfo(np.float64).tiny))
    kernel = np.square(spectrum.functions) @ np.exp(-spectrum.eigenvalues * time)
    tail = np.exp(-last * time) / (4.0 * np.pi * time)
    return (3.0 / time) * (4.0 * np.pi * time * (kernel + tail) - 1.0)


def orientation_products(
    faces: NDArray[np.int32],
    mass: NDArray[np.float64],
    functions: NDArray[np.float64],
    first: NDArray[np.int64],
    second: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Return (n, q) products n · (∇f_a × ∇f_b) at the vertices, means over the faces around, in units of f² / area.

    Their sign changes with the orientation of the faces. `first` and `second` (q,) are a and b of every pair of
    `functions` (n, p).
    """
    corners = functions[faces]
    along, across = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    totals = (along[:, first] * across[:, second] - along[:, second] * across[:, first]) / 6.0
    around = sparse.csr_matrix(
        (np.ones(faces.size), (faces.ravel(), np.repeat(np.arange(len(faces)), 3))), shape=(len(mass), len(faces))
    )
    return np.asarray(around @ totals, dtype=np.float64) / mass[:, None]


def orientation_tensor(faces: NDArray[np.int32], functions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the triple products O[a, b, c] = ⟨φ_c, n·(∇φ_a × ∇φ_b)⟩ of functions on a surface.

    On a face, n·(∇f × ∇g) times its area is half the determinant of the differences of f and g along two edges: the
    integral needs no lengths, only the orientation of the faces. φ_c is taken as the mean of the three corners. The
    tensor is carried along by maps that keep the orientation and changes sign under those that reverse it. For
    functions (n, p) it is (p, p, p), antisymmetric in the first two indices.
    """
    p = functions.shape[1]
    # One half of the determinants, for all a, b and c; the other half is the same with a and b exchanged.
    half = np.zeros((p, p * p), dtype=np.float64)
    for start in range(0, len(faces), _FACES_AT_ONCE):
        corners = functions[faces[start : start + _FACES_AT_ONCE]]
        first = corners[:, 1] - corners[:, 0]
        second = corners[:, 2] - corners[:, 0]
        carried = second[:, :, None] * corners.mean(axis=1)[:, None, :]
        half += 0.5 * first.T @ carried.reshape(len(corners), p * p)
    tensor = half.reshape(p, p, p)
    return tensor - tensor.transpose(1, 0, 2)
