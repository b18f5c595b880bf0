"""From a map between samples to maps between all vertices: spectral up-sampling and closed-form steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clalign.alignment.funnel import band_mask
from clalign.alignment.maps import (
    PointMaps,
    coherent_directions,
    functional_point_maps,
    nearest_rows,
    orthogonalised,
    point_maps,
    two_way_functional_map,
    wavelet_filtered,
)
from clalign.alignment.rotation import StartingRotation, starting_rotation
from clalign.engine.backend import Backend, Band
from clalign.geometry.shape import Shape
from clalign.geometry.spectra import Spectrum

UP_SAMPLING_STEP = 10
UP_SAMPLING_QUERIES = 1000


def up_sampled(
    backend: Backend, source: Shape, target: Shape, functional: NDArray[np.float64], size: int
) -> NDArray[np.float64]:
    """Return the functional map grown to `size` functions (ZoomOut on samples of Y against all vertices of X).

    Every point map is read from the orthogonalised functional map: an isometry's is orthogonal.
    """
    samples = target.geodesics.samples[:UP_SAMPLING_QUERIES]
    basis = target.basis.functions[samples]
    weights = target.geodesics.sample_weights(samples.size)
    largest = min(size, source.basis.count, target.basis.count, samples.size // 2)
    sizes = [*range(len(functional) + UP_SAMPLING_STEP, largest, UP_SAMPLING_STEP), largest]
    for wanted in sizes:
        current = len(functional)
        index = nearest_rows(
            backend, basis[:, :current] @ orthogonalised(functional), source.basis.functions[:, :current]
        )
        weighted = basis[:, :wanted] * weights[:, None]
        pulled = weighted.T @ source.basis.functions[index, :wanted]
        functional = np.asarray(np.linalg.solve(basis[:, :wanted].T @ weighted, pulled), dtype=np.float64)
    return functional


def vertex_maps(backend: Backend, source: Shape, target: Shape, functional: NDArray[np.float64]) -> PointMaps:
    """Return the maps between all vertices of a functional map in the LBO bases, orthogonalised."""
    size = len(functional)
    return functional_point_maps(
        backend, orthogonalised(functional), source.basis.functions[:, :size], target.basis.functions[:, :size]
    )


def wavelet_steps(backend: Backend, source: Shape, target: Shape, maps: PointMaps, steps: int) -> PointMaps:
    """Return the maps after `steps` two-way steps in the whole LBO basis with Meyer wavelet filters."""
    size = min(source.basis.count, target.basis.count)
    x, y = source.basis, target.basis
    for _ in range(steps):
        functional = wavelet_filtered(
            two_way_functional_map(backend, x, y, maps, size), x.eigenvalues[:size], y.eigenvalues[:size]
        )
        maps = vertex_maps(backend, source, target, functional)
    return maps


def closed_form_rotation(
    backend: Backend, source: Spectrum, target: Spectrum, maps: PointMaps, band: Band, one_sided: bool
) -> StartingRotation:
    """Return the R that explains `maps` best, by two-way least squares, projection and square root (no losses).

    Parameters
    ----------
    source, target : scale-invariant eigenfunctions, at least as many as `band` has rows.
    """
    functional = two_way_functional_map(backend, source, target, maps, band.size)
    return starting_rotation(functional, band_mask(band), one_sided=one_sided)


def coherent_embeddings(
    backend: Backend, source: Spectrum, target: Spectrum, maps: PointMaps
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the eigenfunctions of both shapes (n_x, d), (n_y, d) turned onto each other, weighted by coherence."""
    directions = coherent_directions(two_way_functional_map(backend, source, target, maps))
    return source.functions @ directions.source, target.functions @ directions.target


def coherent_steps(backend: Backend, source: Spectrum, target: Spectrum, maps: PointMaps, steps: int) -> PointMaps:
    """Return the maps after `steps` two-way steps among the scale-invariant eigenfunctions, weighted by coherence."""
    for _ in range(steps):
        maps = point_maps(backend, *coherent_embeddings(backend, source, target, maps))
    return maps
