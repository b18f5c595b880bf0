"""Matches of a finished result as points in faces, in both directions, also where the match has kept vertices only."""

from __future__ import annotations

import numpy as np

from clalign.correspondence import Correspondence
from clalign.maps.functional_maps import MatchedRows, functional_map, singular_value_weighting
from clalign.refinement.precise import SurfacePoints, closest_points

RIDGE = 1e-6
"""Of the least squares, relative to the mean of the diagonal: maps of parts leave functions undetermined."""


def precise_places(correspondence: Correspondence, *, forward: bool = True) -> SurfacePoints:
    """Return for every vertex of one shape the point of the other that is closest in the aligned embedding.

    Both maps together give a functional map between the scale-invariant eigenfunctions, as in the last step of the
    read-out; in the embedding weighted by its singular values, the faces around the matched vertex are searched.

    Parameters
    ----------
    forward : from the source to the target, else from the target to the source.

    Returns
    -------
    SurfacePoints
        (n,) for the vertices of the mesh; what belongs to a vertex without a match means nothing.
    """
    source, target = correspondence.source, correspondence.target
    to_target = source.map_from_file(target, correspondence.target_of_source)
    to_source = target.map_from_file(source, correspondence.source_of_target)
    phi, psi = correspondence.source_scale_invariant, correspondence.target_scale_invariant
    on_source, on_target = to_target >= 0, to_source >= 0
    functional = functional_map(
        [
            MatchedRows(psi.functions[on_target], phi.functions[to_source[on_target]], psi.mass[on_target]),
            MatchedRows(psi.functions[to_target[on_source]], phi.functions[on_source], phi.mass[on_source]),
        ],
        ridge=RIDGE,
    )
    x, y = singular_value_weighting(functional)
    embedded = phi.functions @ x, psi.functions @ y
    here, there, faces, nearest = embedded[0], embedded[1], target.faces, to_target
    if not forward:
        here, there, faces, nearest = embedded[1], embedded[0], source.faces, to_source
    return closest_points(here, there, faces, np.maximum(nearest, 0))
