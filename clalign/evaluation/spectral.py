"""How well eigenfunctions are aligned: err(k) of Fig. 9, the true C̃ of Fig. 3 and rotations inside pairs of Fig. 2.

All functions take a true map between the vertices of the surfaces (`truth.true_maps`) and work in double precision.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clalign.correspondence import Correspondence
from clalign.geometry.spectra import Spectrum, fix_signs
from clalign.maps.functional_maps import PointMaps


@dataclass(frozen=True)
class SpectralErrors:
    """err(k) of one match over k = 1 … d.

    Attributes
    ----------
    unaligned : (d,) of the eigenfunctions as the solver gives them.
    signed : (d,) of those, with the better sign of each chosen by the truth: what signs alone could reach.
    aligned : (d,) of Φ̃ R against Ψ̃ Rᵀ.
    """

    unaligned: NDArray[np.float64]
    signed: NDArray[np.float64]
    aligned: NDArray[np.float64]


@dataclass(frozen=True)
class PairRotation:
    """What C̃ does inside the span of two neighbouring eigenfunctions (Fig. 2).

    Attributes
    ----------
    block : (2, 2) part of C̃.
    angle : of the rotation nearest to the block, in degrees, in (-180, 180].
    reflected : the nearest orthogonal matrix is that rotation after the second function changed its sign.
    kept : share of the energy of the two rows and columns of C̃ that lies in the block; 1 when the span is carried to
        the span.
    """

    block: NDArray[np.float64]
    angle: float
    reflected: bool
    kept: float


def as_computed(spectrum: Spectrum) -> NDArray[np.float64]:
    """Return the (n, d) eigenfunctions with the solver's signs, whatever signs it absorbed in a match."""
    return fix_signs(spectrum.functions, spectrum.mass)


def alignment_errors(
    source: NDArray[np.float64],
    target: NDArray[np.float64],
    target_of_source: NDArray[np.int64],
    mass: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return err(k) = ‖col_k(Π*Ψ̂ − Φ̂)‖ / ‖col_k(Π*Ψ̂)‖, the relative misalignment of each function (Fig. 9).

    Parameters
    ----------
    source, target : (n_x, d) and (n_y, d) functions Φ̂ and Ψ̂, aligned or not.
    target_of_source : (n_x,) true map; Π* pulls functions on the target back to the source.
    mass : (n_x,) vertex areas of the source: the norm is that of the Euclidean metric.

    Returns
    -------
    (d,) float64: 0 for equal functions, about 1.4 for unrelated ones, 2 for opposite ones.
    """
    pulled = target[target_of_source]
    difference = np.sqrt(mass @ np.square(pulled - source))
    return np.asarray(difference / np.maximum(np.sqrt(mass @ np.square(pulled)), np.finfo(np.float64).tiny))


def spectral_errors(correspondence: Correspondence, maps: PointMaps) -> SpectralErrors:
    """Return err(k) of a match before and after alignment, by true maps between its meshes."""
    source, target = as_computed(correspondence.source_scale_invariant), correspondence.target_scale_invariant.functions
    count = len(correspondence.rotation)
    source, target = source[:, :count], target[:, :count]
    mass = correspondence.source_basis.mass
    index = maps.target_of_source
    unaligned = alignment_errors(source, target, index, mass)
    return SpectralErrors(
        unaligned=unaligned,
        signed=np.minimum(unaligned, alignment_errors(-source, target, index, mass)),
        aligned=alignment_errors(correspondence.source_aligned, correspondence.target_aligned, index, mass),
    )


def true_rotation(
    source: NDArray[np.float64], target: Spectrum, source_of_target: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return the true C̃ of Π*Φ̃ C̃ = Ψ̃ (Eq. 18): C̃_ij = ⟨φ̃_i ∘ π⁻¹, ψ̃_j⟩ in the scale-invariant metric of the target.

    Parameters
    ----------
    source : (n_x, d) scale-invariant eigenfunctions of the source.
    target : those of the target, orthonormal in its own mass.
    source_of_target : (n_y,) true map.

    Returns
    -------
    (d, d) float64; orthogonal as far as the shapes are isometric.
    """
    pulled = source[source_of_target]
    return np.asarray(pulled.T @ (target.mass[:, None] * target.functions[:, : source.shape[1]]))


def rotation_of_truth(correspondence: Correspondence, maps: PointMaps) -> NDArray[np.float64]:
    """Return the true C̃ (d, d) of the eigenfunctions that a match has aligned, by true maps between its meshes."""
    source = as_computed(correspondence.source_scale_invariant)[:, : len(correspondence.rotation)]
    return true_rotation(source, correspondence.target_scale_invariant, maps.source_of_target)


def recovered_rotation(correspondence: Correspondence) -> NDArray[np.float64]:
    """Return the C̃ that a match amounts to, for the eigenfunctions as the solver gives them.

    (Φ̃ S) R ≈ Ψ̃_π Rᵀ with the absorbed signs S and a nearly orthogonal R means C̃ = S R R (Eq. 19); for a one-sided match
    it is S C̃ (Eq. 18).
    """
    absorbed = correspondence.source_scale_invariant
    signs = np.sign(np.einsum("nd,nd->d", absorbed.functions, as_computed(absorbed)))[: len(correspondence.rotation)]
    rotation = correspondence.rotation
    if correspondence.options.alignment.sides == "both":
        rotation = rotation @ rotation
    return np.asarray(signs[:, None] * rotation)


def pair_rotation(rotation: NDArray[np.float64], first: int) -> PairRotation:
    """Return what C̃ (d, d) does to the functions of 0-based numbers `first` and ``first + 1``."""
    block = rotation[first : first + 2, first : first + 2]
    left, _, right = np.linalg.svd(block)
    nearest = left @ right
    reflected = bool(np.linalg.det(nearest) < 0)
    if reflected:
        nearest = nearest * np.array([[1.0], [-1.0]])
    angle = float(np.degrees(np.arctan2(nearest[1, 0] - nearest[0, 1], nearest[0, 0] + nearest[1, 1])))
    rows, columns = rotation[first : first + 2], rotation[:, first : first + 2]
    energy = max(0.5 * float(np.square(rows).sum() + np.square(columns).sum()), np.finfo(np.float64).tiny)
    return PairRotation(block.copy(), angle, reflected, float(np.square(block).sum() / energy))


def most_rotated_pair(
    rotation: NDArray[np.float64], support: NDArray[np.float64] | None = None, largest: int = 60
) -> int:
    """Return the 0-based number of the first of the two neighbours that C̃ turns most within their own span.

    The constant function is left out. A pair scores the smallest of the entries of its block, times the share of energy
    that stays in the span: a swap or a sign is no rotation.

    Parameters
    ----------
    support : (d,) multiplies the scores by the smaller one of each pair, to prefer functions that live on much of the
        surface (`support_areas`); None leaves them.
    largest : pairs up to this index are looked at.
    """
    count = len(rotation)
    weights = np.ones(count) if support is None else support
    scores = []
    for first in range(1, min(largest, count - 1)):
        block = np.abs(rotation[first : first + 2, first : first + 2])
        kept = min(*np.square(block).sum(axis=0), *np.square(block).sum(axis=1))
        scores.append(kept * float(block.min()) * min(weights[first], weights[first + 1]))
    return 1 + int(np.argmax(scores)) if scores else 0


def support_areas(functions: NDArray[np.float64], mass: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (d,) the share of the area that each function lives on, (Σ A φ²)² / (Σ A · Σ A φ⁴): 1 for a constant."""
    squares = mass @ np.square(functions)
    return np.asarray(np.square(squares) / (mass.sum() * (mass @ functions**4)))


def energy_inside(rotation: NDArray[np.float64], mask: NDArray[np.bool_]) -> float:
    """Return the share of the squared entries of `rotation` that lies inside `mask`."""
    squares = np.square(rotation)
    return float(squares[mask].sum() / squares.sum())


def coupling_spread(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (d,) the root mean square of j − i over each row i, weighted by squared entries: the funnel's width."""
    squares = np.square(rotation)
    index = np.arange(len(rotation))
    distance = np.square(index[None, :] - index[:, None])
    total = np.maximum(squares.sum(axis=1), np.finfo(np.float64).tiny)
    return np.asarray(np.sqrt((squares * distance).sum(axis=1) / total))
