"""Whether a mesh may be a part of the other, from what can be told at once: boundaries and areas."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from clalign.mesh.mesh import Mesh
from clalign.mesh.topology import boundary_edges, graph_components
from clalign.rules.parts import PartExtentRules

Side = Literal["source", "target"]


def openness(mesh: Mesh) -> float:
    """Return the area of the flat caps that would close the holes of a mesh, as a part of its own area.

    The vector area ½ Σ p × p' of a loop is that of its cap, whatever the origin.
    """
    edges = boundary_edges(mesh.faces, mesh.n_vertices)
    if not len(edges):
        return 0.0
    _, label = graph_components(mesh.n_vertices, edges[:, 0], edges[:, 1])
    swept = 0.5 * np.cross(mesh.vertices[edges[:, 0]], mesh.vertices[edges[:, 1]])
    loops, loop = np.unique(label[edges[:, 0]], return_inverse=True)
    caps = np.stack([np.bincount(loop, weights=column, minlength=len(loops)) for column in swept.T], axis=1)
    return float(np.linalg.norm(caps, axis=1).sum())


def suspected_part(source: Mesh, target: Mesh, rules: PartExtentRules) -> Side | None:
    """Return which mesh may be a part of the other, None where both have to be taken as wholes.

    A part has a boundary that more than a small hole leaves, and less area if both files have one unit. Two open meshes
    of the same area are cut alike.
    """
    open_sides = openness(source) > rules.open, openness(target) > rules.open
    ratio = (source.scale / target.scale) ** 2
    if not any(open_sides) or (all(open_sides) and abs(math.log(ratio)) < math.log(rules.same_area)):
        return None
    if all(open_sides):
        return "source" if ratio < 1.0 else "target"
    return "source" if open_sides[0] else "target"
