"""The objective of a pair of shapes, its value and gradient over the band entries of R (Eq. 24, 32).

    l(R) = l_align(R) + λ l_unsup(R)          l(R) = l_align(R) + λ (l_unsup(R) + l_cyc(R)) / 2

R gives the coefficients α, β (Eq. 26), these the functional map C (`functional_map`), C the soft map P (`soft_map`),
and P the terms (`losses`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.alignment.functional_map import AlignedCoefficients
from clalign.alignment.losses import AlignmentLoss, DistanceTerms, FixedCorrespondence, distance_terms, penalties
from clalign.alignment.problem_data import SampledFactors, ShapeData
from clalign.engine.backend import Backend
from clalign.engine.band import Band
from clalign.maps.nearest import Orders
from clalign.options import AlignmentOptions
from clalign.rules import AlignmentRules


@dataclass(frozen=True)
class Evaluation:
    """The objective at one point.

    Attributes
    ----------
    total : value of the objective.
    terms : "align", "unsup", "cycle" (if used), and each `Penalty` by its name.
    gradient : (variables,) float64.
    """

    total: float
    terms: dict[str, float]
    gradient: NDArray[np.float64]


class Objective:
    """Eq. 24 or 32 of a pair of shapes over the entries of R inside the band.

    Parameters
    ----------
    source, target : what the losses need of each shape.
    factors : distance factors at the vertices of the source where the losses are evaluated.
    band : the variables.
    backend : where the arithmetic runs; one thread only.
    options, rules : variants of the objective, and its constants.
    distortion_terms : Eq. 22 and 31; None evaluates them from low-rank factors.
    """

    def __init__(
        self,
        source: ShapeData,
        target: ShapeData,
        factors: SampledFactors,
        band: Band,
        backend: Backend,
        options: AlignmentOptions,
        rules: AlignmentRules,
        distortion_terms: DistanceTerms | None = None,
    ) -> None:
        self.source, self.target, self.factors = source, target, factors
        self.band, self.backend, self.options, self.rules = band, backend, options, rules
        self._positions = band.positions
        self._one_sided = options.sides == "one"
        self._align = AlignmentLoss(source, target, band, backend, one_sided=self._one_sided)
        self._penalties = penalties(band, backend, options)
        self._coefficients = AlignedCoefficients(
            source.projection, target.projection, band, backend, one_sided=self._one_sided, ridge=rules.ridge
        )
        self.distortion_terms = distortion_terms or distance_terms(
            source, target, factors, backend, cycle=options.cycle
        )

    def fix(
        self, rotation: NDArray[np.float64], target_of_source: NDArray[np.int64], weight: float
    ) -> FixedCorrespondence:
        """Fix the hard map `target_of_source` (n_x,), λ = `weight`, and what else is fixed at `rotation` (d, d)."""
        at = rotation if self.options.denominator == "fixed" else None
        return self._align.fix(target_of_source, weight, at)

    def pack(self, rotation: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the entries of (d, d) `rotation` inside the band, as the optimiser's vector."""
        return np.ascontiguousarray(rotation[self._positions], dtype=np.float64)

    def unpack(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Inverse of `pack`: (d, d) with zeros outside the band."""
        rotation = np.zeros((self.band.size, self.band.size))
        rotation[self._positions] = x
        return rotation

    @property
    def scale_invariant(self) -> tuple[Any, Any]:
        """Φ̃ (n_x, d) and Ψ̃ (n_y, d), arrays of the backend."""
        return self._align.source, self._align.target

    @property
    def orders(self) -> Orders:
        """Orders of the vertices of both shapes."""
        return self.source.order, self.target.order

    def embeddings(self, rotation: NDArray[np.float64]) -> tuple[Any, Any]:
        """Return Φ̃ R (n_x, d) and Ψ̃ Rᵀ (n_y, d) (one-sided: Ψ̃), arrays of the backend."""
        backend, (x, y) = self.backend, self.scale_invariant
        uploaded, transposed = self._both(rotation)
        source = backend.banded_product(x, uploaded, right=self.band)
        return source, y if self._one_sided else backend.banded_product(y, transposed, right=self.band.transposed)

    def functional_map(self, rotation: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return C (k_y, k_x) from R by least squares (Eq. 11, 26)."""
        solved, _ = self._coefficients.solve(*self._coefficients.coefficients(*self._both(rotation)))
        return self.backend.numpy(solved).astype(np.float64)

    def value_and_gradient(self, x: NDArray[np.float64], fixed: FixedCorrespondence) -> Evaluation:
        """Evaluate Eq. 24 (or 32) at the packed entries `x` (variables,) of R."""
        backend, options, through = self.backend, self.options, self._coefficients
        rotation = backend.band_expand(backend.array(x), self.band)
        transposed = backend.transpose(rotation)
        align, gradient = self._align.value_and_gradient(rotation, transposed, fixed)
        alpha, beta = through.coefficients(rotation, transposed)
        functional, gram = through.solve(alpha, beta)
        functional_back, gram_back = through.solve(beta, alpha) if options.cycle else (None, None)
        distortions = self.distortion_terms(functional, functional_back)
        dalpha, dbeta = through.solve_gradient(distortions.slope, functional, gram, alpha, beta)
        if options.cycle:
            back = through.solve_gradient(distortions.slope_back, functional_back, gram_back, beta, alpha)
            dalpha, dbeta = backend.add(dalpha, back[1]), backend.add(dbeta, back[0])
        # The mean of the terms that read distances (Eq. 32).
        weight = fixed.weight / len(distortions.terms)
        through.add_gradient(dalpha, dbeta, weight, gradient)
        added = {each.name: each.value_adding_gradient(rotation, transposed, gradient) for each in self._penalties}
        losses = {"align": align, **distortions.terms, **added}
        # The one place where the host waits for the device.
        packed, *values = backend.read(
            [backend.band_gather(gradient, self.band), *(loss.value for loss in losses.values())]
        )
        terms = {name: float(value) / loss.divisor for (name, loss), value in zip(losses.items(), values, strict=True)}
        total = terms["align"] + weight * sum(terms[name] for name in distortions.terms)
        total += sum(each.weight * terms[each.name] for each in self._penalties)
        return Evaluation(total, terms, packed.astype(np.float64))

    def _both(self, rotation: NDArray[np.float64]) -> tuple[Any, Any]:
        """Return R and Rᵀ on the backend."""
        uploaded = self.backend.array(rotation)
        return uploaded, self.backend.transpose(uploaded)
