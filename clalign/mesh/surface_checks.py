"""Checks of the surface as a whole: pieces, size, manifoldness, orientation, boundary.

Read strictly, each refuses what is not as it should be. Otherwise the surface that was most likely meant is read: seams
are closed, sheets that only touch are parted, and faces are turned to agree with each other.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clalign.mesh import topology
from clalign.mesh.defects import SHOWN, Defect, Severity, Surface
from clalign.mesh.examination import Examination, plural
from clalign.mesh.gluing import glued
from clalign.mesh.topology import BoolArray, IntArray
from clalign.mesh.welding import boundary_partners, cut_at_junctions, joined, welding_distance

MIN_VERTICES = 12
"""Fewer vertices than an icosahedron has carry no eigenfunctions worth aligning."""
ONE_SIDED = 0.5
"""A surface is one-sided if more than this part of its area is; a smaller part is cut open along a seam."""


def close_seams(exam: Examination) -> None:
    """Join vertices of the boundary at one place, and cut faces where a vertex lies on their open side."""
    if exam.strict:
        return
    surface = exam.surface
    rim = np.unique(topology.boundary_edges(surface.faces, len(surface.vertices)))
    if not len(rim):
        return
    distance = welding_distance(surface)
    partner = boundary_partners(surface, rim, distance)
    moved = np.flatnonzero(partner != np.arange(len(partner)))
    closed = joined(surface, partner) if len(moved) else surface
    # A strip that is closed to a Möbius strip would lose its sides; a small one beside a body is cut open later.
    if len(moved) and area_share(closed, _twisted(closed)) <= ONE_SIDED:
        lie = plural(len(moved), "vertex lies", "vertices lie")
        problem = f"{len(moved)} {lie} on open edges at the place of another one (within {distance:.2g})"
        exam.add("open-seam", len(moved), problem, vertices=moved, action="joined to it, to share one match")
        exam.surface = closed
    exam.surface, cut = cut_at_junctions(exam.surface, distance)
    if len(cut):
        lie = plural(len(cut), "vertex lies", "vertices lie")
        problem = f"{len(cut)} {lie} in the middle of an open edge of another face"
        exam.add("t-junction", len(cut), problem, vertices=cut, action="those faces are cut in two there")


def check_size(exam: Examination) -> None:
    """Refuse surfaces too small to have a spectrum."""
    n = len(exam.surface.vertices)
    if n < MIN_VERTICES:
        problem = f"the surface has only {n} vertices; at least {MIN_VERTICES} are needed"
        exam.add("too-few-vertices", n, problem, advice="subdivide the mesh")


def check_manifold(exam: Examination) -> None:
    """Part sheets that meet at an edge with more than two faces or touch in a point, or refuse them."""
    all_faces, n = exam.surface.faces, len(exam.surface.vertices)
    table = topology.edge_table(all_faces, n)
    crowded = table.face_count > 2
    ends = table.edges[crowded]
    fans = topology.fan_counts(all_faces, table, n)
    # At the ends of a crowded edge the sheets fall apart in any case; only the edge is the finding there.
    fans[ends.ravel()] = 1
    bad = np.flatnonzero(fans > 1)
    if not len(ends) and not len(bad):
        return
    if not exam.strict and _one_sided(exam):
        return
    advice = "{repair}" if exam.strict else ""
    if len(ends):
        problem = f"{len(ends)} {plural(len(ends), 'edge belongs', 'edges belong')} to more than two faces"
        faces = np.unique(np.flatnonzero(crowded[table.edge_of_half_edge]) % len(all_faces))
        action = "" if exam.strict else "cut there; faces that go straight on stay joined"
        exam.add(
            "non-manifold-edge", len(ends), problem, vertices=np.unique(ends), faces=faces, action=action, advice=advice
        )
    if len(bad):
        problem = f"at {len(bad)} {plural(len(bad), 'vertex', 'vertices')} several sheets touch in a point only"
        action = "" if exam.strict else "parted there"
        exam.add("non-manifold-vertex", len(bad), problem, vertices=bad, action=action, advice=advice)
    if not exam.strict:
        _part(exam)


def _part(exam: Examination) -> None:
    """Glue the surface anew; what more that changes is said under the numbers of the file."""
    result = glued(exam.surface)
    exam.surface = result.surface
    if result.left:
        problem = f"{result.left} edges and vertices of several sheets could not be parted"
        exam.add("unparted", result.left, problem, advice="remesh it, or delete the faces that are not meant")
    if len(result.turned):
        problem = f"{len(result.turned)} {plural(len(result.turned), 'face is', 'faces are')} turned against the others"
        exam.defects.append(_of_faces("orientation", problem, result.turned, "turned round"))
    if len(result.dropped):
        problem = f"{len(result.dropped)} faces lie at edges that could not be cut"
        exam.defects.append(_of_faces("uncut-face", problem, result.dropped, "left out"))


def _of_faces(kind: str, problem: str, numbers: IntArray, action: str) -> Defect:
    """A handled finding about faces that are known by their given numbers."""
    return Defect(kind, Severity.HANDLED, len(numbers), problem, (), tuple(numbers[:SHOWN].tolist()), action)


def check_orientation(exam: Examination) -> None:
    """Flip the minority of faces so that neighbours agree; refuse one-sided surfaces."""
    faces = exam.surface.faces
    table = topology.edge_table(faces, len(exam.surface.vertices))
    flip, twisted = topology.coherent_orientation(faces, table, *topology.paired_half_edges(table))
    if twisted.any() and not _one_sided(exam):
        problem = f"{int(twisted.sum())} faces are in a part with only one side, like a Möbius strip"
        action = "cut open along a seam"
        exam.add("non-orientable", int(twisted.sum()), problem, faces=np.flatnonzero(twisted), action=action)
        _part(exam)
        return
    turned = np.flatnonzero(flip)
    if len(turned):
        problem = f"{len(turned)} {plural(len(turned), 'face is', 'faces are')} turned against the others"
        exam.add("orientation", len(turned), problem, faces=turned, action="turned round")
        exam.surface = replace(exam.surface, faces=topology.flipped(faces, flip))


def _twisted(surface: Surface) -> BoolArray:
    """(m,) True for the faces of patches that cannot be oriented."""
    table = topology.edge_table(surface.faces, len(surface.vertices))
    return topology.coherent_orientation(surface.faces, table, *topology.paired_half_edges(table))[1]


def area_share(surface: Surface, faces: BoolArray) -> float:
    """Area of the marked faces, as a part of all."""
    areas = topology.face_areas(topology.boxed(surface.vertices)[0], surface.faces)
    total = float(areas.sum())
    return float(areas[faces].sum()) / total if total > 0 else 0.0


def _one_sided(exam: Examination) -> bool:
    """Refuse a surface with only one side; read strictly, already for a part of it."""
    twisted = _twisted(exam.surface)
    bad = np.flatnonzero(twisted)
    if not len(bad):
        return False
    if not exam.strict and (exam.cut_open or area_share(exam.surface, twisted) <= ONE_SIDED):
        return False
    problem = f"the surface has only one side, like a Möbius strip or a Klein bottle ({len(bad)} faces)"
    exam.add("non-orientable", len(bad), problem, faces=bad, advice="cut open along a seam, {repair}")
    return True


def check_boundary(exam: Examination) -> None:
    """Mention boundaries, which are fine, and seams that look like boundaries but were meant to be closed."""
    vertices = exam.surface.vertices
    edges = topology.boundary_edges(exam.surface.faces, len(vertices))
    if not len(edges):
        return
    rim = np.unique(edges)
    loops, _ = topology.edge_loops(edges)
    problem = f"the surface has {loops} {plural(loops, 'boundary', 'boundaries')} with {len(edges)} edges"
    exam.add("boundary", loops, problem, vertices=rim)
    if not exam.strict:
        return
    first, merged = topology.merge_positions(vertices[rim])
    shared = rim[np.bincount(merged, minlength=len(first))[merged] > 1]
    if len(shared):
        problem = f"{len(shared)} boundary vertices lie exactly on another one, as if the surface was cut along a seam"
        advice = "if the surface should be closed there, {repair} (add `--merge`)"
        exam.add("open-seam", len(shared), problem, vertices=shared, action="kept apart", advice=advice)


def check_outward(exam: Examination) -> None:
    """Flip a body that is inside out: the orientation is what tells a shape from its mirror image."""
    faces = exam.surface.faces
    if topology.outward_sign(exam.surface.vertices, faces) < 0:
        exam.add("inside-out", 1, "all faces point inward", action="turned outward")
        exam.surface = replace(exam.surface, faces=topology.flipped(faces, np.ones(len(faces), dtype=bool)))
