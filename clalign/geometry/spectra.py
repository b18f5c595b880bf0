"""Eigenfunctions of the Laplace–Beltrami operators, each pair checked by its residual."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh

from clalign.errors import ConvergenceError
from clalign.geometry.factors import REMEDY, factorise
from clalign.geometry.lanczos import lowest_pairs
from clalign.geometry.workers import single_threaded_blas

logger = logging.getLogger(__name__)

#: Largest relative residual of an eigenpair that is accepted.
TOLERANCE = 1e-6
#: Meshes with fewer vertices are solved densely.
DENSE_BELOW = 600


@dataclass(frozen=True)
class Spectrum:
    """The lowest eigenpairs of W φ = λ M φ.

    Attributes
    ----------
    eigenvalues : (k,) float64, ascending, the first one close to 0.
    functions : (n, k) float64; ``functions.T @ diag(mass) @ functions`` is the identity.
    mass : (n,) float64, the diagonal of M.
    """

    eigenvalues: NDArray[np.float64]
    functions: NDArray[np.float64]
    mass: NDArray[np.float64]

    @property
    def count(self) -> int:
        """Number of eigenpairs."""
        return len(self.eigenvalues)

    def coefficients(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (k, f) inner products of the functions with values at the vertices (n, f)."""
        return self.functions.T @ (self.mass[:, None] * values)

    def diffused(self, coefficients: NDArray[np.float64], time: float) -> NDArray[np.float64]:
        """Return what the heat equation makes of coefficients (k, f) after a time, at the vertices (n, f)."""
        return self.functions @ (np.exp(-time * self.eigenvalues)[:, None] * coefficients)

    def head(self, count: int, signs: NDArray[np.float64] | None = None) -> Spectrum:
        """Return the first `count` eigenpairs, the functions multiplied by `signs` (count,) if given."""
        functions = self.functions[:, :count]
        kept = functions.copy() if signs is None else functions * signs
        return Spectrum(self.eigenvalues[:count], np.ascontiguousarray(kept), self.mass)


def solve(stiffness: sparse.csr_matrix, mass: NDArray[np.float64], count: int, threads: int = 1) -> Spectrum:
    """Return the lowest eigenpairs of W φ = λ M φ, with every residual checked, and signs as `fix_signs` gives them.

    Meshes below `DENSE_BELOW` vertices are solved densely. No more than a third of the vertices can be asked for, as
    the higher discrete eigenfunctions say nothing about the surface; a larger count is lowered and logged.

    Parameters
    ----------
    stiffness : (n, n) symmetric positive semi-definite W.
    mass : (n,) positive diagonal of M.
    threads : slices of the spectrum that block Lanczos (`lanczos.lowest_pairs`) computes side by side.

    Raises
    ------
    ConvergenceError
        A residual ‖Wφ − λMφ‖ in the norm of M⁻¹, relative to λ + 4π / ΣM, and that in the norm of energy are above
        `TOLERANCE`, or the solver itself gave up: a factorisation was singular, or the iteration ended before all pairs
        had converged.
    """
    n = len(mass)
    capped = min(count, max(n // 3, 1))
    if capped < count:
        logger.info("%d eigenfunctions asked for; a mesh of %d vertices is given %d", count, n, capped)
    root = np.sqrt(mass)
    inverse_root = sparse.diags_array(1.0 / root)
    operator = sparse.csc_matrix(inverse_root @ stiffness @ inverse_root)
    unit = eigenvalue_unit(mass)
    # The many small products lose more by sharing out than they gain, and slices use the other processors.
    with single_threaded_blas():
        if n < DENSE_BELOW:
            values, vectors = _dense(operator, capped)
        else:
            values, vectors = _block(operator, capped, unit, threads)
    residual = _largest_residual(operator, values, vectors, unit)
    if not residual <= TOLERANCE:
        # Vertices of slivers have hardly any mass, and the norm of M⁻¹ sees the rounding errors there a million times.
        residual = _energy_residual(operator, values, vectors, unit)
        logger.info("the largest residual of %d eigenpairs is %.1e in the norm of energy", capped, residual)
    if not residual <= TOLERANCE:
        raise ConvergenceError(f"an eigenpair of {capped} has residual {residual:.1e}, above {TOLERANCE:.0e}; {REMEDY}")
    functions = fix_signs(vectors / root[:, None], mass)
    return Spectrum(eigenvalues=np.maximum(values, 0.0), functions=functions, mass=mass)


def arpack_spectrum(stiffness: sparse.csr_matrix, mass: NDArray[np.float64], count: int) -> Spectrum:
    """Return the lowest eigenpairs with the signs that ARPACK leaves, from one start vector in the order of vertices.

    `solve` has a rule for signs. This is what a program without one works with: two shapes of one connectivity and one
    numbering start alike.

    Raises
    ------
    ConvergenceError
        ARPACK gave up.
    """
    root = np.sqrt(mass)
    inverse_root = sparse.diags_array(1.0 / root)
    values, vectors = _arpack(sparse.csc_matrix(inverse_root @ stiffness @ inverse_root), count, eigenvalue_unit(mass))
    return Spectrum(np.maximum(values, 0.0), np.ascontiguousarray(vectors / root[:, None]), mass)


def eigenvalue_unit(mass: NDArray[np.float64]) -> float:
    """Return 4π / ΣM, by Weyl's law the mean distance between eigenvalues of a closed surface of that area."""
    return float(4.0 * np.pi / mass.sum())


def fix_signs(functions: NDArray[np.float64], mass: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return functions (n, k), orthonormal in M, with signs that depend on them alone, not on the solver.

    A function is given the sign that makes its third moment Σ M φ³ positive; where that vanishes (odd functions of a
    symmetric shape) the sign that makes its entry of largest magnitude positive.
    """
    third = mass @ (functions * functions * functions)
    largest = np.take_along_axis(functions, np.abs(functions).argmax(axis=0)[None], axis=0)[0]
    clear = np.abs(third) * np.sqrt(mass.sum()) > 1e-6
    signs = np.where(np.where(clear, third, largest) < 0, -1.0, 1.0)
    return np.ascontiguousarray(functions * signs)


def _dense(operator: sparse.csc_matrix, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    try:
        values, vectors = scipy.linalg.eigh(operator.toarray(), subset_by_index=(0, count - 1))
    except np.linalg.LinAlgError as error:
        raise ConvergenceError(f"the dense eigensolver gave up ({error}); {REMEDY}") from error
    return values, vectors


def _block(
    operator: sparse.csc_matrix, count: int, unit: float, threads: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    try:
        return lowest_pairs(operator, count, unit, threads)
    except (RuntimeError, np.linalg.LinAlgError) as error:
        logger.warning("block Lanczos failed (%s); ARPACK takes over", error)
        return _arpack(operator, count, unit)


def _arpack(operator: sparse.csc_matrix, count: int, unit: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    n = operator.shape[0]
    inverse = LinearOperator((n, n), matvec=factorise(operator, -unit).solve, dtype=np.float64)
    start = np.cos(np.arange(n, dtype=np.float64) ** 2)
    try:
        values, vectors = eigsh(operator, count, sigma=-unit, OPinv=inverse, v0=start, which="LM")
    except ArpackError as error:
        raise ConvergenceError(f"ARPACK gave up on {count} eigenpairs ({error}); {REMEDY}") from error
    order = np.argsort(values, kind="stable")
    return values[order], vectors[:, order]


def _largest_residual(operator: Any, values: NDArray[np.float64], vectors: NDArray[np.float64], unit: float) -> float:
    residuals = operator @ vectors
    residuals -= vectors * values
    return float((np.linalg.norm(residuals, axis=0) / (np.abs(values) + unit)).max())


def _energy_residual(
    operator: sparse.csc_matrix, values: NDArray[np.float64], vectors: NDArray[np.float64], unit: float
) -> float:
    """Return the largest residual r of A x = λ x in the norm that the energy is dual to, √(rᵀ (A + uI)⁻¹ r / (λ + u)).

    It bounds the error of an eigenfunction in the norm of energy, which is what functions are compared in.
    """
    residuals = operator @ vectors
    residuals -= vectors * values
    solved = factorise(operator, -unit).solve(residuals)
    squared = np.einsum("nk,nk->k", residuals, solved) / (np.abs(values) + unit)
    return float(np.sqrt(np.maximum(squared, 0.0)).max())
