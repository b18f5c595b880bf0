"""A pair of shapes bound to a backend: the value and gradient of the objective over the band entries of R.

With α = F R, β = H Rᵀ (Eq. 26), C solving C α = β by least squares, c_j = C φ_j and the soft map P of Eq. 27, the
objective is Eq. 24, or Eq. 32 with the cycle term:

    l(R) = l_align(R) + λ l_unsup(R)          l(R) = l_align(R) + λ (l_unsup(R) + l_cyc(R)) / 2.

Nothing of size n × n is made: P enters through Z = PᵀU (`soft_forms`), distances through low-rank factors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.alignment.problem_data import AlignedSide, SampledFactors
from clalign.alignment.soft_map import QuadraticForm, SoftForm, cheaper_form, quadratic_form
from clalign.engine.backend import Backend
from clalign.engine.band import Band
from clalign.maps.nearest import Orders
from clalign.options import AlignmentOptions

RIDGE = 1e-6


@dataclass(frozen=True)
class Round:
    """What is frozen while L-BFGS runs: the hard map, through its Gram matrices, the denominator and λ.

    Attributes
    ----------
    target_of_source : (n_x,) the hard map π.
    gram_source, gram_target, gram_cross : (d, d) on the backend, Φ̃ᵀAΦ̃, Ψ̃_πᵀAΨ̃_π and Φ̃ᵀAΨ̃_π.
    denominator : of l_align; 0 differentiates it instead of freezing it.
    weight : λ.
    """

    target_of_source: NDArray[np.int64]
    gram_source: Any
    gram_target: Any
    gram_cross: Any
    denominator: float
    weight: float


@dataclass(frozen=True)
class Evaluation:
    """The objective at one point.

    Attributes
    ----------
    total : value of the objective.
    terms : "align", "unsup", "cycle" (if used) and "unitarity".
    gradient : (variables,) float64.
    """

    total: float
    terms: dict[str, float]
    gradient: NDArray[np.float64]


@dataclass(frozen=True)
class Distortions:
    """The terms that read distances, at one functional map.

    Attributes
    ----------
    terms : "unsup" (Eq. 22) and, with the cycle term, "cycle" (Eq. 31).
    slope : (k_y, k_x) on the backend, gradient of their sum by C.
    slope_back : (k_x, k_y), its gradient by the functional map from Y to X; None without the cycle term.
    """

    terms: dict[str, Any]
    slope: Any
    slope_back: Any = None


@dataclass(frozen=True)
class _SoftMapState:
    """Intermediate arrays of one soft map that its gradient needs again."""

    carried: Any
    form: SoftForm
    z: Any
    s: Any


class AlignmentProblem:
    """The objective of a pair of shapes over the entries of R inside the band.

    Parameters
    ----------
    source, target : what the losses need of each shape.
    factors : distance factors at the vertices of the source where the losses are evaluated.
    band : the variables.
    backend : where the arithmetic runs; one thread only.
    options : variants of the objective.
    """

    def __init__(
        self,
        source: AlignedSide,
        target: AlignedSide,
        factors: SampledFactors,
        band: Band,
        backend: Backend,
        options: AlignmentOptions,
    ) -> None:
        self.source, self.target, self.factors = source, target, factors
        self.band, self.backend, self.options = band, backend, options
        self._positions = band.positions
        array = backend.array
        self._projection_x, self._projection_y = array(source.projection), array(target.projection)
        self._turned_projection_x = backend.transpose(self._projection_x)
        self._descriptors_x, self._descriptors_y = array(source.descriptors), array(target.descriptors)
        self._mass_x = array(source.loss_weights)
        self._gram_source = backend.weighted_gram(self._descriptors_x, self._descriptors_x, self._mass_x)
        self._identity = array(np.eye(band.size))
        self._diagonals = {
            size: array(np.eye(size).reshape(-1, 1)) for size in {source.basis.shape[1], target.basis.shape[1]}
        }
        self._bind_distances()

    def _bind_distances(self) -> None:
        """Upload what `_distortions` reads."""
        source, target, factors = self.source, self.target, self.factors
        backend, array = self.backend, self.backend.array
        self._sampled_basis = array(np.ascontiguousarray(source.basis[factors.vertices]))
        self._left, self._core_x = array(factors.left), array(factors.core)
        self._weights = array(factors.weights)
        self._core_y = array(target.core)
        if not self.options.cycle:
            self._form_y = cheaper_form(backend, target, len(factors.vertices))
            return
        # Its gradient goes through packed moments.
        towards_y = quadratic_form(backend, target)
        self._form_y, self._form_x, self._normal_y = towards_y, quadratic_form(backend, source), towards_y.normal
        self._basis_y, self._soft_weights_y = array(target.basis), array(target.soft_weights)
        self._core_all_x = array(source.core)
        first, second = np.triu_indices(source.basis.shape[1])
        self._single = array(np.where(first == second, 1.0, 0.5))

    def start_round(self, rotation: NDArray[np.float64], target_of_source: NDArray[np.int64], weight: float) -> Round:
        """Freeze the hard map `target_of_source` (n_x,) and the denominator at `rotation` (d, d)."""
        backend = self.backend
        carried = backend.gather(self._descriptors_y, backend.array(target_of_source.astype(np.int32)))
        grams = (
            self._gram_source,
            backend.weighted_gram(carried, carried, self._mass_x),
            backend.weighted_gram(self._descriptors_x, carried, self._mass_x),
        )
        if self.options.denominator == "differentiated":
            return Round(target_of_source, *grams, denominator=0.0, weight=weight)
        turns = self._turns(backend.array(rotation))
        _, denominator, _, _ = backend.alignment(*turns, *grams, self.band, self._one_sided)
        return Round(target_of_source, *grams, denominator=float(denominator), weight=weight)

    def pack(self, rotation: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the entries of (d, d) `rotation` inside the band, as the optimiser's vector."""
        return np.ascontiguousarray(rotation[self._positions], dtype=np.float64)

    def unpack(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Inverse of `pack`: (d, d) with zeros outside the band."""
        rotation = np.zeros((self.band.size, self.band.size))
        rotation[self._positions] = x
        return rotation

    @property
    def descriptors(self) -> tuple[Any, Any]:
        """Φ̃ (n_x, d) and Ψ̃ (n_y, d), arrays of the backend."""
        return self._descriptors_x, self._descriptors_y

    @property
    def orders(self) -> Orders:
        """Orders of the vertices of both shapes."""
        return self.source.order, self.target.order

    def embeddings(self, rotation: NDArray[np.float64]) -> tuple[Any, Any]:
        """Return Φ̃ R (n_x, d) and Ψ̃ Rᵀ (n_y, d) (one-sided: Ψ̃), arrays of the backend."""
        backend = self.backend
        turn, turned = self._turns(backend.array(rotation))
        source = backend.banded_product(self._descriptors_x, turn, right=self.band)
        if self._one_sided:
            return source, self._descriptors_y
        return source, backend.banded_product(self._descriptors_y, turned, right=self.band.transposed)

    def functional_map(self, rotation: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return C (k_y, k_x) from R by least squares (Eq. 11, 26)."""
        alpha, beta = self._coefficients(*self._turns(self.backend.array(rotation)))
        return self.backend.numpy(self._solve(alpha, beta)[0]).astype(np.float64)

    def value_and_gradient(self, x: NDArray[np.float64], frozen: Round) -> Evaluation:
        """Evaluate Eq. 24 (or 32) at the packed entries `x` (variables,) of R."""
        backend, options = self.backend, self.options
        rotation, turned = self._turns(backend.band_expand(backend.array(x), self.band))
        align, gradient = self._align(rotation, turned, frozen)
        alpha, beta = self._coefficients(rotation, turned)
        functional, gram = self._solve(alpha, beta)
        functional_back, gram_back = self._solve(beta, alpha) if options.cycle else (None, None)
        distortions = self._distortions(functional, functional_back)
        scalars = {"align": align, **distortions.terms}
        unsup_weight = frozen.weight * (0.5 if options.cycle else 1.0)
        dalpha, dbeta = self._solve_gradient(distortions.slope, functional, gram, alpha, beta)
        if options.cycle:
            dbeta_back, dalpha_back = self._solve_gradient(
                distortions.slope_back, functional_back, gram_back, beta, alpha
            )
            dalpha, dbeta = backend.add(dalpha, dalpha_back), backend.add(dbeta, dbeta_back)
        self._add_rotation_gradient(dalpha, dbeta, unsup_weight, gradient)
        scalars["unitarity"] = self._unitarity(rotation, turned, gradient)
        packed = backend.numpy(backend.band_gather(gradient, self.band)).astype(np.float64)
        terms = {name: float(value) for name, value in scalars.items()}
        if frozen.denominator > 0:
            terms["align"] /= frozen.denominator
        terms["unitarity"] /= self.band.size**2
        distortion = terms["unsup"] + terms.get("cycle", 0.0)
        total = terms["align"] + unsup_weight * distortion + options.unitarity * terms["unitarity"]
        return Evaluation(total, terms, packed)

    @property
    def _one_sided(self) -> bool:
        return self.options.sides == "one"

    def _turns(self, rotation: Any) -> tuple[Any, Any]:
        """Return R and Rᵀ."""
        return rotation, self.backend.transpose(rotation)

    def _coefficients(self, rotation: Any, turned: Any) -> tuple[Any, Any]:
        """Return α = F R and β = H Rᵀ (Eq. 26); one-sided: F C̃ and H (Eq. 18)."""
        alpha = self.backend.banded_product(self._projection_x, rotation, right=self.band)
        if self._one_sided:
            return alpha, self._projection_y
        return alpha, self.backend.banded_product(self._projection_y, turned, right=self.band.transposed)

    def _solve(self, alpha: Any, beta: Any) -> tuple[Any, Any]:
        """Return C = β αᵀ (α αᵀ + ρ I)⁻¹ and the Gram matrix α αᵀ."""
        gram = self.backend.product(alpha, alpha, transpose_b=True)
        cross = self.backend.product(beta, alpha, transpose_b=True)
        return self.backend.solve_right(gram, cross, RIDGE), gram

    def _solve_gradient(self, slope: Any, functional: Any, gram: Any, alpha: Any, beta: Any) -> tuple[Any, Any]:
        """Return dα and dβ for dC = `slope`, through C G = β αᵀ with G = α αᵀ + ρ I."""
        backend = self.backend
        dcross = backend.solve_right(gram, slope, RIDGE)
        dgram = backend.product(functional, dcross, transpose_a=True, scale=-1.0)
        dbeta = backend.product(dcross, alpha)
        dalpha = backend.product(dcross, beta, transpose_a=True)
        backend.product(dgram, alpha, accumulate=True, out=dalpha)
        backend.product(dgram, alpha, transpose_a=True, accumulate=True, out=dalpha)
        # The ridge is relative, ρ tr(G) / k, so it has a slope too: 2 ρ / k tr(dG) α.
        size = gram.shape[0]
        trace = backend.weighted_gram(dgram.reshape(size * size, 1), self._diagonals[size])
        # As one long row: a product writes many columns at once, and of a single column only one value.
        flat = (1, alpha.shape[0] * alpha.shape[1])
        slope_scale = 2.0 * RIDGE / size
        backend.product(trace, alpha.reshape(flat), scale=slope_scale, accumulate=True, out=dalpha.reshape(flat))
        return dalpha, dbeta

    def _add_rotation_gradient(self, dalpha: Any, dbeta: Any, weight: float, gradient: Any) -> None:
        """Add the weight times Fᵀ dα + dβᵀ H to the gradient by R."""
        parts = [(self._turned_projection_x, dalpha)]
        if not self._one_sided:
            parts.append((self.backend.transpose(dbeta), self._projection_y))
        for left, right in parts:
            self.backend.banded_product(left, right, kept=self.band, scale=weight, accumulate=True, out=gradient)

    def _soft_map(self, functional: Any, basis: Any, form: SoftForm) -> _SoftMapState:
        carried = self.backend.product(basis, functional, transpose_b=True)
        return _SoftMapState(carried, form, *form.forward(self.backend, carried))

    def _functional_gradient(self, state: _SoftMapState, basis: Any, dz: Any) -> Any:
        """Return dC = Σ_j dc_j φ_jᵀ."""
        dc = state.form.gradient(self.backend, state.carried, state.z, state.s, dz)
        return self.backend.product(dc, basis, transpose_a=True)

    def _align(self, rotation: Any, turned: Any, frozen: Round) -> tuple[Any, Any]:
        """Return l_align (Eq. 21) and its gradient (d, d) inside the band.

        With a frozen denominator the value still lacks it; only a differentiated one waits for the device here.
        """
        backend = self.backend
        numerator, denominator, dnumerator, ddenominator = backend.alignment(
            rotation,
            turned,
            frozen.gram_source,
            frozen.gram_target,
            frozen.gram_cross,
            self.band,
            self._one_sided,
        )
        if frozen.denominator > 0:
            return numerator, backend.add(dnumerator, ddenominator, scale_a=1.0 / frozen.denominator, scale_b=0.0)
        scale = 1.0 / float(denominator)
        value = float(numerator) * scale
        return value, backend.add(dnumerator, ddenominator, scale_a=scale, scale_b=-value * scale)

    def _distortions(self, functional: Any, functional_back: Any) -> Distortions:
        """Return Eq. 22 at C and, given the map back, Eq. 31, with their gradients."""
        backend = self.backend
        state = self._soft_map(functional, self._sampled_basis, self._form_y)
        unsup, dz = backend.distortion(state.z, self._core_y, self._left, self._core_x, self._weights)
        slope = self._functional_gradient(state, self._sampled_basis, dz)
        if functional_back is None:
            return Distortions({"unsup": unsup}, slope)
        cycle, cycle_slope, slope_back = self._cycle(state, functional_back)
        return Distortions({"unsup": unsup, "cycle": cycle}, backend.add(slope, cycle_slope), slope_back)

    def _cycle(self, there: _SoftMapState, functional_back: Any) -> tuple[Any, Any, Any]:
        """Return l_cyc (Eq. 31) and its gradients by C and by the map back.

        P̃ goes from Y to X: Z̃ = P̃ᵀU_X on all of Y, then PᵀZ̃ on the samples of X, with moments rebuilt from Z̃.
        """
        backend = self.backend
        back = self._soft_map(functional_back, self._basis_y, self._form_x)
        around = QuadraticForm(backend.packed_moments(self._basis_y, self._soft_weights_y, back.z), self._normal_y)
        z, s = around.forward(backend, there.carried)
        value, dz = backend.distortion(z, self._core_all_x, self._left, self._core_x, self._weights)
        state = _SoftMapState(there.carried, around, z, s)
        slope = self._functional_gradient(state, self._sampled_basis, dz)
        dpacked = self._packed_gradient(there.carried, s, dz)
        dz_back = backend.packed_moments_gradient(self._basis_y, self._soft_weights_y, dpacked)
        return value, slope, self._functional_gradient(back, self._basis_y, dz_back)

    def _packed_gradient(self, carried: Any, s: Any, dz: Any) -> Any:
        """Return the gradient by the packed moments: Σ_j vech(c_j c_jᵀ) dz_jr / s_j, without rows where s_j = 0."""
        backend = self.backend
        return backend.scale_rows(backend.packed_moments(carried, backend.reciprocal(s), dz), self._single)

    def _unitarity(self, rotation: Any, turned: Any, gradient: Any) -> Any:
        """Return d² l_uni (Eq. 23); its penalty, if any, is added to `gradient`."""
        backend, size = self.backend, self.band.size
        excess = backend.banded_product(rotation, turned, left=self.band, right=self.band.transposed)
        backend.add(excess, self._identity, scale_b=-1.0, out=excess)
        flat = excess.reshape(size * size, 1)
        if self.options.unitarity > 0:
            scale = 4.0 * self.options.unitarity / size**2
            backend.banded_product(
                excess, rotation, right=self.band, kept=self.band, scale=scale, accumulate=True, out=gradient
            )
        return backend.weighted_gram(flat, flat).reshape(())
