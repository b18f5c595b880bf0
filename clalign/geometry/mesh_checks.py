"""What is wrong with a mesh, what the program does about it, and what is left to work with.

`diagnose` runs the checks in the order in which they make sense (a face index must be valid before its edges mean
anything), collects one `Defect` for each kind of finding, and carries along the surface with the harmless ones put right.
Loading and `clalign check` both go through it, so they cannot disagree. No native code sees a mesh that has not passed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clalign.errors import MeshError
from clalign.geometry import mesh_topology as topology

MIN_VERTICES = 12
"""Fewer vertices than an icosahedron has carry no eigenfunctions worth aligning."""
MAX_COORDINATE = 1e150
"""Squares of larger coordinates overflow float64, and squares of the inverse underflow."""
SMALL_PIECES = 0.01
"""Pieces beside the largest are left out if together they have less than this part of the area."""
NO_AREA = 1e-12
"""A face below this part of its squared longest side, or a vertex below this part of the mean, has no area."""
CAP_AREA = 0.1
"""Holes whose flat caps take less than this part of the area leave no doubt about which side is outside."""
_SHOWN = 5


class Severity(StrEnum):
    """How a finding affects the program."""

    REFUSED = "refused"
    HANDLED = "handled"
    FINE = "fine"


@dataclass(frozen=True)
class Defect:
    """One kind of finding in a mesh."""

    kind: str
    """Short name, stable for scripts: `non-manifold-edge`, `unreferenced-vertex`, ..."""
    severity: Severity
    count: int
    """How many vertices, edges, faces or pieces are concerned."""
    problem: str
    """What was found, with the count."""
    vertices: tuple[int, ...] = ()
    """The first offending vertices, numbered as in the file from 0."""
    faces: tuple[int, ...] = ()
    """The first offending triangles, numbered as in the file from 0."""
    action: str = ""
    """What the program does about it."""
    advice: str = ""
    """What the user can do about it; `{repair}` stands for the repair command."""

    def sentence(self) -> str:
        """Problem, place and action in one sentence."""
        places = [
            f"{word} {', '.join(map(str, numbers))}{', …' if len(numbers) < self.count else ''}"
            for word, numbers in (("vertex", self.vertices), ("face", self.faces))
            if numbers
        ]
        where = f" ({'; '.join(places)})" if places else ""
        return f"{self.problem}{where}" + (f": {self.action}" if self.action else "")


@dataclass(frozen=True)
class Surface:
    """The part of a mesh that is worked with, and where it came from."""

    vertices: NDArray[np.float64]
    """(n, 3) positions as given."""
    faces: NDArray[np.int64]
    """(m, 3) numbers of rows of `vertices`."""
    file_index: NDArray[np.int64]
    """(n,) the given number of every vertex."""
    face_index: NDArray[np.int64]
    """(m,) the given number of every face."""


@dataclass(frozen=True)
class Diagnosis:
    """All findings about one mesh."""

    n_vertices: int
    n_faces: int
    """Triangles; a file's larger polygons are cut into triangles before they are counted."""
    defects: tuple[Defect, ...]
    surface: Surface | None
    """What is left after the handled defects; None if the arrays cannot be understood as a surface at all."""
    components: int = 0
    boundary_loops: int = 0
    euler_characteristic: int = 0
    genus: int | None = None
    """Handles of the surface; None if it was refused."""

    @property
    def refused(self) -> tuple[Defect, ...]:
        """The defects that the method cannot work with."""
        return tuple(defect for defect in self.defects if defect.severity is Severity.REFUSED)

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences about everything that was put right."""
        return tuple(defect.sentence() for defect in self.defects if defect.severity is Severity.HANDLED)

    def usable_surface(self, file: str) -> Surface:
        """The surface, or a MeshError that names `file`, every reason and the way out."""
        refused = self.refused
        if self.surface is not None and not refused:
            return self.surface
        reasons = "; ".join(defect.sentence() for defect in refused)
        advice = "; ".join(dict.fromkeys(defect.advice for defect in refused if defect.advice))
        command = f"a repaired copy is written by `clalign check {file} --repair OUT`"
        raise MeshError(f"{file}: {reasons}. What helps: {advice.format(repair=command)}")


def diagnose(vertices: ArrayLike, faces: ArrayLike) -> Diagnosis:
    """Check a mesh and put right what is harmless.

    Parameters
    ----------
    vertices : (n, 3) float
    faces : (m, 3) int
        vertex numbers from 0.

    Returns
    -------
    Diagnosis

    Raises
    ------
    MeshError
        if the arrays do not have the shape of a triangle mesh.
    """
    points, triangles = mesh_arrays(vertices, faces)
    n_vertices, n_faces = len(points), len(triangles)
    surface = Surface(points, triangles, np.arange(n_vertices), np.arange(n_faces))
    defects: list[Defect] = []
    for check in _VALUE_CHECKS:
        surface, found = check(surface)
        defects += found
        if any(defect.severity is Severity.REFUSED for defect in found):
            return Diagnosis(n_vertices, n_faces, tuple(defects), None)
    for check in _SURFACE_CHECKS:
        surface, found = check(surface)
        defects += found
    if any(defect.severity is Severity.REFUSED for defect in defects):
        components, _ = topology.connected_components(surface.faces, len(surface.vertices))
        return Diagnosis(n_vertices, n_faces, tuple(defects), surface, components)
    loops = _boundary_loops(surface)[0]
    euler = len(surface.vertices) - len(topology.unique_edges(surface.faces)) + len(surface.faces)
    return Diagnosis(n_vertices, n_faces, tuple(defects), surface, 1, loops, euler, (2 - loops - euler) // 2)


def mesh_arrays(vertices: ArrayLike, faces: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Copy two array-likes into (n, 3) float64 and (m, 3) int64; MeshError if they have another shape or kind."""
    points, triangles = np.asarray(vertices), np.asarray(faces)
    for name, values, kinds in (("vertices", points, "iuf"), ("faces", triangles, "iuf")):
        if values.size and (values.ndim != 2 or values.shape[1] != 3 or values.dtype.kind not in kinds):
            raise MeshError(
                f"{name} must be an array of rows of three numbers, not of shape {values.shape} and type {values.dtype}; "
                "polygons with more corners must be cut into triangles first"
            )
    if triangles.dtype.kind in "uf":
        in_range = np.abs(triangles.astype(np.float64)) < 2.0**62
        if triangles.dtype.kind == "f" and not (in_range & (triangles == np.floor(triangles))).all():
            raise MeshError("faces must contain whole numbers; pass vertex numbers counted from 0")
        triangles = np.where(in_range, triangles, -1)
    return points.reshape(-1, 3).astype(np.float64), triangles.reshape(-1, 3).astype(np.int64)


Checked = tuple[Surface, list[Defect]]


def _check_empty(surface: Surface) -> Checked:
    if not len(surface.vertices):
        return surface, [
            Defect("no-vertices", Severity.REFUSED, 1, "the mesh has no vertices", advice="export it again")
        ]
    if not len(surface.faces):
        problem = f"the mesh has {len(surface.vertices)} vertices but no faces"
        advice = "a point cloud must be triangulated first"
        return surface, [Defect("no-faces", Severity.REFUSED, 1, problem, advice=advice)]
    return surface, []


def _check_range(surface: Surface) -> Checked:
    n = len(surface.vertices)
    outside = (surface.faces < 0) | (surface.faces >= n)
    if not outside.any():
        return surface, []
    bad = np.flatnonzero(outside.any(axis=1))
    problem = f"{_faces(len(bad))} with vertex numbers outside 0 to {n - 1} (such as {surface.faces[outside][0]})"
    advice = "is the numbering one-based or the vertex list cut short? Without these faces, {repair}"
    return surface, [
        Defect("index-out-of-range", Severity.REFUSED, len(bad), problem, faces=_first(bad), advice=advice)
    ]


def _check_unreferenced(surface: Surface) -> Checked:
    used = np.zeros(len(surface.vertices), dtype=bool)
    used[surface.faces.ravel()] = True
    if used.all():
        return surface, []
    bad = np.flatnonzero(~used)
    action = "left out; they have no match (-1 in the maps)"
    problem = f"{len(bad)} {'vertex is' if len(bad) == 1 else 'vertices are'} in no face"
    found = Defect("unreferenced-vertex", Severity.HANDLED, len(bad), problem, _first(bad), action=action)
    return keep_faces(surface, np.ones(len(surface.faces), dtype=bool)), [found]


def _check_finite(surface: Surface) -> Checked:
    bad = np.flatnonzero(~np.isfinite(surface.vertices).all(axis=1))
    if not len(bad):
        return surface, []
    problem = f"{len(bad)} {_plural(len(bad), 'vertex has', 'vertices have')} NaN or infinite coordinates"
    numbers = _first(surface.file_index[bad])
    advice = "export the mesh again; without the faces there, {repair}"
    return surface, [Defect("non-finite", Severity.REFUSED, len(bad), problem, numbers, advice=advice)]


def _check_magnitude(surface: Surface) -> Checked:
    size = np.abs(surface.vertices).max(axis=1)
    _, middle, extent = topology.boxed(surface.vertices)
    advice = "scale the coordinates, for example to a box of size 1"
    if size.max() > MAX_COORDINATE:
        bad = np.flatnonzero(size > MAX_COORDINATE)
        problem = f"coordinates up to {size.max():.3g} are too large to compute with (at most {MAX_COORDINATE:.0e})"
        numbers = _first(surface.file_index[bad])
        return surface, [Defect("coordinate-range", Severity.REFUSED, len(bad), problem, numbers, advice=advice)]
    if extent < 1 / MAX_COORDINATE:
        problem = f"the whole mesh is only {2 * extent:.3g} long, too small to compute with"
        return surface, [Defect("coordinate-range", Severity.REFUSED, 1, problem, advice=advice)]
    return surface, []


def _check_repeated_corners(surface: Surface) -> Checked:
    a, b, c = surface.faces.T
    bad = (a == b) | (b == c) | (c == a)
    return _without_faces(surface, bad, "repeated-corner", "names the same vertex twice", "name the same vertex twice")


def _check_duplicate_faces(surface: Surface) -> Checked:
    bad = duplicate_faces(surface.faces)
    return _without_faces(surface, bad, "duplicate-face", "repeats an earlier one", "repeat earlier ones")


def _check_area(surface: Surface) -> Checked:
    inside, _, _ = topology.boxed(surface.vertices)
    corners = inside[surface.faces]
    longest = ((corners - np.roll(corners, 1, axis=1)) ** 2).sum(axis=2).max(axis=1)
    areas = topology.face_areas(inside, surface.faces)
    flat = np.flatnonzero(areas <= NO_AREA * longest)
    if len(flat) == len(areas):
        problem = "all faces have zero area: the vertices lie on a line or at a point"
        return surface, [Defect("no-area", Severity.REFUSED, len(flat), problem, advice="export the mesh again")]
    if not len(flat):
        return surface, []
    around = topology.vertex_areas(inside, surface.faces)
    bare = np.flatnonzero(around <= NO_AREA * around.mean())
    if len(bare):
        problem = f"{len(bare)} {_plural(len(bare), 'vertex has', 'vertices have')} only zero-area faces around"
        numbers = _first(surface.file_index[bare]), _first(surface.face_index[flat])
        return surface, [Defect("no-area-vertex", Severity.REFUSED, len(bare), problem, *numbers, advice="{repair}")]
    problem = f"{_faces(len(flat))} with zero area"
    action = "kept, since the surface would have holes without them; cotangents there are bounded"
    numbers = _first(surface.face_index[flat])
    return surface, [Defect("zero-area-face", Severity.HANDLED, len(flat), problem, faces=numbers, action=action)]


def _check_components(surface: Surface) -> Checked:
    count, label = topology.connected_components(surface.faces, len(surface.vertices))
    if count == 1:
        return surface, []
    piece_of_face = label[surface.faces[:, 0]]
    inside, _, _ = topology.boxed(surface.vertices)
    areas = np.bincount(piece_of_face, weights=topology.face_areas(inside, surface.faces), minlength=count)
    largest = int(np.argmax(areas))
    share = float(areas[largest] / areas.sum())
    others = np.flatnonzero(label != largest)
    numbers = _first(surface.file_index[others[np.unique(label[others], return_index=True)[1]]])
    problem = f"the mesh has {count} separate pieces, the largest with {100 * share:.3g} % of the area"
    if 1 - share < SMALL_PIECES:
        action = f"the largest is kept; {len(others)} vertices are left out and have no match (-1 in the maps)"
        found = Defect("small-components", Severity.HANDLED, count, problem, numbers, action=action)
        return keep_faces(surface, piece_of_face == largest), [found]
    advice = "with the largest piece alone, {repair}"
    if len(topology.merge_positions(surface.vertices)[0]) < len(surface.vertices):
        advice += "; vertices at equal positions are joined there by `--merge`"
    return surface, [Defect("components", Severity.REFUSED, count, problem, numbers, advice=advice)]


def _check_size(surface: Surface) -> Checked:
    n = len(surface.vertices)
    if n >= MIN_VERTICES:
        return surface, []
    problem = f"the surface has only {n} vertices; at least {MIN_VERTICES} are needed"
    return surface, [Defect("too-few-vertices", Severity.REFUSED, n, problem, advice="subdivide the mesh")]


def _check_manifold(surface: Surface) -> Checked:
    table = topology.edge_table(surface.faces, len(surface.vertices))
    found = []
    crowded = table.face_count > 2
    ends = table.edges[crowded]
    if len(ends):
        problem = f"{len(ends)} {_plural(len(ends), 'edge belongs', 'edges belong')} to more than two faces"
        faces = np.flatnonzero(crowded[table.edge_of_half_edge]) % len(surface.faces)
        numbers = _first(surface.file_index[ends.ravel()]), _first(surface.face_index[np.unique(faces)])
        found.append(Defect("non-manifold-edge", Severity.REFUSED, len(ends), problem, *numbers, advice="{repair}"))
    count, fan = topology.corner_fans(surface.faces, *topology.paired_half_edges(table))
    vertex_of_fan = np.zeros(count, dtype=np.int64)
    vertex_of_fan[fan.ravel()] = surface.faces.ravel()
    fans = np.bincount(vertex_of_fan, minlength=len(surface.vertices))
    fans[ends.ravel()] = 1
    pinched = np.flatnonzero(fans > 1)
    if len(pinched):
        problem = f"at {len(pinched)} {_plural(len(pinched), 'vertex', 'vertices')} several sheets touch in a point"
        numbers = _first(surface.file_index[pinched])
        found.append(Defect("non-manifold-vertex", Severity.REFUSED, len(pinched), problem, numbers, advice="{repair}"))
    return surface, found


def _check_orientation(surface: Surface) -> Checked:
    table = topology.edge_table(surface.faces, len(surface.vertices))
    one, other = topology.paired_half_edges(table)
    turn, twisted = topology.coherent_orientation(len(surface.faces), one, other, table.forward)
    found = []
    if twisted.any():
        problem = "the surface has only one side, like a Möbius strip"
        faces = _first(surface.face_index[np.flatnonzero(twisted)])
        advice = "cut open along a seam, {repair}"
        found.append(Defect("non-orientable", Severity.REFUSED, int(twisted.sum()), problem, (), faces, advice=advice))
    if turn.any():
        bad = np.flatnonzero(turn)
        problem = f"{_faces(len(bad))} turned against the neighbours"
        action = "turned round"
        numbers = _first(surface.face_index[bad])
        found.append(Defect("orientation", Severity.HANDLED, len(bad), problem, faces=numbers, action=action))
        surface = replace(surface, faces=turned(surface.faces, turn))
    return surface, found


def _check_outward(surface: Surface) -> Checked:
    found = []
    loops, label, edges = _boundary_loops(surface)
    if loops:
        problem = f"the surface has {loops} {_plural(loops, 'boundary', 'boundaries')} ({len(edges)} edges)"
        found.append(
            Defect("boundary", Severity.FINE, loops, problem, _first(surface.file_index[np.sort(edges[:, 0])]))
        )
        first, merged = topology.merge_positions(surface.vertices)
        shared = np.flatnonzero(np.bincount(merged, minlength=len(first))[merged] > 1)
        if len(shared):
            problem = f"{len(shared)} vertices lie at the position of another one"
            action = "kept apart; if the surface should be closed there, `clalign check FILE --repair OUT --merge` joins them"
            numbers = _first(surface.file_index[shared])
            found.append(Defect("coincident-vertices", Severity.FINE, len(shared), problem, numbers, action=action))
    if outward_sign(surface.vertices, surface.faces) < 0:
        action = "all faces turned outward"
        found.append(Defect("inside-out", Severity.HANDLED, 1, "the faces point into the body", action=action))
        surface = replace(surface, faces=turned(surface.faces, np.ones(len(surface.faces), dtype=bool)))
    return surface, found


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
    _check_outward,
)


def outward_sign(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> int:
    """+1 if the faces of an oriented surface point outward, -1 if inward, 0 if a boundary leaves it open.

    Small holes are closed with flat caps, so that a body with a missing patch still has an inside.
    """
    inside, _, _ = topology.boxed(vertices)
    edges = topology.boundary_edges(faces, len(vertices))
    volume = topology.signed_volume(inside, faces)
    if len(edges):
        count, label = _loops(edges)
        tips = np.stack([np.bincount(label, weights=inside[edges[:, 0], axis]) for axis in range(3)], axis=1)
        tips /= np.bincount(label, minlength=count)[:, None]
        caps = np.stack([inside[edges[:, 1]], inside[edges[:, 0]], tips[label]], axis=1).reshape(-1, 3)
        cap_faces = np.arange(len(caps)).reshape(-1, 3)
        if topology.face_areas(caps, cap_faces).sum() > CAP_AREA * topology.face_areas(inside, faces).sum():
            return 0
        volume += topology.signed_volume(caps, cap_faces)
    return int(np.sign(volume))


def turned(faces: NDArray[np.int64], turn: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Copy of `faces` (m, 3) with the marked ones reversed."""
    return np.where(turn[:, None], faces[:, [0, 2, 1]], faces)


def duplicate_faces(faces: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(m,) True for every face on the same three vertices as an earlier one, in whatever order."""
    corners = np.sort(faces, axis=1)
    order = np.lexsort((np.arange(len(faces)), corners[:, 2], corners[:, 1], corners[:, 0]))
    repeated = (np.diff(corners[order], axis=0) == 0).all(axis=1)
    bad = np.zeros(len(faces), dtype=bool)
    bad[order[1:][repeated]] = True
    return bad


def keep_faces(surface: Surface, keep: NDArray[np.bool_]) -> Surface:
    """The marked faces with the vertices that they use."""
    faces = surface.faces[keep]
    used = np.zeros(len(surface.vertices), dtype=bool)
    used[faces.ravel()] = True
    place = np.cumsum(used) - 1
    return Surface(surface.vertices[used], place[faces], surface.file_index[used], surface.face_index[keep])


def _without_faces(surface: Surface, bad: NDArray[np.bool_], kind: str, one: str, many: str) -> Checked:
    if not bad.any():
        return surface, []
    count = int(bad.sum())
    kept = keep_faces(surface, ~bad)
    lost = len(surface.vertices) - len(kept.vertices)
    action = "left out" + (
        f", and with {_plural(count, 'it', 'them')} {lost} vertices that no other face has" if lost else ""
    )
    numbers = _first(surface.face_index[bad])
    problem = f"{count} {_plural(count, 'face ' + one, 'faces ' + many)}"
    return kept, [Defect(kind, Severity.HANDLED, count, problem, faces=numbers, action=action)]


def _boundary_loops(surface: Surface) -> tuple[int, NDArray[np.int64], NDArray[np.int64]]:
    """Number of boundary loops, the loop of every boundary edge, and the directed edges (b, 2)."""
    edges = topology.boundary_edges(surface.faces, len(surface.vertices))
    count, label = _loops(edges)
    return count, label, edges


def _loops(edges: NDArray[np.int64]) -> tuple[int, NDArray[np.int64]]:
    """Number of connected pieces of an edge list (b, 2), and the piece of every edge."""
    numbers, compact = np.unique(edges, return_inverse=True)
    compact = compact.reshape(-1, 2)
    count, label = topology.graph_pieces(len(numbers), compact[:, 0], compact[:, 1])
    return count, label[compact[:, 0]]


def _first(numbers: NDArray[np.integer]) -> tuple[int, ...]:
    return tuple(int(number) for number in numbers[:_SHOWN])


def _plural(count: int, one: str, many: str) -> str:
    return one if count == 1 else many


def _faces(count: int) -> str:
    return f"{count} {_plural(count, 'face is', 'faces are')}"
