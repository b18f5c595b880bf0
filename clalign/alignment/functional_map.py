"""From R to the functional map C and back along its gradient (Eq. 11–13, 26).

With F = ΦᵀAΦ̃ and H = ΨᵀAΨ̃ the coefficients of the aligned eigenfunctions are α = F R and β = H Rᵀ; C solves C α = β
by least squares.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.engine.backend import Backend
from clalign.engine.band import Band


class AlignedCoefficients:
    """α and β of R, the C that they give, and the gradients through both.

    Parameters
    ----------
    source, target : (k, d) F and H.
    band : the entries of R.
    one_sided : only the source is turned: α = F C̃, β = H (Eq. 18).
    ridge : of the least squares, relative to the mean of the diagonal of α αᵀ.
    """

    def __init__(
        self,
        source: NDArray[np.float64],
        target: NDArray[np.float64],
        band: Band,
        backend: Backend,
        *,
        one_sided: bool,
        ridge: float,
    ) -> None:
        self._backend, self._band, self._one_sided, self._ridge = backend, band, one_sided, ridge
        self._source, self._target = backend.array(source), backend.array(target)
        self._source_transposed = backend.transpose(self._source)
        self._diagonals = {size: backend.array(np.eye(size).reshape(-1, 1)) for size in {len(source), len(target)}}

    def coefficients(self, rotation: Any, transposed: Any) -> tuple[Any, Any]:
        """Return α (k_x, d) and β (k_y, d) for R and Rᵀ, arrays of the backend."""
        alpha = self._backend.banded_product(self._source, rotation, right=self._band)
        if self._one_sided:
            return alpha, self._target
        return alpha, self._backend.banded_product(self._target, transposed, right=self._band.transposed)

    def solve(self, alpha: Any, beta: Any) -> tuple[Any, Any]:
        """Return C = β αᵀ (α αᵀ + ρ I)⁻¹ and the Gram matrix α αᵀ."""
        gram = self._backend.product(alpha, alpha, transpose_b=True)
        cross = self._backend.product(beta, alpha, transpose_b=True)
        return self._backend.solve_right(gram, cross, self._ridge), gram

    def solve_gradient(self, slope: Any, functional: Any, gram: Any, alpha: Any, beta: Any) -> tuple[Any, Any]:
        """Return dα and dβ for dC = `slope`, through C G = β αᵀ with G = α αᵀ + ρ I."""
        backend = self._backend
        dcross = backend.solve_right(gram, slope, self._ridge)
        dgram = backend.product(functional, dcross, transpose_a=True, scale=-1.0)
        dbeta = backend.product(dcross, alpha)
        dalpha = backend.product(dcross, beta, transpose_a=True)
        backend.product(dgram, alpha, accumulate=True, out=dalpha)
        backend.product(dgram, alpha, transpose_a=True, accumulate=True, out=dalpha)
        # The ridge is relative, ρ tr(G) / k, so it has a slope too: 2 ρ / k tr(dG) α.
        size = gram.shape[0]
        trace = backend.weighted_gram(dgram.reshape(size * size, 1), self._diagonals[size])
        # As one long row: a product writes many columns at once, and of a single column only one value.
        flat = (1, alpha.shape[0] * alpha.shape[1])
        slope_scale = 2.0 * self._ridge / size
        backend.product(trace, alpha.reshape(flat), scale=slope_scale, accumulate=True, out=dalpha.reshape(flat))
        return dalpha, dbeta

    def add_gradient(self, dalpha: Any, dbeta: Any, weight: float, gradient: Any) -> None:
        """Add the weight times Fᵀ dα + dβᵀ H, the slope by R, to `gradient` (d, d) inside the band."""
        parts = [(self._source_transposed, dalpha)]
        if not self._one_sided:
            parts.append((self._backend.transpose(dbeta), self._target))
        for left, right in parts:
            self._backend.banded_product(left, right, kept=self._band, scale=weight, accumulate=True, out=gradient)
