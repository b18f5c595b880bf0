"""What the losses read of each shape: slices of its spectra, projections, weights and distance factors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clalign.geometry.sampling import VertexOrder
from clalign.geometry.shape import Shape
from clalign.options import AlignmentOptions


@dataclass(frozen=True)
class ShapeData:
    """One shape as the alignment problem sees it.

    Attributes
    ----------
    basis : (n, k) LBO eigenfunctions.
    scale_invariant : (n, d) scale-invariant eigenfunctions.
    projection : (k, d) ΦᵀAΦ̃ (Eq. 12, 13).
    loss_weights : (n,) vertex weights of l_align: areas, or 1/n.
    soft_weights : (n,) row weights of the soft map: areas, or ones as in the paper.
    normal : (k, k) Φᵀ diag(soft_weights) Φ, or None where it is the identity.
    left, core : (n, r) and (r, r), D ≈ left core leftᵀ.
    order : of the vertices, for searches among them.
    """

    basis: NDArray[np.float64]
    scale_invariant: NDArray[np.float64]
    projection: NDArray[np.float64]
    loss_weights: NDArray[np.float64]
    soft_weights: NDArray[np.float64]
    normal: NDArray[np.float64] | None
    left: NDArray[np.float64]
    core: NDArray[np.float64]
    order: VertexOrder


@dataclass(frozen=True)
class SampledFactors:
    """Distance factors at the source vertices where the losses are evaluated.

    Attributes
    ----------
    vertices : (m,) vertices.
    weights : (m,), summing to 1.
    left : (m, r), orthonormal in the weights.
    core : (r, r), D ≈ left core leftᵀ at those vertices.
    """

    vertices: NDArray[np.int64]
    weights: NDArray[np.float64]
    left: NDArray[np.float64]
    core: NDArray[np.float64]


def shape_data(
    shape: Shape, basis_size: int, scale_invariant: NDArray[np.float64], options: AlignmentOptions
) -> ShapeData:
    """Return the data of `shape` with its first `basis_size` LBO functions and some scale-invariant ones (n, d)."""
    basis = np.ascontiguousarray(shape.basis.functions[:, :basis_size])
    count = len(basis)
    uniform = options.weights == "uniform"
    return ShapeData(
        basis=basis,
        scale_invariant=scale_invariant,
        projection=basis.T @ (shape.mass[:, None] * scale_invariant),
        loss_weights=np.full(count, 1.0 / count) if uniform else shape.mass,
        soft_weights=np.ones(count) if uniform else shape.mass,
        normal=basis.T @ basis if uniform else None,
        left=shape.factors.left,
        core=shape.factors.core,
        order=shape.order,
    )


def sampled_factors(shape: Shape, options: AlignmentOptions) -> SampledFactors:
    """Return the distance factors at the vertices of the losses.

    All vertices when `options.samples` is 0 or not less than their number, or, whatever it is, when the geodesic
    samples are all vertices. Else farthest-point samples, weighted by the areas of their cells: they depend
    on the surface alone, not on how its vertices are numbered.
    """
    count = shape.mesh.n_vertices
    available = shape.geodesics.samples.size
    if options.samples == 0 or options.samples >= count or available >= count:
        vertices = np.arange(count)
        weights = np.full(count, 1.0 / count) if options.weights == "uniform" else shape.mass
    else:
        spread = shape.samples(options.samples)
        vertices, weights = spread.vertices, spread.weights
    left = shape.factors.left[vertices]
    gram = left.T @ (weights[:, None] * left)
    triangle = np.linalg.cholesky(gram + 1e-12 * np.trace(gram) * np.eye(len(gram)))
    orthonormal = np.linalg.solve(triangle, left.T).T
    return SampledFactors(
        vertices, weights, np.ascontiguousarray(orthonormal), triangle.T @ shape.factors.core @ triangle
    )
