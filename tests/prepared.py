"""Prepared shapes of a few hundred vertices, and alignment problems bound to a backend."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapes
from dense_losses import DenseTerms, dense_distances
from numpy.typing import NDArray
from shapes import Pair

from clalign.alignment.band import funnel_band
from clalign.alignment.objective import Objective
from clalign.alignment.rotation import least_squares_start
from clalign.engine import Backend, Reference
from clalign.geometry.shape import Shape, prepare
from clalign.geometry.spectra import Spectrum
from clalign.maps.functional_maps import MatchedRows, functional_map
from clalign.maps.point_maps import PointMaps
from clalign.matching.stages import bind
from clalign.mesh.mesh import mesh_from_arrays
from clalign.options import Options

#: Enough functions and samples for shapes of 162 or 642 vertices.
SMALL = Options().replace(
    {
        "spectrum.basis": 16,
        "spectrum.refinement": 16,
        "spectrum.scale_invariant": 20,
        "spectrum.xi": 0.3,
        "geodesics.factor_samples": 40,
        "geodesics.search_samples": 60,
        "alignment.samples": 50,
    }
)
MIDDLE = Options().replace(
    {
        "spectrum.basis": 40,
        "spectrum.refinement": 60,
        "spectrum.scale_invariant": 60,
        "spectrum.xi": 0.3,
        "geodesics.factor_samples": 60,
        "geodesics.search_samples": 250,
        "alignment.samples": 250,
    }
)


class PreparedPair(NamedTuple):
    """Two prepared shapes and the maps between them that are right."""

    source: Shape
    target: Shape
    truth: PointMaps


def prepared_pair(pair: Pair, options: Options) -> PreparedPair:
    source, target = (prepare(mesh_from_arrays(*arrays), options) for arrays in (pair.source, pair.target))
    return PreparedPair(source, target, PointMaps(pair.truth, np.argsort(pair.truth)))


def tiny_pair(angle: float = 0.2) -> Pair:
    """Return the bumpy sphere at 162 vertices and a bent copy, each numbered in its own order."""
    vertices, faces = shapes.bumpy_sphere(2)
    source_vertices, source_faces, source_of_old = shapes.renumbered(vertices, faces, 1)
    target_vertices, target_faces, target_of_old = shapes.renumbered(shapes.bent(vertices, angle), faces, 2)
    return Pair(
        (source_vertices, source_faces), (target_vertices, target_faces), target_of_old[np.argsort(source_of_old)]
    )


def true_functional_map(
    source: Spectrum, target: Spectrum, source_of_target: NDArray[np.int64], size: int | None = None
) -> NDArray[np.float64]:
    """Return the functional map of a point map of all vertices, one way."""
    pulled = source.functions[source_of_target, :size]
    return functional_map([MatchedRows(target.functions[:, :size], pulled, target.mass)])


class Bound(NamedTuple):
    """A problem and the rotation that its true maps give."""

    problem: Objective
    rotation: NDArray[np.float64]
    truth: PointMaps


def bound(pair: PreparedPair, options: Options, backend: Backend | None = None, *, dense: bool = False) -> Bound:
    """Bind a prepared pair, its signs and its first R taken from the true maps.

    dense : evaluate Eq. 22 and 31 literally.
    """
    source, target, truth = pair
    chosen = Reference() if backend is None else backend
    count = min(options.spectrum.scale_invariant, source.scale_invariant.count, target.scale_invariant.count)
    band = funnel_band(count, options.alignment)
    one_sided = options.alignment.sides == "one"
    start = least_squares_start(
        source.scale_invariant, target.scale_invariant, truth, band, Reference(), one_sided=one_sided
    )
    scale_invariant = source.scale_invariant.head(count, start.signs), target.scale_invariant.head(count)
    objective = bind(source, target, scale_invariant, chosen, options)
    if dense:
        x, y, factors = objective.source, objective.target, objective.factors
        objective.distortion_terms = DenseTerms(x, y, factors, dense_distances(source, target), chosen)
    return Bound(objective, start.rotation, truth)
