"""Rates of the kernels as a table, and the eigensolver beside scipy's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import scipy.sparse as sparse
from scipy.sparse.linalg import eigsh

from clalign.benchmark.microbench import KernelRate
from clalign.benchmark.performance import elapsed, markdown_table, seconds_text
from clalign.geometry.operators import conformal_factor, gaussian_curvature, lumped_mass, stiffness
from clalign.geometry.spectra import eigenvalue_unit, solve
from clalign.geometry.workers import processor_count, single_threaded_blas
from clalign.mesh.mesh import Mesh
from clalign.options import SpectrumOptions


def kernel_table(rates: Sequence[KernelRate]) -> str:
    """Return a Markdown table: each kernel over numpy and over what the device reaches at best in the same unit.

    Parameters
    ----------
    rates : as `measure_kernels` yields them, ceilings first: a copy for GB/s, a large product for GFLOP/s.
    """
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
    descriptors: int
    seconds: float
    scipy_seconds: float

    @property
    def ratio(self) -> float:
        """How many times scipy's duration ours fits into."""
        return self.scipy_seconds / self.seconds


def measure_spectra(mesh: Mesh, basis: int = 120, descriptors: int = 352, repeats: int = 2) -> SpectraTimes:
    """Time Laplace–Beltrami and scale-invariant eigenfunctions of a mesh, ours and scipy's in turn, the best of each.

    Ours includes the check of every residual. scipy's is shift-invert ARPACK as its manual has it for the lowest
    eigenpairs, with the mass matrix and a shift just below zero; its matrix products run in one thread, as ours do,
    since on a busy machine more threads slow it down severalfold.
    """
    options = SpectrumOptions(basis=basis, descriptors=descriptors)
    mass, matrix = lumped_mass(mesh.vertices, mesh.faces), stiffness(mesh.vertices, mesh.faces)
    functions = solve(matrix, mass, basis, threads=processor_count())
    curvature = gaussian_curvature(mesh.vertices, mesh.faces, mass)
    invariant = mass * conformal_factor(curvature, mass, options, functions)
    wanted = ((mass, functions.count), (invariant, min(descriptors, len(mass) // 3)))

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
    return SpectraTimes(len(mass), functions.count, min(descriptors, len(mass) // 3), seconds, scipy_seconds)


def spectra_table(times: SpectraTimes) -> str:
    """Return the Markdown table of a measurement."""
    rows = [
        ["block Lanczos, residuals checked", seconds_text(times.seconds), f"{times.ratio:.2f}×"],
        ["scipy eigsh twice", seconds_text(times.scipy_seconds), "1×"],
    ]
    label = f"{times.basis} + {times.descriptors} eigenpairs, n = {times.vertices:,}"
    return markdown_table([label, "time", "faster than scipy"], rows)
