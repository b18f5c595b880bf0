"""Sparse factorisations of the operators of a surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from clalign.errors import ConvergenceError

#: What to do about a surface whose operators cannot be solved with.
REMEDY = "look for triangles without area with `clalign check`, and repair or remesh"


@dataclass(frozen=True)
class Factors:
    """S − σI factorised: the shift, the number of eigenvalues below it, and the solver.

    `held` has the factors as its only entry. scipy frees their memory only in the thread that made them, so they must
    be dropped there, by `drop`.
    """

    shift: float
    below: int
    held: list[Any]

    @staticmethod
    def of(matrix: sparse.csc_matrix, shift: float) -> Factors:
        """Factorise S − σI; errors as of `factorise`."""
        factors = factorise(matrix, shift)
        return Factors(shift, int(np.count_nonzero(factors.U.diagonal() < 0)), [factors])

    def solve(self, sides: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the solutions for right-hand sides (n, k)."""
        return np.asarray(self.held[0].solve(sides))

    def drop(self) -> None:
        """Free the factors."""
        self.held.clear()


def factorise(matrix: sparse.csc_matrix, shift: float) -> Any:
    """Return SuperLU factors of ``matrix - shift * I`` without pivoting, ordered for a symmetric pattern.

    Raises
    ------
    ConvergenceError
        The matrix is singular to working precision.
    """
    shifted = sparse.csc_matrix(matrix - shift * sparse.eye_array(matrix.shape[0]))
    try:
        return splu(shifted, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError as error:
        raise ConvergenceError(f"the operator of a surface cannot be factorised ({error}); {REMEDY}") from error


def count_below(matrix: sparse.csc_matrix, value: float) -> int:
    """Return how many eigenvalues of a symmetric matrix lie below a value, which must not be one of them."""
    factors = Factors.of(matrix, value)
    factors.drop()
    return factors.below
