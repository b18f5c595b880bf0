"""Distances to anchors beside the eigenfunctions, for bodies that are not isometric.

On a body of other proportions the higher functions of a limb have no counterpart of the same frequency, and rows of
eigenfunctions no longer say which limb a vertex is on: the hands of an ape look like feet. Distances from points whose
matches are beyond doubt do.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clalign.engine.backend import Backend
from clalign.geometry.shape import Shape
from clalign.mesh.descriptors import beside_each_other
from clalign.refinement.zoomout import vertex_maps
from clalign.rules import Rules
from clalign.search.batch import SamplePair, distortions, up_sample


def relative_distortion(
    source: Shape, target: Shape, functional: NDArray[np.float64], rules: Rules, backend: Backend
) -> float:
    """Return the mean of |a − b| / (a + b + floor) over the distances a and b of matched pairs of samples."""
    pair = SamplePair.of(source, target, backend)
    level = pair.fitted(rules.search.fine.last)
    batch = up_sample(pair, functional[None], [level])
    return float(distortions(pair, batch.index, level.points, rules.search.distance_floor)[0])


def anchored(
    source: Shape, target: Shape, functional: NDArray[np.float64], rules: Rules, backend: Backend
) -> tuple[Shape, Shape]:
    """Return both shapes with geodesic distances to matched anchors as descriptors beside their eigenfunctions.

    Anchors are farthest-point samples of the source which the map, there and back, brings near to where they were.
    Every distance is in units of the mean distance from its anchor on the same shape, which forgives the size of limbs.

    Parameters
    ----------
    functional : (k, k), the map of the search, between Laplace–Beltrami functions.

    Returns
    -------
    The same shapes where there are too few anchors, or descriptors of the user already.
    """
    limits = rules.anchors
    maps = vertex_maps(source, target, functional, backend)
    rows = source.geodesics.rows[: limits.looked_at].astype(np.float64)
    images = maps.target_of_source[source.geodesics.samples[: len(rows)]]
    returned = rows[np.arange(len(rows)), maps.source_of_target[images]]
    kept = np.flatnonzero(returned < limits.returned)[: limits.most]
    if kept.size < limits.least or source.given is not None:
        return source, target
    left = target.factors.left
    others = left @ (target.factors.core @ left[images[kept]].T)
    own = rows[kept].T
    x, y = own / (source.mass @ own), others / (target.mass @ others)
    given = beside_each_other(x, y, limits.weight)
    if given is None:
        return source, target
    return replace(source, given=given[0]), replace(target, given=given[1])
