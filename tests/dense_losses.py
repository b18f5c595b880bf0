"""The losses as the paper writes them, with D and P stored, to test the low-rank way against; numpy in float64."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.alignment.losses import Distortions, Loss
from clalign.alignment.problem_data import SampledFactors, ShapeData
from clalign.engine.backend import Backend
from clalign.engine.reference_arrays import reciprocal
from clalign.geometry.geodesics import all_pairs
from clalign.geometry.shape import Shape


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


def dense_distances(source: Shape, target: Shape) -> DenseDistances:
    """Measure all distances of two shapes."""
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


class DenseTerms:
    """Eq. 22 and 31 evaluated literally, for an objective's `distances`.

    Parameters
    ----------
    source, target : of the objective.
    vertices : of the source, where distances are compared.
    weights : (m,) of these vertices, summing to 1.
    distances : between all vertices.
    backend : of the objective.
    """

    def __init__(
        self,
        source: ShapeData,
        target: ShapeData,
        factors: SampledFactors,
        distances: DenseDistances,
        backend: Backend,
    ) -> None:
        self.source, self.target, self.distances, self.backend = source, target, distances, backend
        self.weights = factors.weights
        self.kept = distances.source[np.ix_(factors.vertices, factors.vertices)]
        self.sampled = source.basis[factors.vertices]

    def __call__(self, functional: Any, functional_back: Any) -> Distortions:
        source, target = self.source, self.target
        there = DenseSoftMap.of(self._host(functional), target.basis, self.sampled, target.soft_weights)
        unsup, slope = distortion(self.kept, self.distances.target, there.matrix, self.weights)
        if functional_back is None:
            return Distortions({"unsup": Loss(unsup)}, self.backend.array(there.gradient(slope)))
        back = DenseSoftMap.of(self._host(functional_back), source.basis, target.basis, source.soft_weights)
        cycle, around = distortion(self.kept, self.distances.source, back.matrix @ there.matrix, self.weights)
        slope = slope + back.matrix.T @ around
        slope_back = around @ there.matrix.T
        return Distortions(
            {"unsup": Loss(unsup), "cycle": Loss(cycle)},
            self.backend.array(there.gradient(slope)),
            self.backend.array(back.gradient(slope_back)),
        )

    def _host(self, functional: Any) -> NDArray[np.float64]:
        return self.backend.numpy(functional).astype(np.float64)
