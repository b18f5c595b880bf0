"""Timing of every kernel beside numpy doing the same work and what the device reaches, and of the eigensolver.

Work and its comparison are timed in turn, best of several, so that a busy machine harms both alike. Rates come from the
operations or bytes that the result needs, not from what a kernel happens to do. Fused kernels are compared with a numpy
product of as many operations, which is less than numpy would need for the same result. Short runs are queued several at
a time, as a match queues them: an evaluation of the objective waits for the device once.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.linalg import eigsh

from clalign.alignment.band import funnel_band
from clalign.benchmark.losses import ProblemSize, synthetic_problem
from clalign.benchmark.performance import elapsed, seconds_text
from clalign.benchmark.table import markdown_table
from clalign.engine.band import Band
from clalign.engine.kernels import Kernels
from clalign.engine.reference import Reference, pair_count
from clalign.geometry.operators import conformal_factor, gaussian_curvature, lumped_mass, stiffness
from clalign.geometry.spectra import eigenvalue_unit, solve
from clalign.geometry.workers import processor_count, single_threaded_blas
from clalign.mesh.mesh import Mesh
from clalign.options import AlignmentOptions, SpectrumOptions

Values = NDArray[np.float32]
Run = Callable[[], object]

PAUSE = 0.05
"""Seconds for which threads may still spin after a run."""
BURST = 0.1
"""Seconds of runs in a row."""
QUEUED = 0.002
"""Seconds of short runs that are queued before the host waits for them."""
MOST_QUEUED = 16
NUMPY_ROWS = 2000
"""Rows of numpy's part of a comparison; its time is scaled up to all rows."""


@dataclass(frozen=True)
class Size:
    """Problem size: n vertices on both shapes, k basis functions, d scale-invariant ones, r columns of the factors."""

    n: int
    k: int
    d: int
    r: int

    def __str__(self) -> str:
        return f"n={self.n} k={self.k} d={self.d} r={self.r}"


SIZES = (Size(1000, 120, 352, 50), Size(6890, 120, 352, 50), Size(6890, 200, 352, 100), Size(50000, 120, 352, 50))


@dataclass(frozen=True)
class KernelRate:
    """One measurement.

    kernel, size : what ran, on what.
    seconds, rate : of the device; rate in `unit`, "GFLOP/s" or "GB/s".
    other, other_seconds, other_rate : the comparison, and the same figures for it.
    """

    kernel: str
    size: str
    unit: str
    seconds: float
    rate: float
    other: str
    other_seconds: float
    other_rate: float

    @property
    def ratio(self) -> float:
        """Rate of the device over that of the comparison."""
        return self.other_seconds / self.seconds


@dataclass(frozen=True)
class Case:
    """What to time: `work` operations or bytes, `share` of which the comparison does."""

    kernel: str
    size: str
    work: float
    run: Run
    other: str
    other_run: Run
    share: float = 1.0
    unit: str = "GFLOP/s"


def measure_kernels(
    kernels: Kernels, sizes: Sequence[Size] = SIZES, repeats: int = 5, seed: int = 0
) -> Iterator[KernelRate]:
    """Time the ceilings of the device, then every kernel at every size; of each the best of `repeats` counts."""
    rng = np.random.default_rng(seed)
    yield from (measure(kernels, case, repeats) for case in ceilings(kernels, rng))
    for size in sizes:
        for family in (product_cases, soft_map_cases, loss_cases, search_cases):
            yield from (measure(kernels, case, repeats) for case in family(kernels, size, rng))
        yield measure(kernels, objective_case(kernels, size, rng), repeats)


def measure(kernels: Kernels, case: Case, repeats: int) -> KernelRate:
    """Time one case and its comparison in turn."""
    count = 1

    def on_device() -> None:
        for _ in range(count):
            case.run()
        kernels.device.finish()

    # The first run builds the programs.
    on_device()
    count = min(MOST_QUEUED, max(1, int(QUEUED / elapsed(on_device))))
    seconds = other_seconds = float("inf")
    for _ in range(repeats):
        seconds = min(seconds, _settled(on_device) / count)
        other_seconds = min(other_seconds, _settled(case.other_run) / case.share)
    rate, other_rate = case.work / seconds / 1e9, case.work / other_seconds / 1e9
    return KernelRate(case.kernel, case.size, case.unit, seconds, rate, case.other, other_seconds, other_rate)


def _settled(run: Run) -> float:
    """Return the least seconds of a burst of runs, begun when the threads of whoever ran before have gone to sleep.

    BLAS threads wait for more work by spinning, some milliseconds long, and take the processors from what comes next.
    And threads that have slept are woken on one processor, and spread over all only some milliseconds later.
    """
    time.sleep(PAUSE)
    best, left = float("inf"), BURST
    while left > 0:
        seconds = elapsed(run)
        best, left = min(best, seconds), left - seconds
    return best


def _random(rng: np.random.Generator, *shape: int) -> Values:
    return rng.standard_normal(shape, dtype=np.float32)


def _numpy_product(rng: np.random.Generator, m: int, n: int, depth: int) -> tuple[str, Run, float]:
    """A numpy product of m x n x depth multiply-adds: its name, the function, the share of its rows that it does."""
    rows = min(m, NUMPY_ROWS)
    a, b, out = _random(rng, rows, depth), _random(rng, depth, n), np.zeros((rows, n), np.float32)
    return f"numpy product {m}x{n}x{depth}", lambda: np.matmul(a, b, out=out), rows / m


def ceilings(kernels: Kernels, rng: np.random.Generator) -> Iterator[Case]:
    """A copy of 128 MiB and a product of 2048 x 2048 x 2048: what the device reaches at best."""
    source = kernels.zeros(1 << 25)
    target, host, other = kernels.zeros(1 << 25), np.zeros(1 << 25, np.float32), np.zeros(1 << 25, np.float32)
    moved = 2.0 * source.size * source.dtype.itemsize
    copy: Run = lambda: kernels.device.copy(source, target)  # noqa: E731
    yield Case("copy", "128 MiB", moved, copy, "numpy copy", lambda: np.copyto(other, host), unit="GB/s")
    yield _product_case(kernels, rng, "product", 2048, 2048, 2048)


def _product_case(kernels: Kernels, rng: np.random.Generator, name: str, m: int, n: int, depth: int) -> Case:
    a, b, out = kernels.array(_random(rng, m, depth)), kernels.array(_random(rng, depth, n)), kernels.zeros((m, n))
    comparison = _numpy_product(rng, m, n, depth)
    return Case(name, f"{m}x{n}x{depth}", 2.0 * m * n * depth, lambda: kernels.product(a, b, out=out), *comparison)


def product_cases(kernels: Kernels, size: Size, rng: np.random.Generator) -> Iterator[Case]:
    """Dense, banded and Gram products, and the solution with a Gram matrix."""
    n, k, d = size.n, size.k, size.d
    yield _product_case(kernels, rng, "product", k, d, d)
    yield _product_case(kernels, rng, "product", n, k, k)
    band = funnel_band(d, AlignmentOptions())
    a, r, out = kernels.array(_random(rng, k, d)), kernels.zeros((d, d)), kernels.zeros((k, d))
    banded: Run = lambda: kernels.banded_product(a, r, right=band, out=out)  # noqa: E731
    yield Case("banded_product", f"{k}x{d}", 2.0 * k * band.count, banded, *_numpy_product(rng, k, d, d))
    x, y, w, gram = (kernels.array(_random(rng, *s)) for s in ((n, d), (n, k), (n,), (d, k)))
    weighted: Run = lambda: kernels.weighted_gram(x, y, w, out=gram)  # noqa: E731
    yield Case("weighted_gram", f"{d}x{k}x{n}", 2.0 * n * d * k, weighted, *_numpy_product(rng, d, k, n))
    spd = _random(rng, k, 3 * k)
    left, rhs, solved = kernels.array(spd @ spd.T), kernels.array(_random(rng, k, k)), kernels.zeros((k, k))
    solve: Run = lambda: kernels.solve_right(left, rhs, 1e-6, out=solved)  # noqa: E731
    twin, host = Reference(np.float32), (spd @ spd.T, _random(rng, k, k))
    yield Case(
        "solve_right", f"{k}x{k}", k**3 / 3 + 2.0 * k**3, solve, "scipy Cholesky", lambda: twin.solve_right(*host, 1e-6)
    )


def soft_map_cases(kernels: Kernels, size: Size, rng: np.random.Generator) -> Iterator[Case]:
    """Quadratic form, its gradients, and, where n is not hopeless, the streamed form and the hard map."""
    n, k, r = size.n, size.k, size.r
    pairs = pair_count(k)
    work = 2.0 * n * pairs * r
    label = f"n={n} k={k} r={r}"
    c, psi, u, w, dz = (kernels.array(_random(rng, *s)) for s in ((n, k), (n, k), (n, r), (n,), (n, r)))
    packed, dpacked = kernels.zeros((pairs, r)), kernels.array(_random(rng, pairs, r))
    pair, dc, du = (kernels.zeros((n, r)), kernels.zeros(n)), kernels.zeros((n, k)), kernels.zeros((n, r))
    equal = _numpy_product(rng, n, r, pairs)
    runs: dict[str, Run] = {
        "packed_moments": lambda: kernels.packed_moments(psi, w, u, out=packed),
        "packed_moments_gradient": lambda: kernels.packed_moments_gradient(psi, w, dpacked, out=du),
        "soft_map": lambda: kernels.soft_map(c, packed, out=pair),
        "soft_map_gradient": lambda: kernels.soft_map_gradient(c, packed, None, *pair, dz, out=dc),
    }
    for name, run in runs.items():
        yield Case(name, label, work, run, *equal)
    if n > 10000:
        return
    streamed: Run = lambda: kernels.soft_map_streamed(c, psi, w, u, out=pair)  # noqa: E731
    backward: Run = lambda: kernels.soft_map_streamed_gradient(c, psi, w, u, *pair, dz, out=dc)  # noqa: E731
    yield Case("soft_map_streamed", label, 2.0 * n * n * (k + r), streamed, *_numpy_product(rng, n, n, k + r))
    hard, weights = (kernels.zeros(n, np.int32), kernels.zeros(n)), kernels.array(np.abs(_random(rng, n)))
    argmax: Run = lambda: kernels.soft_map_argmax(c, psi, weights, out=hard)  # noqa: E731
    yield Case("soft_map_argmax", f"n={n} k={k}", 2.0 * n * n * k, argmax, *_numpy_product(rng, n, n, k))
    depth = 2 * k + r
    yield Case("soft_map_streamed_gradient", label, 2.0 * n * n * depth, backward, *_numpy_product(rng, n, n, depth))


def loss_cases(kernels: Kernels, size: Size, rng: np.random.Generator) -> Iterator[Case]:
    """Both terms of the objective."""
    n, d, r = size.n, size.d, size.r
    z, core, left, w = (kernels.array(_random(rng, *s)) for s in ((n, r), (r, r), (n, r), (n,)))
    value, slope = kernels.zeros(()), kernels.zeros((n, r))
    distortion: Run = lambda: kernels.distortion(z, core, left, core, w, out=(value, slope))  # noqa: E731
    yield Case("distortion", f"n={n} r={r}", 10.0 * n * r * r, distortion, *_numpy_product(rng, n, r, 5 * r))
    square, band = kernels.array(_random(rng, d, d)), funnel_band(d, AlignmentOptions())
    out = (kernels.zeros(()), kernels.zeros(()), kernels.zeros((d, d)), kernels.zeros((d, d)))
    rotation = kernels.band_expand(kernels.array(_random(rng, band.count)), band)
    transposed = kernels.transpose(rotation)
    alignment: Run = lambda: kernels.alignment(rotation, transposed, square, square, square, band, out=out)  # noqa: E731
    yield Case("alignment", f"d={d}", _alignment_work(band), alignment, *_numpy_product(rng, d, d, 4 * d))


def search_cases(kernels: Kernels, size: Size, rng: np.random.Generator) -> Iterator[Case]:
    """Nearest points among eigenfunctions, and scores of 256 maps between 200 samples."""
    n, d = size.n, size.d
    points = min(n, 6890)
    queries, among = kernels.array(_random(rng, n, d)), kernels.array(_random(rng, points, d))
    found = (kernels.zeros(n, np.int32), kernels.zeros(n))
    nearest: Run = lambda: kernels.nearest(queries, among, out=found)  # noqa: E731
    yield Case("nearest", f"{n}x{points}x{d}", 2.0 * n * points * d, nearest, *_numpy_product(rng, n, points, d))
    m, maps = 200, 256
    host = (np.abs(_random(rng, n, n)) if n <= 1000 else np.abs(_random(rng, 1000, 1000)), np.abs(_random(rng, m, m)))
    weights, index = np.full(m, 1 / m, np.float32), rng.integers(0, len(host[0]), size=(m, maps), dtype=np.int32)
    dx, dy, w, candidates = (kernels.array(values) for values in (*host, weights, index))
    scores, between, twin = kernels.zeros(maps), kernels.zeros((maps, maps)), Reference(np.float32)
    batch: Run = lambda: kernels.distortion_batch(dx, dy, w, candidates, out=scores)  # noqa: E731
    distance: Run = lambda: kernels.map_distance(dx, w, candidates, out=between)  # noqa: E731
    some = index[:, :16]
    label, share = f"{maps} maps of {m}", 16 / maps
    batch_twin: Run = lambda: twin.distortion_batch(*host, weights, some)  # noqa: E731
    distance_twin: Run = lambda: twin.map_distance(host[0], weights, some)  # noqa: E731
    yield Case("distortion_batch", label, 4.0 * m * m * maps, batch, "numpy", batch_twin, share)
    yield Case("map_distance", label, 2.0 * m * maps * maps, distance, "numpy", distance_twin, share**2)


def objective_case(kernels: Kernels, size: Size, rng: np.random.Generator) -> Case:
    """One value and gradient of the objective on all vertices, from packed R to the packed gradient."""
    problem, frozen, x = synthetic_problem(kernels, size.n, ProblemSize(size.k, size.d, size.r))
    pairs = pair_count(size.k)
    comparison = _numpy_product(rng, size.n, 2 * size.r, pairs)
    run: Run = lambda: problem.value_and_gradient(x, frozen)  # noqa: E731
    return Case("value_and_gradient", str(size), 4.0 * size.n * pairs * size.r, run, *comparison)


def _alignment_work(band: Band) -> float:
    """Operations of the four products behind l_align, each summed where R is not zero and kept inside the band."""
    rows, columns = np.diff(band.offsets).astype(float), np.diff(band.transposed.offsets).astype(float)
    # The entry (i, j) of G_x R sums over column j of R, of R G_y over row i, of G_xy R^T over row j, of R^T G_xy over
    # column i.
    return float(2.0 * np.sum((rows + columns) ** 2))


def kernel_table(rates: Sequence[KernelRate]) -> str:
    """Return a Markdown table: each kernel over numpy and over the first rate of its unit, the device's ceiling."""
    ceilings: dict[str, float] = {}
    for rate in rates:
        ceilings.setdefault(rate.unit, rate.rate)
    rows = [
        [
            rate.kernel,
            rate.size,
            seconds_text(rate.seconds),
            f"{rate.rate:.1f} {rate.unit}",
            rate.other,
            f"{rate.other_rate:.1f}",
            f"{rate.ratio:.2f}",
            f"{rate.rate / ceilings[rate.unit]:.2f}",
        ]
        for rate in rates
    ]
    header = ["kernel", "size", "time", "rate", "comparison", "its rate", "over comparison", "over ceiling"]
    return markdown_table(header, rows, text_columns=2)


@dataclass(frozen=True)
class SpectraTimes:
    """Seconds for both spectra of a shape, by the solver here and by two calls of scipy's ``eigsh``."""

    vertices: int
    basis: int
    scale_invariant: int
    seconds: float
    scipy_seconds: float

    @property
    def ratio(self) -> float:
        """How many times scipy's duration ours fits into."""
        return self.scipy_seconds / self.seconds


def measure_spectra(mesh: Mesh, basis: int = 120, scale_invariant: int = 352, repeats: int = 2) -> SpectraTimes:
    """Time Laplace–Beltrami and scale-invariant eigenfunctions of a mesh, ours and scipy's in turn, the best of each.

    Ours includes the check of every residual. scipy's is shift-invert ARPACK as its manual has it for the lowest
    eigenpairs, with the mass matrix and a shift just below zero; its matrix products run in one thread, as ours do,
    since on a busy machine more threads slow it down severalfold.
    """
    options = SpectrumOptions(basis=basis, scale_invariant=scale_invariant)
    mass, matrix = lumped_mass(mesh.vertices, mesh.faces), stiffness(mesh.vertices, mesh.faces)
    functions = solve(matrix, mass, basis, threads=processor_count())
    curvature = gaussian_curvature(mesh.vertices, mesh.faces, mass)
    invariant = mass * conformal_factor(curvature, mass, options, functions)
    wanted = ((mass, functions.count), (invariant, min(scale_invariant, len(mass) // 3)))

    def ours() -> None:
        for weights, count in wanted:
            solve(matrix, weights, count, threads=processor_count())

    def scipys() -> None:
        with single_threaded_blas():
            for weights, count in wanted:
                eigsh(matrix.tocsc(), count, sparse.diags_array(weights).tocsc(), sigma=-eigenvalue_unit(weights))

    seconds = scipy_seconds = float("inf")
    for _ in range(repeats):
        seconds, scipy_seconds = min(seconds, elapsed(ours)), min(scipy_seconds, elapsed(scipys))
    return SpectraTimes(len(mass), functions.count, min(scale_invariant, len(mass) // 3), seconds, scipy_seconds)


def spectra_table(times: SpectraTimes) -> str:
    """Return the Markdown table of a measurement."""
    rows = [
        ["block Lanczos, residuals checked", seconds_text(times.seconds), f"{times.ratio:.2f}×"],
        ["scipy eigsh twice", seconds_text(times.scipy_seconds), "1×"],
    ]
    label = f"{times.basis} + {times.scale_invariant} eigenpairs, n = {times.vertices:,}"
    return markdown_table([label, "time", "faster than scipy"], rows)
