"""The lowest eigenpairs of a sparse symmetric matrix by block Lanczos and spectrum slicing.

The wanted part of the spectrum is cut into slices of about `SLICE` pairs. In the middle of each a shift σ is placed,
S − σI is factorised once, and block Lanczos on its inverse finds the pairs nearest to σ on both sides. A slice needs a
basis of a few hundred vectors, so keeping it orthogonal, the largest cost of one long Lanczos run, becomes cheap, and
slices run side by side.

The pivots of each factorisation count the eigenvalues below its shift (Sylvester's law of inertia). So every pair has
its number in the whole spectrum, slices overlap by a few numbers, and a slice that passed over an eigenvalue shows as
a disagreement with its neighbour. One more count above the last wanted pair closes the proof.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.csgraph import reverse_cuthill_mckee

from clalign.errors import ConvergenceError
from clalign.geometry.factors import Factors, count_below
from clalign.geometry.workers import thread_pool

logger = logging.getLogger(__name__)

#: Wanted pairs of one slice, and pairs that neighbouring slices both compute on either side of their border.
SLICE = 176
OVERLAP = 6
#: Right-hand sides of one solve: enough for matrix products, few enough to converge fast.
BLOCK = 6
#: Rows of the basis that are held in the processor's cache while a block is made orthogonal to them.
PANEL_BYTES = 2**20
#: Columns of the basis, as a multiple of the wanted pairs, at which convergence is first looked at, and at most.
FIRST_CHECK = 2.25
CAPACITY = 6.0
#: Residual, relative to the eigenvalue plus the mean distance between eigenvalues, at which a pair has converged.
CONVERGED = 1e-9
#: What rounding leaves of any residual, relative to the norm of the matrix, which slivers can make very large.
ROUNDING = 4.0 * float(np.finfo(np.float64).eps)
#: Relative difference of an eigenvalue between two slices that have it both.
AGREEMENT = 1e-8
#: Allowed distance of a shift from the middle of its slice, in slices, in each round of placing it.
PLANNING_TOLERANCES = (0.05, 0.1, 0.1, 0.2, 0.2, 0.4, 0.4, 0.4)

Array = NDArray[np.float64]


class _Worker:
    """A thread, and the factors that it has made and still holds.

    `stop`, which all workers share, ends at its next block whatever slice is computed.
    """

    def __init__(self, thread: ThreadPoolExecutor, stop: threading.Event) -> None:
        self._thread = thread
        self._stop = stop
        self._made: list[Factors] = []

    def factorise(self, matrix: sparse.csc_matrix, shift: float) -> Future[Factors]:
        """Factorise S − σI in this thread."""

        def make() -> Factors:
            self._made.append(Factors.of(matrix, shift))
            return self._made[-1]

        return self._thread.submit(make)

    def slice(self, matrix: sparse.csc_matrix, factor: Factors, first: int, end: int, unit: float) -> Future[_Slice]:
        """Compute a slice in this thread; see `_slice`."""
        return self._thread.submit(_slice, matrix, factor, first, end, unit, self._stop)

    def keep(self, kept: Sequence[Factors]) -> None:
        """Drop all factors but those, in this thread."""

        def drop() -> None:
            for factor in self._made:
                if not any(factor is other for other in kept):
                    factor.drop()
            self._made = [factor for factor in self._made if factor.held]

        self._thread.submit(drop).result()


@contextlib.contextmanager
def _workers(count: int) -> Iterator[list[_Worker]]:
    """Yield threads whose factors are freed at the end; if the block fails, slices that are computed are given up.

    After Ctrl-C nothing here waits for them, but the interpreter would at its exit, for as long as they take.
    """
    stop = threading.Event()
    with contextlib.ExitStack() as stack:
        workers = [_Worker(stack.enter_context(thread_pool(1)), stop) for _ in range(count)]

        def free() -> None:
            for worker in workers:
                worker.keep(())

        try:
            yield workers
        except BaseException as error:
            stop.set()
            if isinstance(error, Exception):
                free()
            raise
        free()


@dataclass(frozen=True)
class _Slice:
    """Pairs number `first` and on: values ascending, vectors as rows."""

    first: int
    values: Array
    rows: Array

    @property
    def end(self) -> int:
        return self.first + len(self.values)


def lowest_pairs(matrix: sparse.csc_matrix, count: int, unit: float, threads: int = 1) -> tuple[Array, Array]:
    """Return the lowest eigenpairs of a sparse symmetric positive semi-definite matrix S.

    Parameters
    ----------
    matrix : (n, n) CSC.
    count : wanted pairs, at most a third of n.
    unit : mean distance between eigenvalues, where the shifts are first looked for.
    threads : slices computed side by side.

    Returns
    -------
    values : (count,) float64, ascending.
    vectors : (n, count) float64, orthonormal.

    Raises
    ------
    ConvergenceError
        A slice did not converge, or neighbouring slices disagree.
    """
    # Minimum degree leaves up to five times more fill on regular meshes when vertices come in an unlucky order.
    order = reverse_cuthill_mckee(sparse.csr_matrix(matrix), symmetric_mode=True)
    matrix = sparse.csc_matrix(matrix[order][:, order])
    # Sorted now: scipy would otherwise sort it in place, when first asked to, in several threads at once.
    matrix.sum_duplicates()
    matrix.sort_indices()
    with _workers(max(min(threads, -(-count // SLICE)), 1)) as workers:
        factors = _plan(matrix, count, unit, workers)
        borders = [0] + [(left.below + right.below) // 2 for left, right in itertools.pairwise(factors)]
        ends = [min(border + OVERLAP, count) for border in borders[1:]] + [count]
        jobs = [
            workers[number % len(workers)].slice(matrix, factor, max(border - OVERLAP, 0), end, unit)
            for number, (factor, border, end) in enumerate(zip(factors, borders, ends, strict=True))
        ]
        values, rows = _joined([job.result() for job in jobs], unit)
    _check_count(matrix, values)
    vectors = np.zeros((matrix.shape[0], count), dtype=np.float64)
    vectors[order] = _orthonormal(rows).T
    return values, vectors


def _plan(matrix: sparse.csc_matrix, count: int, unit: float, workers: Sequence[_Worker]) -> list[Factors]:
    """Place a shift near the middle of each slice; slice i is factorised in worker i modulo the number of workers.

    The number of eigenvalues below a value is taken as value / unit where nothing is known, and interpolated between
    the counts that are known.
    """
    slices = -(-count // SLICE)
    width = count / slices
    targets = (np.arange(slices) + 0.5) * width
    shifts, counts = [0.0], [0.0]
    placed: dict[int, Factors] = {}
    for tolerance in PLANNING_TOLERANCES:
        missing = [index for index in range(slices) if index not in placed]
        if not missing:
            break
        beyond = [max(float(targets[index]) - counts[-1], 0.0) * unit for index in missing]
        guesses = [
            float(np.interp(targets[index], counts, shifts)) + more for index, more in zip(missing, beyond, strict=True)
        ]
        made = [
            workers[index % len(workers)].factorise(matrix, shift)
            for index, shift in zip(missing, guesses, strict=True)
        ]
        for index, job in zip(missing, made, strict=True):
            factor = job.result()
            if abs(factor.below - targets[index]) <= tolerance * width:
                placed[index] = factor
            shifts.append(factor.shift)
            counts.append(float(factor.below))
        shifts.sort()
        counts.sort()
        for worker in workers:
            worker.keep(list(placed.values()))
    if len(placed) < slices:
        raise ConvergenceError(f"only {len(placed)} of {slices} shifts into the spectrum could be placed")
    return [placed[index] for index in sorted(placed)]


def _slice(
    matrix: sparse.csc_matrix, factor: Factors, first: int, end: int, unit: float, stop: threading.Event
) -> _Slice:
    """Compute the pairs number `first` to `end` - 1, which lie around the shift of `factor`, unless told to `stop`."""
    below, above = max(factor.below - first, 0), max(end - factor.below, 0)
    wanted = below + above
    size = matrix.shape[0]
    capacity = min(_blocks(CAPACITY * wanted + 8 * BLOCK), (size // BLOCK - 1) * BLOCK)
    rounding = ROUNDING * float(abs(matrix).sum(axis=0).max())
    basis = _Basis(factor.solve, size, capacity, stop)
    target = min(_blocks(FIRST_CHECK * wanted + 4 * BLOCK), capacity)
    while True:
        basis.extend(target)
        inverse, vectors = basis.ritz()
        chosen = np.r_[:below][::-1], np.r_[len(inverse) - above : len(inverse)][::-1]
        index = np.concatenate(chosen)
        inverse, vectors = inverse[index], vectors[:, index]
        values = factor.shift + 1.0 / inverse
        residuals = basis.residuals(matrix, factor.shift, inverse, vectors)
        open_pairs = int(np.count_nonzero(~(residuals <= CONVERGED * (np.abs(values) + unit) + rounding)))
        logger.debug("slice %d:%d, basis %d: %d pairs open", first, end, basis.used, open_pairs)
        if not open_pairs:
            break
        if basis.used >= capacity:
            raise ConvergenceError(f"{open_pairs} of the eigenpairs {first} to {end} did not converge")
        target = min(basis.used + _blocks(0.2 * wanted), capacity)
    order = np.argsort(values, kind="stable")
    rows = vectors[:, order].T @ basis.rows[: basis.used]
    if rounding > CONVERGED * unit:
        # One more multiplication takes out the rounding errors in directions that the matrix amplifies.
        rows = np.ascontiguousarray(factor.solve(rows.T).T)
        rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    return _Slice(factor.below - below, values[order], rows)


class _Basis:
    """An orthonormal Krylov basis, stored by rows, and the operator projected onto it."""

    def __init__(self, solve: Callable[[Array], Array], size: int, capacity: int, stop: threading.Event) -> None:
        self.rows = np.zeros((capacity + BLOCK, size), dtype=np.float64)
        self.projected = np.zeros((capacity + BLOCK, capacity + BLOCK), dtype=np.float64)
        self.coupling = np.zeros((BLOCK, BLOCK), dtype=np.float64)
        self.used = 0
        self._solve = solve
        self._stop = stop
        self.rows[:BLOCK], _ = _normalised(np.random.default_rng(0).standard_normal((BLOCK, size)))

    def extend(self, size: int) -> None:
        """Multiply blocks by the operator until `size` rows are in use.

        A new block is first made orthogonal to the two blocks before it, which is all that exact arithmetic would
        need, then normalised, and then made orthogonal to all blocks and normalised again.

        Raises
        ------
        CancelledError
            Nobody waits for the basis any more.
        """
        while self.used + BLOCK <= size:
            if self._stop.is_set():
                raise CancelledError
            first, last = self.used, self.used + BLOCK
            recent = self.rows[max(first - BLOCK, 0) : last]
            image = self._solve(self.rows[first:last].T).T
            local = recent @ image.T
            self.projected[max(first - BLOCK, 0) : last, first:last] = local
            block, outer = _normalised(image - local.T @ recent)
            correction = self._subtract_all(block, last)
            self.projected[:last, first:last] += correction @ outer
            block, inner = _normalised(block)
            self.rows[last : last + BLOCK] = block
            self.coupling = inner @ outer
            self.used = last

    def _subtract_all(self, block: Array, used: int) -> Array:
        """Make a block orthogonal to the first `used` rows, in place; return the (used, BLOCK) coefficients.

        A few rows at a time: both products with them read the processor's cache, and memory is read once. Where not
        even a few fit into the cache, one product with all rows reads the block itself less often.
        """
        coefficients = np.empty((used, len(block)), dtype=np.float64)
        step = PANEL_BYTES // self.rows[0].nbytes
        step = step if step >= BLOCK else used
        for first in range(0, used, step):
            panel = self.rows[first : min(first + step, used)]
            part = panel @ block.T
            block -= part.T @ panel
            coefficients[first : first + step] = part
        return coefficients

    def ritz(self) -> tuple[Array, Array]:
        """Return Ritz values of the inverse, ascending, and their coefficients as columns."""
        projected = self.projected[: self.used, : self.used]
        values, vectors = scipy.linalg.eigh(projected, lower=False, check_finite=False)
        return values, vectors

    def residuals(self, matrix: sparse.csc_matrix, shift: float, inverse: Array, vectors: Array) -> Array:
        """Return ‖Sy − λy‖ of Ritz pairs (ν, y) of the inverse, λ = σ + 1/ν.

        From (S − σI)⁻¹y − νy = Vᵀc, with V the next block, follows Sy − λy = −(S − σI) Vᵀ c / ν.
        """
        following = self.rows[self.used : self.used + BLOCK].T
        image = matrix @ following - shift * following
        coefficients = self.coupling @ vectors[self.used - BLOCK : self.used]
        squares = np.einsum("bi,bc,ci->i", coefficients, image.T @ image, coefficients)
        return np.sqrt(np.maximum(squares, 0.0)) / np.abs(inverse)


def _normalised(block: Array) -> tuple[Array, Array]:
    """Return Q and R with ``block.T = Q.T @ R``, Q having orthonormal rows."""
    lower: Array = np.zeros((len(block), len(block)), dtype=np.float64)
    with contextlib.suppress(np.linalg.LinAlgError):
        lower[:] = np.linalg.cholesky(block @ block.T)
    if lower.diagonal().min() > 1e-6 * lower.diagonal().max():
        # Few rows: a product with the inverse is quicker than a triangular solve, which copies them twice.
        return np.linalg.inv(lower) @ block, lower.T
    q, r = scipy.linalg.qr(block.T, mode="economic", check_finite=False)
    return np.ascontiguousarray(q.T), r


def _blocks(columns: float) -> int:
    return -int(-columns // BLOCK) * BLOCK


def _joined(slices: list[_Slice], unit: float) -> tuple[Array, Array]:
    """Return values and rows of all slices, each cut where it agrees with the next one, at the widest gap."""
    values, rows, start = [], [], 0
    for left, right in itertools.pairwise(slices):
        common = slice(right.first - left.first, None), slice(None, left.end - right.first)
        ours, theirs = left.values[common[0]], right.values[common[1]]
        if len(ours) != len(theirs) or np.any(np.abs(ours - theirs) > AGREEMENT * (np.abs(ours) + unit)):
            raise ConvergenceError(f"two slices of the spectrum disagree at pairs {right.first} to {left.end}")
        cut = right.first + 1 + int(np.diff(ours).argmax())
        values.append(left.values[start - left.first : cut - left.first])
        rows.append(left.rows[start - left.first : cut - left.first])
        start = cut
    values.append(slices[-1].values[start - slices[-1].first :])
    rows.append(slices[-1].rows[start - slices[-1].first :])
    if values[0][0] < -AGREEMENT * unit:
        raise ConvergenceError(f"the lowest eigenvalue is {values[0][0]:.1e}; it should not be negative")
    return np.concatenate(values), np.concatenate(rows)


def _check_count(matrix: sparse.csc_matrix, values: Array) -> None:
    """Compare the number of eigenvalues below the widest gap near the end with the number found."""
    first = max(len(values) - 2 * OVERLAP, 1)
    index = first + int(np.diff(values[first - 1 :]).argmax())
    found = count_below(matrix, float(0.5 * (values[index - 1] + values[index])))
    if found != index:
        raise ConvergenceError(f"{found} eigenvalues lie where {index} were found")


def _orthonormal(rows: Array) -> Array:
    """Return rows made orthonormal to rounding; slices are orthogonal to each other up to their residuals only."""
    gram = rows @ rows.T
    if np.abs(gram - np.eye(len(rows))).max() > 1e-4:
        raise ConvergenceError("eigenvectors of neighbouring slices coincide")
    return scipy.linalg.solve_triangular(np.linalg.cholesky(gram), rows, lower=True, check_finite=False)
