"""The losses as the paper writes them, with D and P stored: for small meshes, and to test the low-rank way against.

Everything here is numpy in float64, whatever the backend of the rest of the problem.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.alignment.objective import AlignmentProblem, Distortions
from clalign.alignment.problem_data import AlignedSide, SampledFactors
from clalign.engine.backend import Backend
from clalign.engine.band import Band
from clalign.engine.reference_arrays import reciprocal
from clalign.errors import OptionError
from clalign.geometry.geodesics import all_pairs
from clalign.geometry.shape import Shape
from clalign.options import AlignmentOptions


@dataclass(frozen=True)
class DenseDistances:
    """Geodesic distances between all vertices of both shapes.

    Attributes
    ----------
    source : (n_x, n_x), symmetric.
    target : (n_y, n_y), symmetric.
    """

    source: NDArray[np.float64]
    target: NDArray[np.float64]


def dense_distances(source: Shape, target: Shape, most: int) -> DenseDistances:
    """Measure all distances of two shapes.

    Parameters
    ----------
    most : vertices that a mesh may have, ``geodesics.dense_below``.

    Raises
    ------
    OptionError
        A mesh has more.
    """
    for mesh in (source.mesh, target.mesh):
        if mesh.n_vertices > most:
            raise OptionError(
                f"{mesh.name}: {mesh.n_vertices} vertices are too many for alignment.distances=dense, which stores "
                f"matrices of vertices x vertices; use alignment.distances=factors, a coarser mesh, or raise "
                f"geodesics.dense_below ({most})"
            )
    return DenseDistances(all_pairs(source.mesh), all_pairs(target.mesh))


@dataclass(frozen=True)
class DenseSoftMap:
    """P of Eq. 15 and 27 for a functional map, with what its gradient needs.

    Attributes
    ----------
    matrix : (rows, columns) P, w_i q_ij² / s_j: every column sums to 1, or is 0 where s_j is.
    slopes : (rows, columns) 2 w_i q_ij / s_j, with Q = Ψ C Φᵀ.
    rows, columns : (rows, k) and (columns, k'), the basis functions Ψ and Φ.
    """

    matrix: NDArray[np.float64]
    slopes: NDArray[np.float64]
    rows: NDArray[np.float64]
    columns: NDArray[np.float64]

    @staticmethod
    def of(
        functional: NDArray[np.float64],
        rows: NDArray[np.float64],
        columns: NDArray[np.float64],
        weights: NDArray[np.float64],
    ) -> DenseSoftMap:
        """Return P of `functional` (k, k'), with row weights w (rows,)."""
        products = rows @ functional @ columns.T
        weighted = weights[:, None] * products
        sums = np.einsum("ij,ij->j", weighted, products)
        inverse = reciprocal(sums)
        return DenseSoftMap(weighted * products * inverse, 2.0 * weighted * inverse, rows, columns)

    def gradient(self, slope: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the gradient by the functional map from that by P, through the normalisation of the columns."""
        common = np.einsum("ij,ij->j", slope, self.matrix)
        return self.rows.T @ (self.slopes * (slope - common)) @ self.columns


def distortion(
    kept: NDArray[np.float64],
    distances: NDArray[np.float64],
    matrix: NDArray[np.float64],
    weights: NDArray[np.float64],
) -> tuple[float, NDArray[np.float64]]:
    """Return Σ_jl w_j w_l (D_X − Pᵀ D P)²_jl (Eq. 22, 31) and its gradient by P.

    Parameters
    ----------
    kept : (m, m) D_X, what the distances should be.
    distances : (n, n) D, symmetric.
    matrix : (n, m) P.
    weights : (m,) w, 1/m each in the paper.
    """
    carried = distances @ matrix
    residual = kept - matrix.T @ carried
    weighted = weights[:, None] * residual * weights
    return float(np.sum(weighted * residual)), -4.0 * carried @ weighted


class DenseProblem(AlignmentProblem):
    """The alignment problem with Eq. 22 and 31 evaluated literally.

    Parameters
    ----------
    distances : between all vertices; those of the source are compared at ``factors.vertices``.
    source, target, factors, band, backend, options : see `AlignmentProblem`; factors of distances are not read.
    """

    def __init__(
        self,
        source: AlignedSide,
        target: AlignedSide,
        factors: SampledFactors,
        distances: DenseDistances,
        band: Band,
        backend: Backend,
        options: AlignmentOptions,
    ) -> None:
        self.distances = distances
        super().__init__(source, target, factors, band, backend, options)

    def _bind_distances(self) -> None:
        vertices = self.factors.vertices
        self._kept = self.distances.source[np.ix_(vertices, vertices)]
        self._sampled = self.source.basis[vertices]

    def _distortions(self, functional: Any, functional_back: Any) -> Distortions:
        source, target, weights = self.source, self.target, self.factors.weights
        there = DenseSoftMap.of(self._host(functional), target.basis, self._sampled, target.soft_weights)
        unsup, slope = distortion(self._kept, self.distances.target, there.matrix, weights)
        if functional_back is None:
            return Distortions({"unsup": unsup}, self.backend.array(there.gradient(slope)))
        back = DenseSoftMap.of(self._host(functional_back), source.basis, target.basis, source.soft_weights)
        cycle, around = distortion(self._kept, self.distances.source, back.matrix @ there.matrix, weights)
        slope = slope + back.matrix.T @ around
        slope_back = around @ there.matrix.T
        return Distortions(
            {"unsup": unsup, "cycle": cycle},
            self.backend.array(there.gradient(slope)),
            self.backend.array(back.gradient(slope_back)),
        )

    def _host(self, functional: Any) -> NDArray[np.float64]:
        return self.backend.numpy(functional).astype(np.float64)
