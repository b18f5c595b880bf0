"""What is wrong with a mesh, what the program does about it, and what is left to work with.

`diagnose` runs the checks in the order in which they make sense (a face index must be valid before its edges mean
anything), collects one `Defect` for each kind of finding, and carries along the surface with the harmless ones put
right. Loading and `clalign check` both go through it, so they cannot disagree. No native code sees a mesh that has not
passed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clalign.errors import MeshError
from clalign.mesh import topology
from clalign.mesh.defects import SHOWN, Defect, Diagnosis, Severity, Surface

MIN_VERTICES = 12
"""Fewer vertices than an icosahedron has carry no eigenfunctions worth aligning."""
MAX_COORDINATE = 1e150
"""Squares of larger coordinates overflow float64, and squares of the inverse underflow."""
SMALL_COMPONENTS = 0.01
"""Components beside the largest are left out if together they have less than this part of the area."""
NO_AREA = 1e-12
"""A face below this part of its squared longest side, or a vertex below this part of the mean, has no area."""

Checked = tuple[Surface, list[Defect]]


def diagnose(vertices: ArrayLike, faces: ArrayLike, name: str = "mesh") -> Diagnosis:
    """Check a mesh and put right what is harmless.

    Parameters
    ----------
    vertices : (n, 3) float
    faces : (m, 3) int
        vertex numbers from 0.
    name : str
        what to call the mesh in an error.

    Returns
    -------
    Diagnosis

    Raises
    ------
    MeshError
        if the arrays do not have the shape of a triangle mesh.
    """
    surface = Surface.whole(*mesh_arrays(vertices, faces, name))
    n_vertices, n_faces = len(surface.vertices), len(surface.faces)
    defects: list[Defect] = []
    for check in _VALUE_CHECKS:
        surface, found = check(surface)
        defects += found
        if _refuses(found):
            return Diagnosis(n_vertices, n_faces, tuple(defects), None)
    for check in _SURFACE_CHECKS:
        surface, found = check(surface)
        defects += found
    if _refuses(defects):
        components, _ = topology.connected_components(surface.faces, len(surface.vertices))
        return Diagnosis(n_vertices, n_faces, tuple(defects), surface, components)
    loops, _ = topology.edge_loops(topology.boundary_edges(surface.faces, len(surface.vertices)))
    euler = (
        len(surface.vertices)
        - len(topology.edge_table(surface.faces, len(surface.vertices)).edges)
        + len(surface.faces)
    )
    return Diagnosis(n_vertices, n_faces, tuple(defects), surface, 1, loops, euler, (2 - loops - euler) // 2)


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


def _refuses(defects: list[Defect]) -> bool:
    return any(defect.severity is Severity.REFUSED for defect in defects)


def _defect(
    surface: Surface,
    kind: str,
    count: int,
    problem: str,
    *,
    vertices: NDArray[np.integer] | None = None,
    faces: NDArray[np.integer] | None = None,
    action: str = "",
    advice: str = "",
) -> Defect:
    """Record a finding about numbers of `surface` under the numbers of the file.

    What the program acts on is handled, what it can only advise on is refused, and the rest is fine.
    """
    severity = Severity.HANDLED if action else Severity.REFUSED if advice else Severity.FINE
    vertex_numbers = () if vertices is None else tuple(surface.file_index[vertices[:SHOWN]].tolist())
    face_numbers = () if faces is None else tuple(surface.face_index[faces[:SHOWN]].tolist())
    return Defect(kind, severity, count, problem, vertex_numbers, face_numbers, action, advice)


def _check_empty(surface: Surface) -> Checked:
    """Refuse point clouds and nothing at all."""
    if not len(surface.vertices):
        problem, advice = "the mesh has no vertices", "export it again with its surface"
        return surface, [_defect(surface, "no-vertices", 1, problem, advice=advice)]
    if not len(surface.faces):
        problem = f"the mesh has {len(surface.vertices)} vertices but no faces"
        advice = "a point cloud must be triangulated first"
        return surface, [_defect(surface, "no-faces", 1, problem, advice=advice)]
    return surface, []


def _check_range(surface: Surface) -> Checked:
    """Refuse faces that name vertices which do not exist."""
    n = len(surface.vertices)
    outside = (surface.faces < 0) | (surface.faces >= n)
    if not outside.any():
        return surface, []
    bad = np.flatnonzero(outside.any(axis=1))
    verb = _plural(len(bad), "face names", "faces name")
    problem = f"{len(bad)} {verb} vertices outside 0 to {n - 1}, such as {surface.faces[outside][0]}"
    advice = "check whether numbering is one-based or the vertex list cut short; without these faces, {repair}"
    return surface, [_defect(surface, "index-out-of-range", len(bad), problem, faces=bad, advice=advice)]


def _check_unreferenced(surface: Surface) -> Checked:
    """Leave out vertices that no face uses: they have no area and would add a spurious eigenvalue each."""
    used = np.zeros(len(surface.vertices), dtype=bool)
    used[surface.faces.ravel()] = True
    if used.all():
        return surface, []
    bad = np.flatnonzero(~used)
    problem = f"{len(bad)} {_plural(len(bad), 'vertex is', 'vertices are')} in no face"
    action = "left out, without a match (-1 in the maps)"
    found = _defect(surface, "unreferenced-vertex", len(bad), problem, vertices=bad, action=action)
    return surface.keep(np.ones(len(surface.faces), dtype=bool)), [found]


def _check_finite(surface: Surface) -> Checked:
    """Refuse NaN and infinity on the surface."""
    bad = np.flatnonzero(~np.isfinite(surface.vertices).all(axis=1))
    if not len(bad):
        return surface, []
    problem = f"{len(bad)} {_plural(len(bad), 'vertex has', 'vertices have')} NaN or infinite coordinates"
    advice = "export the mesh again; without the faces there, {repair}"
    return surface, [_defect(surface, "non-finite", len(bad), problem, vertices=bad, advice=advice)]


def _check_magnitude(surface: Surface) -> Checked:
    """Refuse coordinates whose squares leave the range of float64."""
    size = np.abs(surface.vertices).max(axis=1)
    length = float(np.ptp(surface.vertices / max(float(size.max()), 1e-300), axis=0).max()) * float(size.max())
    bad = np.flatnonzero(size > MAX_COORDINATE)
    if len(bad):
        problem = f"coordinates up to {size.max():.3g} are too large to compute with (at most {MAX_COORDINATE:.0e})"
    elif 0 < length < 1 / MAX_COORDINATE:
        bad = np.arange(1)
        problem = f"the whole mesh is only {length:.3g} long, too small to compute with"
    else:
        return surface, []
    advice = "scale the coordinates, for example to a box of size 1, and export the mesh again"
    return surface, [_defect(surface, "coordinate-range", len(bad), problem, vertices=bad, advice=advice)]


def _check_repeated_corners(surface: Surface) -> Checked:
    """Leave out faces that are an edge or a point by their numbers; what they join stays joined without them."""
    a, b, c = surface.faces.T
    bad = (a == b) | (b == c) | (c == a)
    return _without_faces(surface, bad, "repeated-corner", "names the same vertex twice", "name the same vertex twice")


def _check_duplicate_faces(surface: Surface) -> Checked:
    """Leave out all but the first of the faces on the same three vertices."""
    bad = topology.duplicate_faces(surface.faces)
    return _without_faces(surface, bad, "duplicate-face", "repeats an earlier one", "repeat earlier ones")


def _without_faces(surface: Surface, bad: NDArray[np.bool_], kind: str, one: str, many: str) -> Checked:
    """Leave out the marked faces, and say how many vertices that leaves alone."""
    if not bad.any():
        return surface, []
    count = int(bad.sum())
    kept = surface.keep(~bad)
    lost = len(surface.vertices) - len(kept.vertices)
    problem = f"{count} {_plural(count, 'face ' + one, 'faces ' + many)}"
    action = "left out" + (f", and {lost} vertices that no other face has get no match (-1)" if lost else "")
    return kept, [_defect(surface, kind, count, problem, faces=np.flatnonzero(bad), action=action)]


def _check_area(surface: Surface) -> Checked:
    """Tolerate flat faces, but not a vertex without area: it would have no mass."""
    bare, flat = bare_vertices(surface)
    if not flat.any():
        return surface, []
    bad = np.flatnonzero(flat)
    if flat.all():
        problem = "all faces have zero area: the vertices lie on a line or at a point"
        advice = "export the mesh again with more digits"
        return surface, [_defect(surface, "no-area", len(bad), problem, faces=bad, advice=advice)]
    if bare.any():
        alone = np.flatnonzero(bare)
        verb = _plural(len(alone), "vertex has", "vertices have")
        problem = f"{len(alone)} {verb} only zero-area faces around"
        return surface, [
            _defect(surface, "no-area-vertex", len(alone), problem, vertices=alone, faces=bad, advice="{repair}")
        ]
    problem = f"{len(bad)} {_plural(len(bad), 'face has', 'faces have')} zero area"
    action = "kept, since the surface would have holes without them; cotangents are bounded there"
    return surface, [_defect(surface, "zero-area-face", len(bad), problem, faces=bad, action=action)]


def bare_vertices(surface: Surface) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Vertices (n) without area around them, and faces (m) without area."""
    inside, _, _ = topology.boxed(surface.vertices)
    corners = inside[surface.faces]
    longest = ((corners - np.roll(corners, 1, axis=1)) ** 2).sum(axis=2).max(axis=1)
    flat = topology.face_areas(inside, surface.faces) <= NO_AREA * longest
    around = topology.vertex_areas(inside, surface.faces)
    return around <= NO_AREA * around.mean(), flat


def _check_components(surface: Surface) -> Checked:
    """Keep one component: distances and eigenfunctions mean nothing across a gap."""
    count, component, areas = components_by_area(surface)
    if count == 1:
        return surface, []
    largest = int(np.argmax(areas))
    share = float(areas[largest] / areas.sum())
    vertex_component = np.zeros(len(surface.vertices), dtype=np.int64)
    vertex_component[surface.faces.ravel()] = np.repeat(component, 3)
    others = np.flatnonzero(vertex_component != largest)
    samples = others[np.unique(vertex_component[others], return_index=True)[1]]
    problem = f"the mesh has {count} separate pieces, the largest with {100 * share:.4g} % of the area"
    if 1 - share < SMALL_COMPONENTS:
        action = f"the largest is kept; {len(others)} vertices are left out, without a match (-1 in the maps)"
        return surface.keep(component == largest), [
            _defect(surface, "small-components", count, problem, vertices=samples, action=action)
        ]
    advice = "with the largest piece alone, {repair}"
    if len(topology.merge_positions(surface.vertices)[0]) < len(surface.vertices):
        advice += "; add `--merge` to join vertices at equal positions first"
    return surface, [_defect(surface, "components", count, problem, vertices=samples, advice=advice)]


def components_by_area(surface: Surface) -> tuple[int, NDArray[np.int64], NDArray[np.float64]]:
    """Count the components; that of every face (m), and the area of each in units of the bounding box."""
    count, label = topology.connected_components(surface.faces, len(surface.vertices))
    component = label[surface.faces[:, 0]]
    areas = topology.face_areas(topology.boxed(surface.vertices)[0], surface.faces)
    return count, component, np.bincount(component, weights=areas, minlength=count).astype(np.float64)


def _check_size(surface: Surface) -> Checked:
    """Refuse surfaces too small to have a spectrum."""
    n = len(surface.vertices)
    if n >= MIN_VERTICES:
        return surface, []
    problem = f"the surface has only {n} vertices; at least {MIN_VERTICES} are needed"
    return surface, [_defect(surface, "too-few-vertices", n, problem, advice="subdivide the mesh")]


def _check_manifold(surface: Surface) -> Checked:
    """Refuse edges with more than two faces, and vertices where sheets touch in a point."""
    table = topology.edge_table(surface.faces, len(surface.vertices))
    found = []
    crowded = table.face_count > 2
    ends = table.edges[crowded]
    if len(ends):
        problem = f"{len(ends)} {_plural(len(ends), 'edge belongs', 'edges belong')} to more than two faces"
        faces = np.unique(np.flatnonzero(crowded[table.edge_of_half_edge]) % len(surface.faces))
        found.append(
            _defect(
                surface,
                "non-manifold-edge",
                len(ends),
                problem,
                vertices=np.unique(ends),
                faces=faces,
                advice="{repair}",
            )
        )
    fans = topology.fan_counts(surface.faces, table, len(surface.vertices))
    # At the ends of a crowded edge the sheets fall apart in any case; only the edge is the finding there.
    fans[ends.ravel()] = 1
    bad = np.flatnonzero(fans > 1)
    if len(bad):
        problem = f"at {len(bad)} {_plural(len(bad), 'vertex', 'vertices')} several sheets touch in a point only"
        found.append(_defect(surface, "non-manifold-vertex", len(bad), problem, vertices=bad, advice="{repair}"))
    return surface, found


def _check_orientation(surface: Surface) -> Checked:
    """Flip the minority of faces so that neighbours agree; refuse one-sided surfaces."""
    table = topology.edge_table(surface.faces, len(surface.vertices))
    flip, twisted = topology.coherent_orientation(surface.faces, table, *topology.paired_half_edges(table))
    found = []
    if twisted.any():
        bad = np.flatnonzero(twisted)
        problem = f"the surface has only one side, like a Möbius strip or a Klein bottle ({len(bad)} faces)"
        advice = "cut open along a seam, {repair}"
        found.append(_defect(surface, "non-orientable", len(bad), problem, faces=bad, advice=advice))
    if flip.any():
        bad = np.flatnonzero(flip)
        problem = f"{len(bad)} {_plural(len(bad), 'face is', 'faces are')} turned against the others"
        found.append(_defect(surface, "orientation", len(bad), problem, faces=bad, action="turned round"))
        surface = replace(surface, faces=topology.flipped(surface.faces, flip))
    return surface, found


def _check_boundary(surface: Surface) -> Checked:
    """Mention boundaries, which are fine, and seams that look like boundaries but were meant to be closed."""
    edges = topology.boundary_edges(surface.faces, len(surface.vertices))
    if not len(edges):
        return surface, []
    rim = np.unique(edges)
    loops, _ = topology.edge_loops(edges)
    problem = f"the surface has {loops} {_plural(loops, 'boundary', 'boundaries')} with {len(edges)} edges"
    found = [_defect(surface, "boundary", loops, problem, vertices=rim)]
    first, merged = topology.merge_positions(surface.vertices[rim])
    shared = rim[np.bincount(merged, minlength=len(first))[merged] > 1]
    if len(shared):
        problem = f"{len(shared)} boundary vertices lie exactly on another one, as if the surface was cut along a seam"
        advice = "if the surface should be closed there, {repair} (add `--merge`)"
        found.append(
            _defect(surface, "open-seam", len(shared), problem, vertices=shared, action="kept apart", advice=advice)
        )
    return surface, found


def _check_outward(surface: Surface) -> Checked:
    """Flip a body that is inside out: the orientation is what tells a shape from its mirror image."""
    if topology.outward_sign(surface.vertices, surface.faces) >= 0:
        return surface, []
    found = _defect(surface, "inside-out", 1, "all faces point inward", action="turned outward")
    everything = np.ones(len(surface.faces), dtype=bool)
    return replace(surface, faces=topology.flipped(surface.faces, everything)), [found]


def _plural(count: int, one: str, many: str) -> str:
    return one if count == 1 else many


_VALUE_CHECKS: tuple[Callable[[Surface], Checked], ...] = (
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
_SURFACE_CHECKS: tuple[Callable[[Surface], Checked], ...] = (
    _check_components,
    _check_size,
    _check_manifold,
    _check_orientation,
    _check_boundary,
    _check_outward,
)
