"""The terms of the objective as the paper numbers them, each with its gradient.

| term | equation | reads | gradient by |
|---|---|---|---|
| `AlignmentLoss` | 21 | R and the fixed correspondence | R |
| `DistortionLoss` | 17, 22 | C through the soft map, distances | C |
| `CycleLoss` | 31 | both functional maps, distances of the source | C and the map back |
| `UnitarityLoss` | 23 | R | R |

A term of R alone is a `Penalty` and is listed in `penalties`; `objective` adds up whatever there is.

Nothing of size n × n is made: the soft map P enters through Z = PᵀU, distances through low-rank factors. Values are
read when the whole gradient is queued (`Loss`), so that nothing waits for the device before.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from clalign.alignment.problem_data import SampledFactors, ShapeData
from clalign.alignment.soft_map import MomentsSoftMap, SoftMap, cheaper_soft_map, moments_soft_map
from clalign.engine.backend import Backend
from clalign.engine.band import Band
from clalign.options import AlignmentOptions


@dataclass(frozen=True)
class FixedCorrespondence:
    """What stays fixed while L-BFGS runs: the hard map, through its Gram matrices, the denominator and λ.

    Attributes
    ----------
    target_of_source : (n_x,) the hard map π.
    gram_source, gram_target, gram_cross : (d, d) on the backend, Φ̃ᵀAΦ̃, Ψ̃_πᵀAΨ̃_π and Φ̃ᵀAΨ̃_π.
    denominator : of l_align, fixed as in the paper; None differentiates it.
    weight : λ.
    """

    target_of_source: NDArray[np.int64]
    gram_source: Any
    gram_target: Any
    gram_cross: Any
    denominator: float | None
    weight: float


@dataclass(frozen=True)
class Loss:
    """A loss that the device may still compute.

    Attributes
    ----------
    value : number, or array of shape () on the backend.
    divisor : of the value.
    """

    value: Any
    divisor: float = 1.0


class AlignmentLoss:
    """l_align(R) = ‖Φ̃R − Ψ̃_π Rᵀ‖² / ‖Ψ̃_π Rᵀ‖² over the source (Eq. 21), from Gram matrices (d, d) alone."""

    def __init__(self, source: ShapeData, target: ShapeData, band: Band, backend: Backend, *, one_sided: bool) -> None:
        self.source, self.target = backend.array(source.scale_invariant), backend.array(target.scale_invariant)
        self._band, self._backend, self._one_sided = band, backend, one_sided
        self._mass = backend.array(source.loss_weights)
        self._gram_source = backend.weighted_gram(self.source, self.source, self._mass)

    def fix(
        self, target_of_source: NDArray[np.int64], weight: float, rotation: NDArray[np.float64] | None
    ) -> FixedCorrespondence:
        """Return the hard map (n_x,) fixed with λ = `weight`, and the denominator fixed at `rotation` if given."""
        backend = self._backend
        carried = backend.gather(self.target, backend.array(target_of_source.astype(np.int32)))
        grams = (
            self._gram_source,
            backend.weighted_gram(carried, carried, self._mass),
            backend.weighted_gram(self.source, carried, self._mass),
        )
        if rotation is None:
            return FixedCorrespondence(target_of_source, *grams, denominator=None, weight=weight)
        at = backend.array(rotation)
        _, denominator, _, _ = backend.alignment(at, backend.transpose(at), *grams, self._band, self._one_sided)
        return FixedCorrespondence(target_of_source, *grams, denominator=float(denominator), weight=weight)

    def value_and_gradient(self, rotation: Any, transposed: Any, fixed: FixedCorrespondence) -> tuple[Loss, Any]:
        """Return the value and the gradient (d, d) inside the band."""
        backend = self._backend
        grams = fixed.gram_source, fixed.gram_target, fixed.gram_cross
        numerator, denominator, dnumerator, ddenominator = backend.alignment(
            rotation, transposed, *grams, self._band, self._one_sided
        )
        if fixed.denominator is not None:
            gradient = backend.add(dnumerator, ddenominator, scale_a=1.0 / fixed.denominator, scale_b=0.0)
            return Loss(numerator, fixed.denominator), gradient
        value, gradient = backend.quotient(numerator, denominator, dnumerator, ddenominator)
        return Loss(value), gradient


class Penalty(Protocol):
    """A term of R alone, which the objective has with a weight.

    name : in histories and results.
    weight : 0 only reports it.
    """

    name: str
    weight: float

    def value_adding_gradient(self, rotation: Any, transposed: Any, gradient: Any) -> Loss:
        """Return the value; the gradient of the weighted penalty, if any, is added to `gradient` (d, d)."""


class UnitarityLoss:
    """l_uni(R) = ‖R Rᵀ − I‖² / d² (Eq. 23), reported always, a penalty where `weight` is not zero."""

    name = "unitarity"

    def __init__(self, band: Band, backend: Backend, weight: float) -> None:
        self._band, self._backend, self.weight = band, backend, weight
        self._identity = backend.array(np.eye(band.size))

    def value_adding_gradient(self, rotation: Any, transposed: Any, gradient: Any) -> Loss:
        """See `Penalty`."""
        backend, band, size = self._backend, self._band, self._band.size
        excess = backend.banded_product(rotation, transposed, left=band, right=band.transposed)
        backend.add(excess, self._identity, scale_b=-1.0, out=excess)
        flat = excess.reshape(size * size, 1)
        if self.weight > 0:
            scale = 4.0 * self.weight / size**2
            backend.banded_product(excess, rotation, right=band, kept=band, scale=scale, accumulate=True, out=gradient)
        return Loss(backend.weighted_gram(flat, flat).reshape(()), size**2)


def penalties(band: Band, backend: Backend, options: AlignmentOptions) -> tuple[Penalty, ...]:
    """Return the terms of R alone."""
    return (UnitarityLoss(band, backend, options.unitarity),)


@dataclass(frozen=True)
class Distortions:
    """The terms that read distances, at one functional map.

    Attributes
    ----------
    terms : "unsup" (Eq. 22) and, with the cycle term, "cycle" (Eq. 31).
    slope : (k_y, k_x) on the backend, gradient of their sum by C.
    slope_back : (k_x, k_y), its gradient by the functional map from Y to X; None without the cycle term.
    """

    terms: dict[str, Loss]
    slope: Any
    slope_back: Any = None


class DistanceTerms(Protocol):
    """Eq. 22 and 31, in whatever way they are evaluated."""

    def __call__(self, functional: Any, functional_back: Any) -> Distortions:
        """Return both terms at C (k_y, k_x) and the map back (k_x, k_y), which is None without the cycle term."""


@dataclass(frozen=True)
class SoftMapState:
    """The soft map at the rows c_j of `carried` (n, k), with what its gradient needs again."""

    carried: Any
    soft_map: SoftMap
    z: Any
    s: Any

    @staticmethod
    def at(backend: Backend, functional: Any, basis: Any, soft_map: SoftMap) -> SoftMapState:
        """Evaluate a soft map at c_j = C φ_j for the rows φ_j of `basis` (n, k)."""
        carried = backend.product(basis, functional, transpose_b=True)
        return SoftMapState(carried, soft_map, *soft_map.forward(backend, carried))

    def gradient(self, backend: Backend, basis: Any, dz: Any) -> Any:
        """Return dC = Σ_j dc_j φ_jᵀ from the slope dZ (n, r)."""
        dc = self.soft_map.gradient(backend, self.carried, self.z, self.s, dz)
        return backend.product(dc, basis, transpose_a=True)


class DistortionLoss:
    """l_unsup(C) = ‖D_X − PᵀD_Y P‖² over pairs of sampled source vertices (Eq. 22), D ≈ U T Uᵀ on both sides."""

    def __init__(
        self, source: ShapeData, target: ShapeData, factors: SampledFactors, backend: Backend, soft_map: SoftMap
    ) -> None:
        array = backend.array
        self._backend, self._soft_map = backend, soft_map
        self.basis = array(source.basis[factors.vertices])
        self.left, self.core_source = array(factors.left), array(factors.core)
        self.weights = array(factors.weights)
        self._core_target = array(target.core)

    def value_and_gradient(self, functional: Any) -> tuple[Any, Any, SoftMapState]:
        """Return the value, its gradient by C, and the soft map from X to Y."""
        state = SoftMapState.at(self._backend, functional, self.basis, self._soft_map)
        value, dz = self._backend.distortion(state.z, self._core_target, self.left, self.core_source, self.weights)
        return value, state.gradient(self._backend, self.basis, dz), state

    def __call__(self, functional: Any, functional_back: Any = None) -> Distortions:
        """Return the term alone: there is no map back."""
        value, slope, _ = self.value_and_gradient(functional)
        return Distortions({"unsup": Loss(value)}, slope)


class CycleLoss:
    """l_cyc = ‖D_X − (P̃P)ᵀD_X P̃P‖² (Eq. 31) beside Eq. 22.

    P̃ goes from Y to X: Z̃ = P̃ᵀU_X on all of Y, then PᵀZ̃ on the samples of X, with moments rebuilt from Z̃.
    """

    def __init__(self, source: ShapeData, target: ShapeData, factors: SampledFactors, backend: Backend) -> None:
        array = backend.array
        self._backend = backend
        # The gradient goes through packed moments, whatever the streamed form would cost.
        towards_target = moments_soft_map(backend, target)
        self._distortion = DistortionLoss(source, target, factors, backend, towards_target)
        self._towards_source, self._normal_target = moments_soft_map(backend, source), towards_target.normal
        self._basis_target, self._weights_target = array(target.basis), array(target.soft_weights)
        self._core_source = array(source.core)
        first, second = np.triu_indices(source.basis.shape[1])
        self._single = array(np.where(first == second, 1.0, 0.5))

    def __call__(self, functional: Any, functional_back: Any) -> Distortions:
        """Return Eq. 22 and Eq. 31 with the gradients of their sum by both functional maps."""
        backend, distortion = self._backend, self._distortion
        unsup, slope, there = distortion.value_and_gradient(functional)
        back = SoftMapState.at(backend, functional_back, self._basis_target, self._towards_source)
        moments = backend.packed_moments(self._basis_target, self._weights_target, back.z)
        around = MomentsSoftMap(moments, self._normal_target)
        z, s = around.forward(backend, there.carried)
        cycle, dz = backend.distortion(
            z, self._core_source, distortion.left, distortion.core_source, distortion.weights
        )
        cycle_slope = SoftMapState(there.carried, around, z, s).gradient(backend, distortion.basis, dz)
        dpacked = self._moments_gradient(there.carried, s, dz)
        dz_back = backend.packed_moments_gradient(self._basis_target, self._weights_target, dpacked)
        slope_back = back.gradient(backend, self._basis_target, dz_back)
        return Distortions({"unsup": Loss(unsup), "cycle": Loss(cycle)}, backend.add(slope, cycle_slope), slope_back)

    def _moments_gradient(self, carried: Any, s: Any, dz: Any) -> Any:
        """Return the gradient by the packed moments: Σ_j vech(c_j c_jᵀ) dz_jr / s_j, without rows where s_j = 0."""
        backend = self._backend
        return backend.scale_rows(backend.packed_moments(carried, backend.reciprocal(s), dz), self._single)


def distance_terms(
    source: ShapeData, target: ShapeData, factors: SampledFactors, backend: Backend, *, cycle: bool
) -> DistanceTerms:
    """Return Eq. 22 with the soft map in its cheaper form, or Eq. 22 and 31."""
    if cycle:
        return CycleLoss(source, target, factors, backend)
    soft_map = cheaper_soft_map(backend, target, len(factors.vertices))
    return DistortionLoss(source, target, factors, backend, soft_map)
