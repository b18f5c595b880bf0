"""How alike points of a part and of a whole look: areas of geodesic balls, and mean curvature in them.

A ball on a part is cut off at the boundary, so what it holds is compared as far as the ball lies inside: a ball of the
part never has more area than the one of the whole, and as much where it is not cut.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clalign.geometry.operators import diffused
from clalign.partial.surface import SampledSurface
from clalign.rules.parts import PartDescriptorRules

LEAST = 1e-9
"""Areas and curvatures below are none; their logarithms would not be finite."""


@dataclass(frozen=True, eq=False)
class BallProfiles:
    """Logarithms of what geodesic balls around the samples of a surface hold.

    Attributes
    ----------
    areas : (S, radii) of the areas.
    curvatures : (S, radii) of the means of |H|.
    trust : (S, radii) in [0, 1], how far a ball lies inside the surface.
    """

    areas: NDArray[np.float64]
    curvatures: NDArray[np.float64]
    trust: NDArray[np.float64]


def ball_profiles(surface: SampledSurface, rules: PartDescriptorRules) -> BallProfiles:
    """Return the profiles of all samples of a surface."""
    held = np.stack([surface.mass, surface.mass * np.abs(surface.curvature)], axis=1).astype(np.float32)
    radii = np.array(rules.radii)
    totals = np.empty((len(surface.samples), 2, len(radii)))
    for number, radius in enumerate(radii):
        inside = np.clip((radius - surface.rows) / np.float32(rules.soft * radius) + np.float32(0.5), 0.0, 1.0)
        totals[:, :, number] = inside @ held
    areas = np.maximum(totals[:, 0], LEAST)
    trust = np.clip(surface.to_boundary[surface.samples][:, None] / radii, 0.0, 1.0) ** 2
    return BallProfiles(np.log(areas), np.log(np.maximum(totals[:, 1] / areas, LEAST)), trust)


def look_costs(part: BallProfiles, whole: BallProfiles, rules: PartDescriptorRules) -> NDArray[np.float64]:
    """Return (S_part, S_whole): how unlike a sample of the part and one of the whole look, a median of about 1."""
    trust = part.trust[:, None] * whole.trust[None]
    more = part.areas[:, None] - whole.areas[None]
    # What the part's ball has more than the whole's is wrong wherever the boundary is, unless the whole's is cut too.
    counted = np.where(more > 0, whole.trust[None], trust)
    area = np.mean(np.minimum(np.abs(more) * counted, rules.most_area), axis=2)
    bent = np.minimum(np.abs(part.curvatures[:, None] - whole.curvatures[None]), rules.most_curvature)
    curvature = np.sum(bent * trust, axis=2) / np.maximum(np.sum(trust, axis=2), LEAST)
    terms = (rules.area, area), (rules.curvature, curvature)
    return np.asarray(sum(weight * term / max(float(np.median(term)), LEAST) for weight, term in terms))


def curvature_fields(surface: SampledSurface, times: tuple[float, ...]) -> NDArray[np.float64]:
    """Return (n, times) logarithms of |H|, averaged by diffusion among vertices inside of the boundary.

    times : diffusion times in squared units of length.
    """
    inside = (surface.to_boundary > 0).astype(np.float64)
    fields = []
    for time in times:
        step = surface.mass, surface.stiffness, time / surface.area
        bent, known = (diffused(values, *step) for values in (inside * np.abs(surface.curvature), inside))
        fields.append(np.log(np.maximum(bent / np.maximum(known, 1e-6), 0.5)))
    return np.stack(fields, axis=1)
