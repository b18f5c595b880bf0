"""As similar as possible: positions whose edges are turned and scaled copies of a surface's, vertex by vertex.

    E(x) = Σ_i Σ_j w_ij |(x_i − x_j) − s_i R_i (v_i − v_j)|² + Σ_i a_i |x_i − c_i|²

with the neighbours j of i, rotations R_i and scales s_i (Sorkine and Alexa 2007; scales as in Yoshiyasu et al. 2014).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from clalign.geometry.factors import factorise
from clalign.geometry.operators import stiffness

LEAST_WEIGHT, LARGEST_WEIGHT = 0.05, 5.0
"""Cotangent weights of edges are kept between these: negative ones would pull faces over."""
MOST_SCALED = 2.0
"""Largest s_i, and its inverse the least; what is beyond is a wrong match rather than a shape."""


@dataclass(frozen=True)
class Springs:
    """Edges of a surface in both directions.

    tail, head : (e,) int, vertices i and j.
    weight : (e,) w_ij, positive and symmetric.
    rest : (e, 3) v_i − v_j.
    count : vertices.
    """

    tail: NDArray[np.int64]
    head: NDArray[np.int64]
    weight: NDArray[np.float64]
    rest: NDArray[np.float64]
    count: int

    @staticmethod
    def of(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> Springs:
        """Return the edges of a surface (n, 3), (m, 3) with clipped cotangent weights."""
        matrix = stiffness(vertices, faces).tocoo()
        apart = matrix.row != matrix.col
        tail, head = matrix.row[apart].astype(np.int64), matrix.col[apart].astype(np.int64)
        weight = np.clip(-matrix.data[apart], LEAST_WEIGHT, LARGEST_WEIGHT)
        return Springs(tail, head, weight, vertices[tail] - vertices[head], len(vertices))

    @property
    def laplacian(self) -> sparse.csr_matrix:
        """(n, n) graph Laplacian of the weights."""
        entries = (-self.weight, (self.tail, self.head))
        off = sparse.coo_matrix(entries, shape=(self.count, self.count)).tocsr()
        return sparse.csr_matrix(off - sparse.diags(np.asarray(off.sum(axis=1)).ravel()))

    def summed(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sum values of edges (e, …) over those that leave each vertex, (n, …)."""
        flat = values.reshape(len(values), -1)
        columns = [np.bincount(self.tail, weights=column, minlength=self.count) for column in flat.T]
        summed = np.stack(columns, axis=1).reshape(self.count, *values.shape[1:])
        return np.asarray(summed, dtype=np.float64)

    def rotations(self, positions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (n, 3, 3) the turns of the surface around its vertices to positions (n, 3): v @ R is nearest to x."""
        now = positions[self.tail] - positions[self.head]
        weighted = self.weight[:, None] * self.rest
        left, _, right = np.linalg.svd(self.summed(weighted[:, :, None] * now[:, None, :]))
        left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
        return np.asarray(left @ right)

    def scales(self, positions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (n,) by what factor the surface has grown around its vertices, from 1 / `MOST_SCALED` to that."""
        now = positions[self.tail] - positions[self.head]
        before, after = (self.summed(self.weight * np.einsum("ek,ek->e", each, each)) for each in (self.rest, now))
        return np.sqrt(np.clip(after / np.maximum(before, 1e-300), MOST_SCALED**-2, MOST_SCALED**2))


class Solver:
    """The minimum over positions for given rotations; the matrix is factorised once.

    Parameters
    ----------
    springs : edges.
    pull : (n,) a_i, how strongly each vertex is drawn to a place.
    """

    def __init__(self, springs: Springs, pull: NDArray[np.float64]) -> None:
        self.springs, self.pull = springs, pull
        self._factors = factorise(sparse.csc_matrix(springs.laplacian + sparse.diags(pull)), 0.0)

    def __call__(
        self, positions: NDArray[np.float64], places: NDArray[np.float64], filling: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """Return positions (n, 3) for the turns and scales of the given ones, drawn to places (n, 3).

        filling : (n,) vertices without places, whose scale is that of the others as a whole: nothing holds it else.
        """
        springs = self.springs
        scales = springs.scales(positions)
        if filling.any() and not filling.all():
            scales[filling] = np.median(scales[~filling])
        both = scales[:, None, None] * springs.rotations(positions)
        turned = np.einsum("ek,ekl->el", springs.rest, both[springs.tail] + both[springs.head]) / 2
        right = springs.summed(springs.weight[:, None] * turned) + self.pull[:, None] * places
        return np.asarray(self._factors.solve(right))
