"""What a part covers of the whole, and the map back from there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clalign.geometry.operators import diffused
from clalign.mesh.topology import side_lengths
from clalign.partial.surface import SampledSurface
from clalign.rules.parts import PartCoverageRules


def covered(
    part: SampledSurface, whole: SampledSurface, whole_of_part: NDArray[np.int64], rules: PartCoverageRules
) -> NDArray[np.bool_]:
    """Return the vertices (n_whole,) of the whole that a part covers.

    The area that the part brings to each vertex, over the area that is there, is diffused over a few edges: about 1
    where the part lies, 0 elsewhere, and one half at its boundary.
    """
    matched = whole_of_part >= 0
    brought = np.bincount(whole_of_part[matched], part.mass[matched], len(whole.mass)) / whole.mass
    edge = max(float(side_lengths(side.vertices, side.mesh.faces).mean()) for side in (part, whole))
    time = (rules.edges * edge) ** 2 / whole.area
    return np.asarray(diffused(brought, whole.mass, whole.stiffness, time) > rules.least)
