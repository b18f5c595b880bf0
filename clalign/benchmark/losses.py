"""Time of one value and gradient of the objective, beside the dense evaluation with n × n matrices in numpy.

The time of an evaluation depends on the sizes of its arrays alone, so the arrays are random ones of the right shapes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clalign.alignment.band import funnel_band
from clalign.alignment.losses import FixedCorrespondence
from clalign.alignment.objective import Objective
from clalign.alignment.problem_data import SampledFactors, ShapeData
from clalign.benchmark.performance import elapsed, exponent_text, fitted_exponent, seconds_text
from clalign.benchmark.table import markdown_table
from clalign.engine.backend import Backend
from clalign.errors import ClalignError
from clalign.geometry.sampling import VertexOrder
from clalign.options import AlignmentOptions
from clalign.rules import AlignmentRules

Single = NDArray[np.float32]

SIZES = (6890, 13780, 27560, 55120, 110240)
DENSE_SIZE = 6890
QUICK_SIZES = (500, 1000, 2000)
QUICK_DENSE_SIZE = 1000


@dataclass(frozen=True)
class ProblemSize:
    """k basis functions, d scale-invariant ones, and rank r of the distance factors (half the number of samples)."""

    basis: int = 120
    scale_invariant: int = 352
    rank: int = 50


@dataclass(frozen=True)
class LossTimes:
    """Seconds of one value and gradient.

    size : lengths that do not vary.
    vertices, seconds : with the losses on so many vertices.
    sampled_seconds : with the losses on the samples that `match` uses by default, and their number.
    dense_vertices, dense_seconds, dense_operations : of the dense evaluation, without the alignment term.
    """

    size: ProblemSize
    vertices: tuple[int, ...]
    seconds: tuple[float, ...]
    samples: int
    sampled_seconds: float
    dense_vertices: int
    dense_seconds: float
    dense_operations: float

    @property
    def exponent(self) -> float | None:
        """Exponent p of the fit seconds ∝ n^p."""
        return fitted_exponent(self.vertices, self.seconds)

    @property
    def ratio(self) -> float:
        """Time of the dense evaluation over that of ours on as many vertices."""
        return self.dense_seconds / self.seconds[self.vertices.index(self.dense_vertices)]


def measure_losses(
    backend: Backend,
    sizes: Sequence[int] = SIZES,
    dense_size: int = DENSE_SIZE,
    size: ProblemSize | None = None,
    repeats: int = 5,
) -> LossTimes:
    """Time value and gradient at all sizes, the best of `repeats`, and the dense evaluation at `dense_size`.

    `dense_size` is one of the sizes; the dense evaluation runs once where it takes long.
    """
    lengths = ProblemSize() if size is None else size
    samples = min(AlignmentOptions().samples, dense_size)
    sampled = _best_seconds(backend, lengths, dense_size, samples, repeats)
    seconds, dense = [], 0.0
    for count in sizes:
        seconds.append(_best_seconds(backend, lengths, count, 0, repeats))
        if count == dense_size:
            dense = _dense_seconds(count, lengths.basis, 1 if count > 3000 else repeats)
    operations = dense_operations(dense_size, lengths)
    return LossTimes(lengths, tuple(sizes), tuple(seconds), samples, sampled, dense_size, dense, operations)


def dense_operations(count: int, size: ProblemSize) -> float:
    """Return the floating-point operations of `dense_evaluation`'s products: three n³, and two n² k."""
    return 6.0 * count**3 + 4.0 * count**2 * size.basis


def loss_table(times: LossTimes) -> str:
    """Return the Markdown table of a measurement."""
    size = times.size
    label = f"k = {size.basis}, d = {size.scale_invariant}, N = {2 * size.rank}"
    rows = []
    for count, seconds in zip(times.vertices, times.seconds, strict=True):
        ratio = f"{times.ratio:.0f}×" if count == times.dense_vertices else ""
        rows.append([f"value and gradient, n = {count:,}, {label}", seconds_text(seconds), ratio])
    at = f"losses on {times.samples:,} samples (default of a match), n = {times.dense_vertices:,}"
    rows.append([at, seconds_text(times.sampled_seconds), f"{times.dense_seconds / times.sampled_seconds:.0f}×"])
    rate = times.dense_operations / times.dense_seconds / 1e9
    dense = f"dense P and D in numpy (float32, {rate:.0f} GFLOP/s), n = {times.dense_vertices:,}"
    rows.append([dense, seconds_text(times.dense_seconds), "1×"])
    rows.append(["fitted exponent", exponent_text(times.exponent), ""])
    return markdown_table(["evaluation", "time", "faster than dense"], rows)


def synthetic_problem(
    backend: Backend, count: int, size: ProblemSize, samples: int = 0, seed: int = 0
) -> tuple[Objective, FixedCorrespondence, NDArray[np.float64]]:
    """Return a problem with random arrays, a round of it, and packed entries of R to evaluate it at.

    Parameters
    ----------
    count : vertices of each shape.
    samples : vertices of the losses; 0 for all.
    """
    rng = np.random.default_rng(seed)
    chosen = count if samples == 0 else samples
    weights = np.full(count, 1.0 / count)
    left = rng.standard_normal((count, size.rank))
    core = rng.standard_normal((size.rank, size.rank))
    # One side serves as both shapes: that halves the memory and changes no operation.
    side = ShapeData(
        basis=rng.standard_normal((count, size.basis)),
        scale_invariant=rng.standard_normal((count, size.scale_invariant)),
        projection=rng.standard_normal((size.basis, size.scale_invariant)),
        loss_weights=weights,
        soft_weights=weights,
        normal=None,
        left=left,
        core=core + core.T,
        order=VertexOrder.identity(count),
    )
    factors = SampledFactors(np.arange(chosen), np.full(chosen, 1.0 / chosen), left[:chosen], core + core.T)
    options = AlignmentOptions()
    problem = Objective(
        side, side, factors, funnel_band(size.scale_invariant, options), backend, options, AlignmentRules()
    )
    rotation = np.eye(size.scale_invariant)
    fixed = problem.fix(rotation, rng.permutation(count), options.weight)
    return problem, fixed, problem.pack(rotation) + 0.01 * rng.standard_normal(problem.band.count)


def _best_seconds(backend: Backend, size: ProblemSize, count: int, samples: int, repeats: int) -> float:
    problem, fixed, x = synthetic_problem(backend, count, size, samples)
    if not np.isfinite(problem.value_and_gradient(x, fixed).total):
        raise ClalignError(f"the objective has no finite value at {count} random vertices on {backend.name}")
    return min(elapsed(lambda: problem.value_and_gradient(x, fixed)) for _ in range(repeats))


def dense_evaluation(
    functional: Single, basis_x: Single, basis_y: Single, mass_y: Single, distances_x: Single, distances_y: Single
) -> tuple[float, Single]:
    """Return l_unsup (Eq. 17, 22) with uniform weights and its gradient by C, with P and both D stored.

    With K = Ψ C Φᵀ and c_j = C φ_j, P_ij = a_i K_ij² / |c_j|² is the soft map (Eq. 27), and
    l = |PᵀD_Y P − D_X|² / n². Three products of n × n matrices are the bulk of the work: D_Y P, Pᵀ(D_Y P), and
    (D_Y P) E for the gradient.

    Parameters
    ----------
    functional : (k, k) C.
    basis_x, basis_y : (n_x, k) and (n_y, k), the latter orthonormal in the mass.
    mass_y : (n_y,).
    distances_x, distances_y : (n_x, n_x) and (n_y, n_y), symmetric.
    """
    carried = basis_x @ functional.T
    amplitudes = basis_y @ carried.T
    lengths = np.square(carried).sum(axis=1)
    soft = np.square(amplitudes)
    soft *= mass_y[:, None]
    soft /= lengths
    spread = distances_y @ soft
    excess = soft.T @ spread
    excess -= distances_x
    scale = 1.0 / len(basis_x) ** 2
    value = float(scale * np.vdot(excess, excess))
    slope = spread @ excess
    slope *= 4 * scale
    slope_lengths = -np.einsum("ij,ij->j", soft, slope) / lengths
    slope *= amplitudes
    slope *= 2 * mass_y[:, None]
    slope /= lengths
    slope_carried = slope.T @ basis_y + 2 * slope_lengths[:, None] * carried
    return value, slope_carried.T @ basis_x


def _dense_seconds(count: int, size: int, repeats: int) -> float:
    rng = np.random.default_rng(0)

    def values(*shape: int) -> Single:
        return rng.standard_normal(shape, dtype=np.float32)

    bases = values(size, size), values(count, size), values(count, size)
    mass = np.full(count, 1.0 / count, np.float32)
    # Not symmetric, which the time of a product does not depend on.
    distances = values(count, count), values(count, count)
    return min(elapsed(lambda: dense_evaluation(*bases, mass, *distances)) for _ in range(repeats))
