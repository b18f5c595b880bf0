"""How two maps of one pair differ, told from the source alone: by the map of the source to itself between them.

    σ = T_other ∘ T_chosen⁻¹,  Φ F ≈ Φ ∘ σ  with  F = Cᵀ_chosen C_other

A symmetry of the source gives a second map that is as good as the first. Its order, whether it keeps the orientation,
how much of the surface it moves and in which direction is what a person needs to tell which map is meant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clalign.geometry.shape import Shape
from clalign.maps.functional_maps import polar_factor
from clalign.maps.nearest import nearest_rows
from clalign.mesh.front import front_view
from clalign.rules import RelationRules

DIRECTIONS = ("left and right", "top and bottom", "front and back")
AXES = ("left–right axis", "vertical axis", "front–back axis")


@dataclass(frozen=True)
class Relation:
    """What a map does to the source, compared with the chosen one.

    Attributes
    ----------
    reversing : whether it turns the surface inside out.
    order : after so many repetitions everything is back at its place; None where that are too many to tell.
    moved : share of the area that it moves.
    along : (3,) shares of the squared distances in space that points move, to the right, up and towards the viewer, as
        the source is seen from the front (`clalign.mesh.front.front_view`).
    """

    reversing: bool
    order: int | None
    moved: float
    along: tuple[float, float, float]

    def words(self, rules: RelationRules) -> str:
        """Return a description for people."""
        share = "" if self.moved > rules.everything else f", in {self.moved:.0%} of the surface"
        most, least = int(np.argmax(self.along)), int(np.argmin(self.along))
        # A half turn moves points in two directions, of which one may be much shorter.
        if self.order == 2 and self.along[most] >= (rules.one_way if self.reversing else rules.one_way_only):
            kind = "mirror image" if self.reversing else "exchange"
            return f"{kind}: {DIRECTIONS[most]} are exchanged{share}"
        about = f" about the {AXES[least]}" if self.along[least] <= rules.no_way else ""
        if self.order == 2:
            return f"{'mirror image: two sides are exchanged' if self.reversing else f'half turn{about}'}{share}"
        if self.order is None:
            kind = "mirrored" if self.reversing else "shifted or turned"
            return f"{kind}{about}, with no small number of repetitions that lead back{share}"
        kind = "turn with a reflection" if self.reversing else "turn"
        return f"{self.order}-fold {kind}{about}: {self.order} of them lead back{share}"


def relation(
    source: Shape,
    chosen: NDArray[np.float64],
    other: NDArray[np.float64],
    *,
    reversing: bool,
    rules: RelationRules,
) -> Relation:
    """Return how one map differs from the chosen one.

    Parameters
    ----------
    chosen, other : (k, k) functional maps from the source to the target.
    reversing : whether their orientations are opposite.
    """
    size = min(rules.functions, len(chosen), len(other))
    factor = polar_factor(
        polar_factor(chosen[:size, :size].astype(np.float64)).T @ polar_factor(other[:size, :size].astype(np.float64))
    )
    count = min(rules.samples, len(source.geodesics.distances))
    samples, apart = source.geodesics.samples[:count], source.geodesics.distances[:count, :count]
    weights = source.geodesics.sample_weights(count)
    rows, own = source.basis.functions[samples, :size], np.arange(count)
    image = nearest_rows(rows @ factor, rows)
    moves = apart[own, image]
    first = float(weights @ moves)
    power, order = factor, None
    for number in range(2, rules.highest_order + 1):
        power = power @ factor
        back = float(weights @ apart[own, nearest_rows(rows @ power, rows)])
        if back < max(rules.back, rules.nearly_back * first):
            order = number
            break
    points = source.mesh.vertices @ front_view(source.mesh.vertices).T
    squares = weights @ (points[samples[image]] - points[samples]) ** 2
    right, up, toward = squares / max(float(squares.sum()), 1e-300)
    moved = float(weights[moves > rules.moved].sum() / weights.sum())
    return Relation(reversing, order, moved, (float(right), float(up), float(toward)))
