"""One mesh with everything that is computed from it once."""

from __future__ import annotations

import dataclasses
import logging
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from clalign.geometry.cache import ShapeCache, content_key
from clalign.geometry.geodesics import DistanceFactors, Sampler, farthest_point_geodesics, low_rank
from clalign.geometry.heat import Geodesics
from clalign.geometry.heat_process import HeatProcess
from clalign.geometry.operators import (
    conformal_factor,
    defect_correlation,
    diffused,
    gaussian_curvature,
    intrinsic_operators,
    lumped_mass,
    mean_curvature,
    orientation_tensor,
    stiffness,
)
from clalign.geometry.sampling import Samples, VertexOrder, spread_samples
from clalign.geometry.spectra import Spectrum, solve
from clalign.geometry.workers import processor_count, single_threaded_blas, thread_pool
from clalign.memoize import memoize
from clalign.mesh.descriptors import PointDescriptors
from clalign.mesh.mesh import Mesh
from clalign.options import GeodesicOptions, Options, SpectrumOptions
from clalign.rules import ShapeRules

logger = logging.getLogger(__name__)

Part = TypeVar("Part", Spectrum, Geodesics)


@dataclass(frozen=True)
class Shape:
    """A mesh of unit area with its operators, spectra, distances and scale-invariant eigenfunctions.

    Attributes
    ----------
    mesh : the surface.
    stiffness : (n, n) cotangent matrix.
    mass : (n,) vertex areas, summing to 1.
    curvature : (n,) Gaussian curvature.
    smoothing : diffusion time of the curvature in the scale-invariant metric, in units of area.
    basis : Laplace–Beltrami eigenfunctions.
    scale_invariant : scale-invariant eigenfunctions; their own mass is the conformal factor times `mass`.
    geodesics : distances from farthest-point samples.
    factors : low-rank factors of all distances.
    orientation : (p, p, p) triple products of the first p functions of the basis.
    signatures : (n, s) logarithm of the heat kernel signature at the s times of the rules.
    curvatures : (n, 2) smoothed mean and Gaussian curvature.
    given : descriptors of the user, beside those of the shape it is matched with; None without.
    """

    mesh: Mesh
    stiffness: sparse.csr_matrix
    mass: NDArray[np.float64]
    curvature: NDArray[np.float64]
    smoothing: float
    basis: Spectrum
    scale_invariant: Spectrum
    geodesics: Geodesics
    factors: DistanceFactors
    orientation: NDArray[np.float64]
    signatures: NDArray[np.float64]
    curvatures: NDArray[np.float64]
    given: PointDescriptors | None = None

    @cached_property
    def order(self) -> VertexOrder:
        """The vertices in an order in which neighbours follow each other."""
        return VertexOrder.spatial(self.mesh.vertices)

    @memoize
    def samples(self, count: int) -> Samples:
        """Return `count` samples spread over the surface; see `spread_samples`."""
        return spread_samples(self.mesh.vertices, self.mass, self.geodesics, count)

    def patches(self, vertices: NDArray[np.int64], count: int) -> NDArray[np.int64]:
        """Return the patch of each of some vertices (m,): which of the first `count` samples is closest to it."""
        return np.argmin(self.geodesics.rows[:count, vertices], axis=0).astype(np.int64)


@dataclass(frozen=True)
class _Operators:
    """The quick part: what the spectra are computed from."""

    stiffness: sparse.csr_matrix
    mass: NDArray[np.float64]
    curvature: NDArray[np.float64]


def prepare(mesh: Mesh, options: Options, cache: ShapeCache | None = None) -> Shape:
    """Compute everything that matching needs to know about one mesh.

    Parameters
    ----------
    mesh : a connected surface of unit area.
    options : the groups `spectrum`, `geodesics` and `rules.shape` are read.
    cache : where spectra and distances are looked up first and stored after; None computes them.

    Raises
    ------
    ConvergenceError
        An eigenpair is not accurate.
    MeshError
        Geodesic distances cannot be computed.
    """
    return prepare_all([mesh], options, cache)[0]


def prepare_pair(source: Mesh, target: Mesh, options: Options, cache: ShapeCache | None = None) -> tuple[Shape, Shape]:
    """Prepare two meshes side by side, to be matched with each other; see `prepare`."""
    first, second = prepare_all([source, target], options, cache)
    return equally_smoothed(first, second, options.spectrum, cache)


def prepare_all(meshes: Sequence[Mesh], options: Options, cache: ShapeCache | None = None) -> list[Shape]:
    """Prepare several meshes, distances in other processes beside spectra in the threads of this one.

    Distances take longer than spectra and cannot be split, so as many meshes at a time as there are processors.
    Results do not depend on what else is prepared at the same time.
    """
    with ExitStack() as stack:
        stack.enter_context(single_threaded_blas())
        pool = stack.enter_context(thread_pool(max(min(len(meshes), processor_count()), 1)))
        processes = [HeatProcess() for _ in meshes]
        for process in processes:
            stack.callback(process.stop)
        distances = [
            pool.submit(_distances, mesh, options.geodesics, process, cache)
            for mesh, process in zip(meshes, processes, strict=True)
        ]
        spectral = [_spectra(mesh, options.spectrum, cache) for mesh in meshes]
        return [
            _shape(mesh, *spectra, geodesics.result(), options.rules.shape)
            for mesh, spectra, geodesics in zip(meshes, spectral, distances, strict=True)
        ]


def with_scale_invariant(
    shape: Shape, options: SpectrumOptions, cache: ShapeCache | None = None, *, smoothing: float | None = None
) -> Shape:
    """Return a shape whose scale-invariant eigenfunctions are those of other options, all else kept.

    smoothing : diffusion time of the curvature instead of what the options and the mesh ask for.
    """
    operators = _Operators(shape.stiffness, shape.mass, shape.curvature)
    time = _smoothing(shape.mesh, operators, options) if smoothing is None else smoothing
    with single_threaded_blas():
        scale_invariant = _scale_invariant(shape.mesh, operators, shape.basis, options, time, cache)
    return dataclasses.replace(shape, scale_invariant=scale_invariant, smoothing=time)


def equally_smoothed(
    source: Shape, target: Shape, options: SpectrumOptions, cache: ShapeCache | None = None
) -> tuple[Shape, Shape]:
    """Return both shapes with the smoothing of the noisier one: eigenfunctions of different metrics do not match."""
    time = max(source.smoothing, target.smoothing)
    first, second = (
        shape if shape.smoothing == time else with_scale_invariant(shape, options, cache, smoothing=time)
        for shape in (source, target)
    )
    return first, second


def _spectra(
    mesh: Mesh, options: SpectrumOptions, cache: ShapeCache | None
) -> tuple[_Operators, float, Spectrum, Spectrum]:
    if options.laplacian == "intrinsic":
        weights, mass = intrinsic_operators(mesh.vertices, mesh.faces)
    else:
        weights, mass = stiffness(mesh.vertices, mesh.faces), lumped_mass(mesh.vertices, mesh.faces)
    operators = _Operators(weights, mass, gaussian_curvature(mesh.vertices, mesh.faces, mass))
    count = max(options.basis, options.refinement)
    basis = stored_basis(mesh, operators.stiffness, mass, count, cache, **_laplacian(options))
    smoothing = _smoothing(mesh, operators, options)
    return operators, smoothing, basis, _scale_invariant(mesh, operators, basis, options, smoothing, cache)


def stored_basis(
    mesh: Mesh,
    weights: sparse.csr_matrix,
    mass: NDArray[np.float64],
    count: int,
    cache: ShapeCache | None,
    **names: str,
) -> Spectrum:
    """Return the Laplace–Beltrami eigenfunctions of a mesh, from the cache if they are there.

    names : what else the operator depends on.
    """

    def compute() -> Spectrum:
        return solve(weights, mass, count, processor_count())

    return _stored(cache, "basis", mesh, {"count": count, **names}, Spectrum, compute)


def stored_geodesics(
    mesh: Mesh, search_samples: int, factor_samples: int, sampler: Sampler, cache: ShapeCache | None
) -> Geodesics:
    """Return what `farthest_point_geodesics` does, from the cache if it is there."""
    values = {"search": search_samples, "factor": factor_samples}

    def compute() -> Geodesics:
        return farthest_point_geodesics(mesh, search_samples, factor_samples, sampler)

    return _stored(cache, "geodesics", mesh, values, Geodesics, compute)


def _laplacian(options: SpectrumOptions) -> dict[str, str]:
    """Return what names the operator in the cache: nothing for the one that was always there."""
    return {} if options.laplacian == "cotangent" else {"laplacian": options.laplacian}


def _smoothing(mesh: Mesh, operators: _Operators, options: SpectrumOptions) -> float:
    """Return the diffusion time of the curvature that a mesh asks for."""
    if options.metric in ("euclidean", "heat-kernel"):
        return 0.0
    noisy = defect_correlation(operators.curvature, operators.mass, mesh.faces) < options.noisy_below
    return options.smoothing if noisy else 0.0


def _scale_invariant(
    mesh: Mesh,
    operators: _Operators,
    basis: Spectrum,
    options: SpectrumOptions,
    smoothing: float,
    cache: ShapeCache | None,
) -> Spectrum:
    def compute() -> Spectrum:
        curvature = diffused(operators.curvature, operators.mass, operators.stiffness, smoothing)
        factor = conformal_factor(curvature, operators.mass, options, basis)
        mass = operators.mass * factor
        return solve(operators.stiffness, mass, options.scale_invariant, processor_count())

    names = ("scale_invariant", "metric", "xi", "clamp", "epsilon")
    values = {name: getattr(options, name) for name in names} | {"basis": basis.count, "smoothing": smoothing}
    values |= _laplacian(options)
    return _stored(cache, "scale_invariant", mesh, values, Spectrum, compute)


def _distances(mesh: Mesh, options: GeodesicOptions, heat: HeatProcess, cache: ShapeCache | None) -> Geodesics:
    return stored_geodesics(mesh, options.search_samples, options.factor_samples, heat.farthest_points, cache)


def _stored(
    cache: ShapeCache | None,
    part_name: str,
    mesh: Mesh,
    values: dict[str, Any],
    kind: type[Part],
    compute: Callable[[], Part],
) -> Part:
    """Return a part of a shape from the cache, under what it depends on, or compute and store it."""
    key = content_key(part_name, {"vertices": mesh.vertices, "faces": mesh.faces}, values)
    names = {item.name for item in dataclasses.fields(kind)}
    found = None if cache is None else cache.get(key)
    if found is not None and found.keys() == names:
        return kind(**found)
    started = time.perf_counter()
    part = compute()
    logger.info("%s computed in %.2f s", part_name, time.perf_counter() - started)
    if cache is not None:
        cache.put(key, {name: getattr(part, name) for name in names})
    return part


def _shape(
    mesh: Mesh,
    operators: _Operators,
    smoothing: float,
    basis: Spectrum,
    scale_invariant: Spectrum,
    geodesics: Geodesics,
    rules: ShapeRules,
) -> Shape:
    mean = mean_curvature(mesh.vertices, mesh.faces, operators.mass, operators.stiffness)
    return Shape(
        mesh=mesh,
        **vars(operators),
        smoothing=smoothing,
        basis=basis,
        scale_invariant=scale_invariant,
        geodesics=geodesics,
        factors=low_rank(geodesics, operators.mass),
        orientation=orientation_tensor(mesh.faces, basis.functions[:, : rules.oriented_functions]),
        signatures=heat_signatures(basis, signature_times(rules)),
        curvatures=smoothed_curvatures(basis, mean, operators.curvature, rules),
    )


def signature_times(rules: ShapeRules) -> NDArray[np.float64]:
    """Return the diffusion times of the signatures, in units of area, in equal ratios."""
    return np.geomspace(rules.first_time, rules.last_time, rules.signatures)


def heat_signatures(basis: Spectrum, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (n, len(times)) logarithms of h_t(x, x) = Σ exp(−λ_i t) φ_i(x)²."""
    decay = np.exp(-np.outer(basis.eigenvalues, times))
    return np.log(np.square(basis.functions) @ decay)


def smoothed_curvatures(
    basis: Spectrum, mean: NDArray[np.float64], gaussian: NDArray[np.float64], rules: ShapeRules
) -> NDArray[np.float64]:
    """Return (n, 2) mean and Gaussian curvature, cut at a quantile and diffused.

    Curvature estimates have a few wild values at slivers and spikes; cutting first keeps them from spreading.
    """
    both = np.stack([mean, gaussian], axis=1)
    limit = np.quantile(np.abs(both), rules.curvature_quantile, axis=0)
    return basis.diffused(basis.coefficients(np.clip(both, -limit, limit)), rules.curvature_time)
