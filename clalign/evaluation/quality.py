"""Coverage and smoothness of a map: what its errors at the points of the truth do not show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clalign.geometry.operators import lumped_mass, stiffness
from clalign.mesh.mesh import Mesh


@dataclass(frozen=True)
class MapQuality:
    """Coverage and smoothness of a vertex map.

    covered_vertices : share of the target's vertices that are the match of some source vertex.
    covered_area : share of the target's area that belongs to those vertices.
    dirichlet : Dirichlet energy ½ Σ_k f_kᵀ W f_k of the map as a function into space, f = coordinates of the
        matches, divided by the source's area; 1 for an isometry, larger for a map that tears.
    stretch : mean over the source's edges of the distance between the matches of their ends, divided by the edge's
        length; 1 for an isometry up to the targets' vertices being discrete. Both are None where no face is matched
        as a whole.
    """

    covered_vertices: float
    covered_area: float
    dirichlet: float | None
    stretch: float | None


def map_quality(source: Mesh, target: Mesh, target_of_source: NDArray[np.int64]) -> MapQuality:
    """Return coverage and smoothness of a map between compact vertices, (n,) int64 with -1 for none."""
    hit = np.unique(target_of_source[target_of_source >= 0])
    mass = lumped_mass(target.vertices, target.faces)
    corners = source.faces[(target_of_source[source.faces] >= 0).all(axis=1)]
    if not corners.size:
        return MapQuality(hit.size / target.n_vertices, float(mass[hit].sum() / mass.sum()), None, None)
    used, local = np.unique(corners, return_inverse=True)
    faces = local.reshape(corners.shape).astype(np.int32)
    points = source.vertices[used]
    images = target.vertices[target_of_source[used]]
    area = float(lumped_mass(points, faces).sum())
    energy = 0.5 * float(np.sum(images * (stiffness(points, faces) @ images)))
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0)
    lengths = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    image_lengths = np.linalg.norm(images[edges[:, 0]] - images[edges[:, 1]], axis=1)
    return MapQuality(
        hit.size / target.n_vertices,
        float(mass[hit].sum() / mass.sum()),
        energy / area,
        float(np.mean(image_lengths / lengths)),
    )
