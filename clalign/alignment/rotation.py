"""Starting rotations: from a map between shapes to the banded, nearly orthogonal R that explains it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from clalign.alignment.band import band_mask
from clalign.engine.backend import Backend
from clalign.engine.band import Band
from clalign.geometry.spectra import Spectrum
from clalign.maps.functional_maps import polar_factor, two_way_functional_map
from clalign.maps.point_maps import PointMaps


@dataclass(frozen=True)
class StartingRotation:
    """R and the signs that had to be taken out first.

    Attributes
    ----------
    signs : (d,) ±1, absorbed into the columns of the source's eigenfunctions.
    rotation : (d, d), R with (Φ̃ diag(signs)) R ≈ Ψ̃_π Rᵀ; one-sided: C̃ with (Φ̃ diag(signs)) C̃ ≈ Ψ̃_π.
    """

    signs: NDArray[np.float64]
    rotation: NDArray[np.float64]


def starting_rotation(
    functional: NDArray[np.float64], mask: NDArray[np.bool_], *, one_sided: bool = False
) -> StartingRotation:
    """Return the R that explains a functional map between scale-invariant eigenfunctions.

    A real R cannot flip a single sign, since R R = diag(−1, 1, …) has no real solution, and about half of the
    eigenfunctions of two shapes do differ in sign. So the signs of the diagonal are taken out first, and R is the
    principal square root of what is left.

    Parameters
    ----------
    functional : (d, d) functional map between them, Ψ̃ C ≈ Φ̃[source_of_target].
    mask : (d, d) the funnel.
    one_sided : return C̃ itself (Eq. 18) instead of its square root (Eq. 19).
    """
    rotation = polar_factor(functional * mask).T
    diagonal = np.diagonal(rotation)
    signs = np.where(diagonal < 0, -1.0, 1.0)
    if np.linalg.det(rotation * signs[:, None]) < 0:
        signs[np.argmin(np.abs(diagonal))] *= -1.0
    absorbed = signs[:, None] * rotation
    if one_sided:
        return StartingRotation(signs, absorbed * mask)
    return StartingRotation(signs, orthogonal_square_root(absorbed) * mask)


def least_squares_start(
    source: Spectrum, target: Spectrum, maps: PointMaps, band: Band, backend: Backend, *, one_sided: bool
) -> StartingRotation:
    """Return the R that explains `maps` best, by two-way least squares, projection and square root (no losses).

    Parameters
    ----------
    source, target : scale-invariant eigenfunctions, at least as many as `band` has rows.
    """
    functional = two_way_functional_map(source, target, maps, band.size, backend)
    return starting_rotation(functional, band_mask(band), one_sided=one_sided)


def random_rotation(size: int, seed: int) -> NDArray[np.float64]:
    """Return the paper's start: a diagonal of random ±1."""
    return np.diag(np.random.default_rng(seed).choice([-1.0, 1.0], size))


def orthogonal_square_root(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the real orthogonal R with R R = `rotation`, an orthogonal (d, d) matrix of determinant +1.

    Every plane of rotation is turned by half its angle; half-turns, eigenvalues −1 that come in pairs, become
    quarter-turns.
    """
    triangular, vectors = scipy.linalg.schur(rotation, output="real")
    size = len(rotation)
    half = np.zeros_like(triangular)
    reversed_axes = []
    index = 0
    while index < size:
        if index + 1 < size and abs(triangular[index + 1, index]) > 1e-12:
            angle = 0.5 * np.arctan2(
                triangular[index + 1, index] - triangular[index, index + 1],
                triangular[index, index] + triangular[index + 1, index + 1],
            )
            cosine, sine = np.cos(angle), np.sin(angle)
            half[index : index + 2, index : index + 2] = [[cosine, -sine], [sine, cosine]]
            index += 2
            continue
        half[index, index] = 1.0
        if triangular[index, index] < 0:
            reversed_axes.append(index)
        index += 1
    for first, second in zip(reversed_axes[::2], reversed_axes[1::2], strict=False):
        half[[first, second], [first, second]] = 0.0
        half[first, second], half[second, first] = -1.0, 1.0
    return vectors @ half @ vectors.T
