"""What is wrong with a mesh, what the program does about it, and what is left to work with.

`diagnose` runs the checks in the order in which they make sense (a face index must be valid before its edges mean
anything), collects one `Defect` for each kind of finding, and carries along the surface with the harmless ones put
right. Loading and `clalign check` both go through it, so they cannot disagree. No native code sees a mesh that has not
passed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clalign.errors import MeshError
from clalign.mesh import topology
from clalign.mesh.defects import SHOWN, Defect, Diagnosis, Severity, Surface
from clalign.mesh.topology import IntArray

MIN_VERTICES = 12
"""Fewer vertices than an icosahedron has carry no eigenfunctions worth aligning."""
MAX_COORDINATE = 1e150
"""Squares of larger coordinates overflow float64, and squares of the inverse underflow."""
SMALL_COMPONENTS = 0.01
"""Components beside the largest are left out if together they have less than this part of the area."""
NO_AREA = 1e-12
"""A face below this part of its squared longest side, or a vertex below this part of the mean, has no area."""
NONE: IntArray = np.zeros(0, dtype=np.int64)


class Examination:
    """A surface with the harmless defects put right so far, and all that was found."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface
        self.defects: list[Defect] = []

    @property
    def refused(self) -> bool:
        """Whether a defect was found that the method cannot work with."""
        return any(defect.severity is Severity.REFUSED for defect in self.defects)

    def add(
        self,
        kind: str,
        count: int,
        problem: str,
        *,
        vertices: IntArray = NONE,
        faces: IntArray = NONE,
        action: str = "",
        advice: str = "",
    ) -> None:
        """Record a finding about numbers of `surface` under the numbers of the file.

        What the program acts on is handled, what it can only advise on is refused, and the rest is fine.
        """
        severity = Severity.HANDLED if action else Severity.REFUSED if advice else Severity.FINE
        vertex_numbers = tuple(self.surface.file_index[vertices[:SHOWN]].tolist())
        face_numbers = tuple(self.surface.face_index[faces[:SHOWN]].tolist())
        self.defects.append(Defect(kind, severity, count, problem, vertex_numbers, face_numbers, action, advice))


def diagnose(vertices: ArrayLike, faces: ArrayLike, name: str = "mesh") -> Diagnosis:
    """Check a mesh, vertices (n, 3) and faces (m, 3) from 0, and put right what is harmless.

    Raises
    ------
    MeshError
        The arrays do not have the shape of a triangle mesh; the message calls it `name`.
    """
    exam = Examination(Surface.whole(*mesh_arrays(vertices, faces, name)))
    counts = len(exam.surface.vertices), len(exam.surface.faces)
    for check in _VALUE_CHECKS:
        check(exam)
        if exam.refused:
            return Diagnosis(*counts, tuple(exam.defects), None)
    for check in _SURFACE_CHECKS:
        check(exam)
    surface, n = exam.surface, len(exam.surface.vertices)
    if exam.refused:
        components, _ = topology.connected_components(surface.faces, n)
        return Diagnosis(*counts, tuple(exam.defects), surface, components)
    loops, _ = topology.edge_loops(topology.boundary_edges(surface.faces, n))
    euler = n - len(topology.edge_table(surface.faces, n).edges) + len(surface.faces)
    return Diagnosis(*counts, tuple(exam.defects), surface, 1, loops, euler, (2 - loops - euler) // 2)


def mesh_arrays(
    vertices: ArrayLike, faces: ArrayLike, name: str = "mesh"
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Copy two array-likes into (n, 3) float64 and (m, 3) int64; MeshError if they have another shape or kind."""
    points, triangles = _rows_of_three(vertices, f"{name}: vertices"), _rows_of_three(faces, f"{name}: faces")
    if triangles.dtype.kind != "i":
        # Beyond 2**62 the conversion would wrap around; such a number is out of range in any mesh.
        in_range = np.abs(triangles.astype(np.float64)) < 2.0**62
        if not (in_range & (triangles == np.floor(triangles))).all():
            raise MeshError(f"{name}: faces must contain whole numbers; pass vertex numbers counted from 0")
    return points.astype(np.float64), triangles.astype(np.int64)


def _rows_of_three(values: ArrayLike, what: str) -> NDArray[np.number]:
    """(n, 3) array of whatever real type was given."""
    hint = "expected rows of three numbers; polygons with more corners must be cut into triangles first"
    try:
        rows = np.asarray(values)
    except ValueError as error:
        raise MeshError(f"{what} have rows of different lengths; {hint}") from error
    if rows.size == 0:
        return np.zeros((0, 3))
    if rows.ndim != 2 or rows.shape[1] != 3 or rows.dtype.kind not in "iuf":
        raise MeshError(f"{what} have shape {rows.shape} and type {rows.dtype}; {hint}")
    return rows


def _check_empty(exam: Examination) -> None:
    """Refuse point clouds and nothing at all."""
    count = len(exam.surface.vertices)
    if not count:
        exam.add("no-vertices", 1, "the mesh has no vertices", advice="export it again with its surface")
    elif not len(exam.surface.faces):
        problem = f"the mesh has {count} vertices but no faces"
        exam.add("no-faces", 1, problem, advice="a point cloud must be triangulated first")


def _check_range(exam: Examination) -> None:
    """Refuse faces that name vertices which do not exist."""
    faces, n = exam.surface.faces, len(exam.surface.vertices)
    outside = (faces < 0) | (faces >= n)
    bad = np.flatnonzero(outside.any(axis=1))
    if len(bad):
        verb = _plural(len(bad), "face names", "faces name")
        problem = f"{len(bad)} {verb} vertices outside 0 to {n - 1}, such as {faces[outside][0]}"
        advice = "check whether numbering is one-based or the vertex list cut short; without these faces, {repair}"
        exam.add("index-out-of-range", len(bad), problem, faces=bad, advice=advice)


def _check_unreferenced(exam: Examination) -> None:
    """Leave out vertices that no face uses: they have no area and would add a spurious eigenvalue each."""
    surface = exam.surface
    bad = np.setdiff1d(np.arange(len(surface.vertices)), surface.faces)
    if len(bad):
        problem = f"{len(bad)} {_plural(len(bad), 'vertex is', 'vertices are')} in no face"
        action = "left out, without a match (-1 in the maps)"
        exam.add("unreferenced-vertex", len(bad), problem, vertices=bad, action=action)
        exam.surface = surface.keep(np.ones(len(surface.faces), dtype=bool))


def _check_finite(exam: Examination) -> None:
    """Refuse NaN and infinity on the surface."""
    bad = np.flatnonzero(~np.isfinite(exam.surface.vertices).all(axis=1))
    if len(bad):
        problem = f"{len(bad)} {_plural(len(bad), 'vertex has', 'vertices have')} NaN or infinite coordinates"
        advice = "export the mesh again; without the faces there, {repair}"
        exam.add("non-finite", len(bad), problem, vertices=bad, advice=advice)


def _check_magnitude(exam: Examination) -> None:
    """Refuse coordinates whose squares leave the range of float64."""
    vertices = exam.surface.vertices
    size = np.abs(vertices).max(axis=1)
    length = float(np.ptp(vertices / max(float(size.max()), 1e-300), axis=0).max()) * float(size.max())
    bad = np.flatnonzero(size > MAX_COORDINATE)
    if len(bad):
        problem = f"coordinates up to {size.max():.3g} are too large to compute with (at most {MAX_COORDINATE:.0e})"
    elif 0 < length < 1 / MAX_COORDINATE:
        bad = np.arange(1)
        problem = f"the whole mesh is only {length:.3g} long, too small to compute with"
    else:
        return
    advice = "scale the coordinates, for example to a box of size 1, and export the mesh again"
    exam.add("coordinate-range", len(bad), problem, vertices=bad, advice=advice)


def _check_repeated_corners(exam: Examination) -> None:
    """Leave out faces that are an edge or a point by their numbers; what they join stays joined without them."""
    a, b, c = exam.surface.faces.T
    bad = (a == b) | (b == c) | (c == a)
    _leave_out(exam, bad, "repeated-corner", "names the same vertex twice", "name the same vertex twice")


def _check_duplicate_faces(exam: Examination) -> None:
    """Leave out all but the first of the faces on the same three vertices."""
    bad = topology.duplicate_faces(exam.surface.faces)
    _leave_out(exam, bad, "duplicate-face", "repeats an earlier one", "repeat earlier ones")


def _leave_out(exam: Examination, bad: NDArray[np.bool_], kind: str, one: str, many: str) -> None:
    """Leave out the marked faces, and say how many vertices that leaves alone."""
    if not bad.any():
        return
    count = int(bad.sum())
    kept = exam.surface.keep(~bad)
    lost = len(exam.surface.vertices) - len(kept.vertices)
    problem = f"{count} {_plural(count, 'face ' + one, 'faces ' + many)}"
    action = "left out" + (f", and {lost} vertices that no other face has get no match (-1)" if lost else "")
    exam.add(kind, count, problem, faces=np.flatnonzero(bad), action=action)
    exam.surface = kept


def _check_area(exam: Examination) -> None:
    """Tolerate flat faces, but not a vertex without area: it would have no mass."""
    bare, flat = bare_vertices(exam.surface)
    alone, bad = np.flatnonzero(bare), np.flatnonzero(flat)
    if not len(bad):
        return
    if flat.all():
        problem = "all faces have zero area: the vertices lie on a line or at a point"
        exam.add("no-area", len(bad), problem, faces=bad, advice="export the mesh again with more digits")
    elif len(alone):
        problem = f"{len(alone)} {_plural(len(alone), 'vertex has', 'vertices have')} only zero-area faces around"
        exam.add("no-area-vertex", len(alone), problem, vertices=alone, faces=bad, advice="{repair}")
    else:
        problem = f"{len(bad)} {_plural(len(bad), 'face has', 'faces have')} zero area"
        action = "kept, since the surface would have holes without them; cotangents are bounded there"
        exam.add("zero-area-face", len(bad), problem, faces=bad, action=action)


def bare_vertices(surface: Surface) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Vertices (n) without area around them, and faces (m) without area."""
    inside, _, _ = topology.boxed(surface.vertices)
    corners = inside[surface.faces]
    longest = ((corners - np.roll(corners, 1, axis=1)) ** 2).sum(axis=2).max(axis=1)
    flat = topology.face_areas(inside, surface.faces) <= NO_AREA * longest
    around = topology.vertex_areas(inside, surface.faces)
    return around <= NO_AREA * around.mean(), flat


def _check_components(exam: Examination) -> None:
    """Keep one component: distances and eigenfunctions mean nothing across a gap."""
    surface = exam.surface
    count, component, areas = components_by_area(surface)
    if count == 1:
        return
    largest = int(np.argmax(areas))
    share = float(areas[largest] / areas.sum())
    vertex_component = np.zeros(len(surface.vertices), dtype=np.int64)
    vertex_component[surface.faces.ravel()] = np.repeat(component, 3)
    others = np.flatnonzero(vertex_component != largest)
    samples = others[np.unique(vertex_component[others], return_index=True)[1]]
    problem = f"the mesh has {count} separate pieces, the largest with {100 * share:.4g} % of the area"
    if 1 - share < SMALL_COMPONENTS:
        action = f"the largest is kept; {len(others)} vertices are left out, without a match (-1 in the maps)"
        exam.add("small-components", count, problem, vertices=samples, action=action)
        exam.surface = surface.keep(component == largest)
        return
    advice = "with the largest piece alone, {repair}"
    if len(topology.merge_positions(surface.vertices)[0]) < len(surface.vertices):
        advice += "; add `--merge` to join vertices at equal positions first"
    exam.add("components", count, problem, vertices=samples, advice=advice)


def components_by_area(surface: Surface) -> tuple[int, NDArray[np.int64], NDArray[np.float64]]:
    """Count the components; that of every face (m), and the area of each in units of the bounding box."""
    count, label = topology.connected_components(surface.faces, len(surface.vertices))
    component = label[surface.faces[:, 0]]
    areas = topology.face_areas(topology.boxed(surface.vertices)[0], surface.faces)
    return count, component, np.bincount(component, weights=areas, minlength=count).astype(np.float64)


def _check_size(exam: Examination) -> None:
    """Refuse surfaces too small to have a spectrum."""
    n = len(exam.surface.vertices)
    if n < MIN_VERTICES:
        problem = f"the surface has only {n} vertices; at least {MIN_VERTICES} are needed"
        exam.add("too-few-vertices", n, problem, advice="subdivide the mesh")


def _check_manifold(exam: Examination) -> None:
    """Refuse edges with more than two faces, and vertices where sheets touch in a point."""
    all_faces, n = exam.surface.faces, len(exam.surface.vertices)
    table = topology.edge_table(all_faces, n)
    crowded = table.face_count > 2
    ends = table.edges[crowded]
    count = len(ends)
    if count:
        problem = f"{count} {_plural(count, 'edge belongs', 'edges belong')} to more than two faces"
        faces = np.unique(np.flatnonzero(crowded[table.edge_of_half_edge]) % len(all_faces))
        exam.add("non-manifold-edge", count, problem, vertices=np.unique(ends), faces=faces, advice="{repair}")
    fans = topology.fan_counts(all_faces, table, n)
    # At the ends of a crowded edge the sheets fall apart in any case; only the edge is the finding there.
    fans[ends.ravel()] = 1
    bad = np.flatnonzero(fans > 1)
    if len(bad):
        problem = f"at {len(bad)} {_plural(len(bad), 'vertex', 'vertices')} several sheets touch in a point only"
        exam.add("non-manifold-vertex", len(bad), problem, vertices=bad, advice="{repair}")


def _check_orientation(exam: Examination) -> None:
    """Flip the minority of faces so that neighbours agree; refuse one-sided surfaces."""
    faces = exam.surface.faces
    table = topology.edge_table(faces, len(exam.surface.vertices))
    flip, twisted = topology.coherent_orientation(faces, table, *topology.paired_half_edges(table))
    bad, turned = np.flatnonzero(twisted), np.flatnonzero(flip)
    if len(bad):
        problem = f"the surface has only one side, like a Möbius strip or a Klein bottle ({len(bad)} faces)"
        exam.add("non-orientable", len(bad), problem, faces=bad, advice="cut open along a seam, {repair}")
    if len(turned):
        problem = f"{len(turned)} {_plural(len(turned), 'face is', 'faces are')} turned against the others"
        exam.add("orientation", len(turned), problem, faces=turned, action="turned round")
        exam.surface = replace(exam.surface, faces=topology.flipped(faces, flip))


def _check_boundary(exam: Examination) -> None:
    """Mention boundaries, which are fine, and seams that look like boundaries but were meant to be closed."""
    vertices = exam.surface.vertices
    edges = topology.boundary_edges(exam.surface.faces, len(vertices))
    if not len(edges):
        return
    rim = np.unique(edges)
    loops, _ = topology.edge_loops(edges)
    problem = f"the surface has {loops} {_plural(loops, 'boundary', 'boundaries')} with {len(edges)} edges"
    exam.add("boundary", loops, problem, vertices=rim)
    first, merged = topology.merge_positions(vertices[rim])
    shared = rim[np.bincount(merged, minlength=len(first))[merged] > 1]
    if len(shared):
        problem = f"{len(shared)} boundary vertices lie exactly on another one, as if the surface was cut along a seam"
        advice = "if the surface should be closed there, {repair} (add `--merge`)"
        exam.add("open-seam", len(shared), problem, vertices=shared, action="kept apart", advice=advice)


def _check_outward(exam: Examination) -> None:
    """Flip a body that is inside out: the orientation is what tells a shape from its mirror image."""
    faces = exam.surface.faces
    if topology.outward_sign(exam.surface.vertices, faces) < 0:
        exam.add("inside-out", 1, "all faces point inward", action="turned outward")
        exam.surface = replace(exam.surface, faces=topology.flipped(faces, np.ones(len(faces), dtype=bool)))


def _plural(count: int, one: str, many: str) -> str:
    return one if count == 1 else many


_VALUE_CHECKS = (
    _check_empty,
    _check_range,
    _check_unreferenced,
    _check_finite,
    _check_magnitude,
    _check_repeated_corners,
    _check_duplicate_faces,
    _check_empty,
    _check_area,
)
_SURFACE_CHECKS = (
    _check_components,
    _check_size,
    _check_manifold,
    _check_orientation,
    _check_boundary,
    _check_outward,
)
