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
from scipy.spatial import cKDTree

from clalign.errors import MeshError
from clalign.mesh import topology
from clalign.mesh.cloud import surface_of_points
from clalign.mesh.components import check_components
from clalign.mesh.defects import SHOWN, Defect, Diagnosis, LoosePieces, Severity, Surface
from clalign.mesh.examination import Examination, plural
from clalign.mesh.surface_checks import (
    MIN_VERTICES,
    check_boundary,
    check_manifold,
    check_orientation,
    check_outward,
    check_size,
    close_seams,
)
from clalign.mesh.welding import joined, neighbours_of_bare

MAX_COORDINATE = 1e150
"""Squares of larger coordinates overflow float64, and squares of the inverse underflow."""
_ROUNDS = 3
BESIDE = 5.0
"""Points of a cloud farther from its surface than so many mean edges are left out."""
NO_AREA = 1e-12
"""A face below this part of its squared longest side, or a vertex below this part of the mean, has no area."""
HARDLY_ANY_AREA = 1e-7
"""Below this part of the squared longest sides the area of all faces together is lost in rounding."""
FAR_AWAY = 1e-6
"""A few vertices are far away if half of all lie this near each other, as a part of the farthest distance."""


def diagnose(
    vertices: ArrayLike,
    faces: ArrayLike,
    name: str = "mesh",
    *,
    strict: bool = False,
    component: int | None = None,
    normals: NDArray[np.float64] | None = None,
) -> Diagnosis:
    """Check a mesh, vertices (n, 3) and faces (m, 3) from 0, and read it as a surface; without faces as a cloud.

    strict : refuse what is no surface as it stands; otherwise it is put right as it was most likely meant.
    component : number of the piece to keep, from 1 for the largest; None for the largest if it stands out.
    normals : (n, 3) of a cloud, which say where the front of an open sheet is; None if they are not known.

    Raises
    ------
    MeshError
        The arrays do not have the shape of a triangle mesh; the message calls it `name`.
    """
    surface = Surface.whole(*mesh_arrays(vertices, faces, name))
    if normals is not None and np.shape(normals) != surface.vertices.shape:
        raise MeshError(f"{name}: normals have shape {np.shape(normals)}; expected {surface.vertices.shape}")
    return examined(Examination(surface, strict=strict, component=component, normals=normals))


def examined(exam: Examination) -> Diagnosis:
    """Check the surface of an examination that has just begun; see `diagnose`."""
    counts = len(exam.surface.joined_to), len(exam.surface.faces)
    for check in _VALUE_CHECKS:
        check(exam)
        if exam.refused:
            return Diagnosis(*counts, tuple(exam.defects), None)
    if exam.strict:
        for check in _STRICT_CHECKS:
            check(exam)
    else:
        _put_right(exam)
    surface, n = exam.surface, len(exam.surface.vertices)
    if exam.refused:
        components, _ = topology.connected_components(surface.faces, n)
        return Diagnosis(*counts, tuple(exam.defects), surface, components)
    loops, _ = topology.edge_loops(topology.boundary_edges(surface.faces, n))
    euler = n - len(topology.edge_table(surface.faces, n).edges) + len(surface.faces)
    genus = (2 - loops - euler) // 2
    return Diagnosis(*counts, tuple(exam.defects), surface, 1, loops, euler, genus, exam.loose)


def _put_right(exam: Examination) -> None:
    """Check the surface, each time with what the last check has mended, until a refusal."""
    for _ in range(_ROUNDS):
        for check in _SURFACE_CHECKS:
            check(exam)
            if exam.refused:
                return
        # What was parted or left out can leave a vertex without the area that it had.
        if not bare_vertices(exam.surface)[0].any():
            break
        _check_area(exam)
        if exam.refused:
            return
    bare = bare_vertices(exam.surface)[0]
    if bare.any():
        problem = f"{int(bare.sum())} vertices are without area again whenever others are mended"
        exam.add("no-area", int(bare.sum()), problem, vertices=np.flatnonzero(bare), advice="remesh it")
        return
    for check in _LAST_CHECKS:
        check(exam)
    _attach_points(exam)


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


def _check_cloud(exam: Examination) -> None:
    """Lay a surface through points without faces."""
    surface = exam.surface
    sound = np.flatnonzero((np.abs(surface.vertices) <= MAX_COORDINATE).all(axis=1))
    if exam.strict or len(surface.faces) or len(sound) < MIN_VERTICES:
        return
    normals = None if exam.normals is None else exam.normals[sound]
    faces = sound[surface_of_points(surface.vertices[sound], normals)]
    if len(faces):
        problem = f"the {len(surface.vertices):,} points have no faces"
        exam.add("no-faces", 1, problem, action=f"a surface of {len(faces):,} triangles was laid through them")
        exam.surface = replace(surface, faces=faces, face_index=np.arange(len(faces)))
        exam.cloud = exam.surface
        # The triangles are turned one way; where they close to one side they touch and are no surface.
        exam.cut_open = True


def _attach_points(exam: Examination) -> None:
    """Give points of a cloud that are on no face, but near the surface, the match of the nearest one that is."""
    surface, cloud = exam.surface, exam.cloud
    if cloud is None:
        return
    edge = float(topology.side_lengths(surface.vertices, surface.faces).mean())
    off = np.flatnonzero((surface.vertex_of_file() < 0) & np.isfinite(cloud.vertices).all(axis=1))
    distance, nearest = cKDTree(surface.vertices).query(cloud.vertices[off])
    near = distance <= BESIDE * edge
    joined_to = surface.joined_to.copy()
    joined_to[off[near]] = surface.file_index[nearest[near]]
    exam.surface = replace(surface, joined_to=joined_to)
    exam.loose = LoosePieces.none()
    if near.any():
        problem = f"{int(near.sum()):,} points lie beside that surface"
        numbers = tuple(off[near][:SHOWN].tolist())
        action = "each has the match of the nearest point on it"
        exam.defects.append(Defect("point-beside", Severity.HANDLED, int(near.sum()), problem, numbers, (), action))


def _check_range(exam: Examination) -> None:
    """Refuse faces that name vertices which do not exist."""
    faces, n = exam.surface.faces, len(exam.surface.vertices)
    outside = (faces < 0) | (faces >= n)
    bad = np.flatnonzero(outside.any(axis=1))
    if len(bad):
        verb = plural(len(bad), "face names", "faces name")
        problem = f"{len(bad)} {verb} vertices outside 0 to {n - 1}, such as {faces[outside][0]}"
        advice = "check whether numbering is one-based or the vertex list cut short; without these faces, {repair}"
        exam.add("index-out-of-range", len(bad), problem, faces=bad, advice=advice)


def _check_unreferenced(exam: Examination) -> None:
    """Leave out vertices that no face uses: they have no area and would add a spurious eigenvalue each."""
    surface = exam.surface
    bad = np.setdiff1d(np.arange(len(surface.vertices)), surface.faces)
    if len(bad):
        problem = f"{len(bad)} {plural(len(bad), 'vertex is', 'vertices are')} in no face"
        action = "left out, without a match (-1 in the maps)" if exam.cloud is None else "not part of it"
        exam.add("unreferenced-vertex", len(bad), problem, vertices=bad, action=action)
        exam.surface = surface.keep(np.ones(len(surface.faces), dtype=bool))


def _check_finite(exam: Examination) -> None:
    """Refuse NaN and infinity on the surface."""
    bad = np.flatnonzero(~np.isfinite(exam.surface.vertices).all(axis=1))
    if len(bad):
        problem = f"{len(bad)} {plural(len(bad), 'vertex has', 'vertices have')} NaN or infinite coordinates"
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
    bad = topology.repeated_corners(exam.surface.faces)
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
    problem = f"{count} {plural(count, 'face ' + one, 'faces ' + many)}"
    action = "left out" + (f", and {lost} vertices that no other face has get no match (-1)" if lost else "")
    exam.add(kind, count, problem, faces=np.flatnonzero(bad), action=action)
    exam.surface = kept


def _check_area(exam: Examination) -> None:
    """Tolerate flat faces, but not a vertex without area: it would have no mass."""
    if _hardly_any_area(exam.surface):
        _refuse_for_area(exam)
        return
    bare, flat = bare_vertices(exam.surface)
    alone, bad = np.flatnonzero(bare), np.flatnonzero(flat)
    if not len(bad):
        return
    if len(alone):
        problem = f"{len(alone)} {plural(len(alone), 'vertex has', 'vertices have')} only zero-area faces around"
        one, many = "joined to its nearest neighbour", "joined to their nearest neighbours"
        action = "" if exam.strict else f"{plural(len(alone), one, many)}, to share one match"
        advice = "{repair}" if exam.strict else ""
        exam.add("no-area-vertex", len(alone), problem, vertices=alone, faces=bad, action=action, advice=advice)
        if not exam.strict:
            _collapse(exam, bare)
    else:
        problem = f"{len(bad)} {plural(len(bad), 'face has', 'faces have')} zero area"
        action = "kept, since the surface would have holes without them; cotangents are bounded there"
        exam.add("zero-area-face", len(bad), problem, faces=bad, action=action)


def _hardly_any_area(surface: Surface) -> bool:
    """Whether the faces together are too thin for their length."""
    area, longest = _measured(surface)
    return bool(area.sum() <= HARDLY_ANY_AREA * longest.sum())


def _measured(surface: Surface) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Area and squared longest side of the faces (m,), in units of the box."""
    inside, _, _ = topology.boxed(surface.vertices)
    corners = inside[surface.faces]
    longest = ((corners - np.roll(corners, 1, axis=1)) ** 2).sum(axis=2).max(axis=1)
    return topology.face_areas(inside, surface.faces), longest


def _refuse_for_area(exam: Examination) -> None:
    """Refuse a surface without area; mostly a few vertices lie so far away that the rest is a point beside them."""
    inside, _, _ = topology.boxed(exam.surface.vertices)
    away = np.linalg.norm(inside - np.median(inside, axis=0), axis=1)
    if np.median(away) < FAR_AWAY * away.max():
        far = np.flatnonzero(away > np.sqrt(FAR_AWAY) * away.max())
        count = len(far)
        lie = plural(count, "vertex lies", "vertices lie")
        problem = f"{count} {lie} so far away that the rest has no area beside {plural(count, 'it', 'them')}"
        exam.add("no-area", count, problem, vertices=far, advice="mend their coordinates, or remove their faces")
        return
    problem = "all faces have zero area: the vertices lie on a line or at a point"
    bad = np.arange(len(exam.surface.faces))
    exam.add("no-area", len(bad), problem, faces=bad, advice="export the mesh again with more digits")


def _collapse(exam: Examination, bare: NDArray[np.bool_]) -> None:
    """Join vertices without area to their neighbours, and leave out the faces that this or nothing can mend."""
    surface = joined(exam.surface, neighbours_of_bare(exam.surface, bare))
    surface = surface.keep(~topology.repeated_corners(surface.faces))
    surface = surface.keep(~topology.duplicate_faces(surface.faces))
    if len(surface.faces):
        still_bare: NDArray[np.bool_] = np.any(bare_vertices(surface)[0][surface.faces], axis=1)
        surface = surface.keep(~still_bare)
    exam.surface = surface


def bare_vertices(surface: Surface) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Vertices (n) without area around them, and faces (m) without area."""
    area, longest = _measured(surface)
    around = np.bincount(surface.faces.ravel(), weights=np.repeat(area / 3.0, 3), minlength=len(surface.vertices))
    return around <= NO_AREA * around.mean(), area <= NO_AREA * longest


_VALUE_CHECKS = (
    _check_cloud,
    _check_empty,
    _check_range,
    _check_unreferenced,
    _check_finite,
    _check_magnitude,
    _check_repeated_corners,
    _check_duplicate_faces,
    close_seams,
    _check_repeated_corners,
    _check_duplicate_faces,
    _check_empty,
    _check_area,
    _check_empty,
)
# Pieces of a strictly read mesh are counted as they are, those of another after its sheets were parted.
_STRICT_CHECKS = (check_components, check_size, check_manifold, check_orientation, check_boundary, check_outward)
_SURFACE_CHECKS = (check_manifold, check_orientation, check_components, check_size)
_LAST_CHECKS = (check_boundary, check_outward)
