"""Which side of a surface a map of samples shows, told without eigenfunctions, which a cut changes.

For distances d_j and d_k from two samples the sign of n · (∇d_j × ∇d_k) at a third says on which side of it they lie.
A map that keeps the orientation carries it along, one that reverses it changes it.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from clalign.mesh.topology import face_normals, vertex_normals
from clalign.partial.intervals import Intervals
from clalign.partial.surface import SampledSurface
from clalign.rules.parts import PartFacingRules


def triple_products(surface: SampledSurface, sources: NDArray[np.int64], at: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return (a, s, s) products n · (∇d_j × ∇d_k) of unit gradients at vertices.

    Parameters
    ----------
    sources : (s,) samples, by their number, from which distances are taken.
    at : (a,) vertices.
    """
    vertices, faces = surface.vertices, surface.mesh.faces
    incident = sparse.csr_matrix(
        (np.ones(faces.size), (faces.ravel(), np.repeat(np.arange(len(faces)), 3))), shape=(len(vertices), len(faces))
    )[at]
    around = np.unique(incident.indices)
    corners = faces[around]
    normals = face_normals(vertices, corners)
    doubled = np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    opposite = vertices[corners[:, [2, 0, 1]]] - vertices[corners[:, [1, 2, 0]]]
    # Twice the area times the gradient of the function that is 1 at a corner and 0 at the other two.
    across = np.cross((normals / doubled)[:, None], opposite)
    values = surface.rows[sources].astype(np.float64)[:, corners]
    gradients = np.einsum("sfc,fcx->fsx", values, across)
    summed = (incident[:, around] @ gradients.reshape(len(around), -1)).reshape(len(at), len(sources), 3)
    length = np.linalg.norm(summed, axis=2, keepdims=True)
    unit = summed / np.maximum(length, np.finfo(np.float64).tiny)
    turned = np.cross(vertex_normals(vertices, faces)[at][:, None], unit)
    return np.asarray(np.einsum("ajx,akx->ajk", turned, unit), dtype=np.float64)


def orientation(
    part: SampledSurface, whole: SampledSurface, known: Intervals, places: NDArray[np.int64], rules: PartFacingRules
) -> NDArray[np.float64]:
    """Return for every map (B, S) how far it keeps the orientation: about 1 if it does, −1 if it reverses it.

    Only distances count that the part's boundary has not lengthened, and that are no distances of neighbours.

    known : (S, S) bounds of the distances among the part's samples.
    """
    own = triple_products(part, np.arange(len(part.samples)), part.samples)
    trusted = (known.upper - known.lower < rules.slack) & (known.upper > rules.near)
    counted = trusted[:, :, None] & trusted[:, None, :]
    mine = own[counted]
    found = np.zeros(len(places))
    for number, each in enumerate(places):
        other = triple_products(whole, each, whole.samples[each])[counted]
        norm = np.sqrt((mine @ mine) * (other @ other))
        found[number] = (mine @ other) / norm if norm > 0 else 0.0
    return found
