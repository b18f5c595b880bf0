"""A shape seen through its farthest-point samples: all that the search reads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clalign.geometry.geodesics import prefix_shares
from clalign.geometry.shape import Shape
from clalign.memoize import memoize


@dataclass(frozen=True, eq=False)
class SampledShape:
    """Eigenfunctions, distances and descriptors of a shape at its farthest-point samples.

    Every prefix of the samples is itself a farthest-point sample, so a coarse step uses the first ``m`` of them.

    Attributes
    ----------
    functions : (S, K) float64, LBO eigenfunctions at the samples.
    eigenvalues : (K,) float64.
    distances : (S, S) float64, geodesic, in units of sqrt(area).
    weights : (S,) float64, area of each sample's geodesic Voronoi cell; sums to 1.
    tensor : (p, p, p) float64, O[a, b, c] = <phi_c, n . (grad phi_a x grad phi_b)>.
    signatures : (S, 6) float64, log heat kernel signatures.
    curvatures : (S, 2) float64, smoothed mean and Gaussian curvature.
    """

    functions: NDArray[np.float64]
    eigenvalues: NDArray[np.float64]
    distances: NDArray[np.float64]
    weights: NDArray[np.float64]
    tensor: NDArray[np.float64]
    signatures: NDArray[np.float64]
    curvatures: NDArray[np.float64]

    @property
    def count(self) -> int:
        """Number of samples."""
        return self.weights.size

    def mirrored(self) -> SampledShape:
        """Return the same shape with its orientation reversed: only the triple products change, by their sign."""
        return SampledShape(
            self.functions,
            self.eigenvalues,
            self.distances,
            self.weights,
            -self.tensor,
            self.signatures,
            self.curvatures,
        )

    @memoize
    def prefix_weights(self, count: int) -> NDArray[np.float64]:
        """Return the area that falls to each of the first `count` samples, from the cells of all samples."""
        return prefix_shares(self.distances, self.weights, count)

    @memoize
    def analysis(self, count: int, size: int) -> NDArray[np.float64]:
        """Return (size, count): coefficients of a function from its values at samples, by weighted least squares."""
        basis = self.functions[:count, :size]
        weighted = basis * self.prefix_weights(count)[:, None]
        gram = basis.T @ weighted
        gram[np.diag_indices(size)] += 1e-9 * np.trace(gram) / size
        return np.asarray(np.linalg.solve(gram, weighted.T), dtype=np.float64)


def sampled(shape: Shape) -> SampledShape:
    """Return what the search needs of `shape`."""
    vertices = shape.geodesics.samples
    return SampledShape(
        functions=np.ascontiguousarray(shape.basis.functions[vertices]),
        eigenvalues=shape.basis.eigenvalues,
        distances=shape.geodesics.distances,
        weights=shape.geodesics.weights,
        tensor=shape.orientation,
        signatures=shape.signatures[vertices],
        curvatures=shape.curvatures[vertices],
    )
