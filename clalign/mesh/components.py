"""Several pieces in one mesh: which one is matched, which go along with it, and which are left out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clalign.mesh import topology
from clalign.mesh.defects import Surface
from clalign.mesh.examination import Examination, plural
from clalign.mesh.topology import BoolArray, IntArray
from clalign.mesh.welding import duplicate_places

LEFT_OUT = 0.01
"""Read strictly, pieces beside the largest are left out if together they have less than this part of the area."""
SIMILAR = 0.5
"""A piece with more than this part of the largest one's area may be what is meant as well as the largest."""
SMALLEST_PIECE = 20
"""Pieces with fewer vertices are left out: they hardly say where they belong."""
NAMED = 6
"""How many pieces a message describes."""


def components_by_area(surface: Surface) -> tuple[int, NDArray[np.int64], NDArray[np.float64]]:
    """Count the components; that of every face (m), and the area of each in units of the bounding box."""
    count, label = topology.connected_components(surface.faces, len(surface.vertices))
    component = label[surface.faces[:, 0]]
    areas = topology.face_areas(topology.boxed(surface.vertices)[0], surface.faces)
    return count, component, np.bincount(component, weights=areas, minlength=count).astype(np.float64)


def check_components(exam: Examination) -> None:
    """Keep one component: distances and eigenfunctions mean nothing across a gap."""
    count, component, areas = components_by_area(exam.surface)
    if exam.component is not None and not 1 <= exam.component <= count:
        problem = f"there is no piece {exam.component}: the mesh has {count} {plural(count, 'piece', 'pieces')}"
        exam.add("components", count, problem, advice=f"choose a piece from 1, the largest, to {count}")
        return
    if count == 1:
        return
    ranked = np.argsort(-areas, kind="stable")
    place_of = np.empty(count, dtype=np.int64)
    place_of[ranked] = np.arange(count)
    rank_of_face = place_of[component]
    if exam.strict:
        _check_strictly(exam, rank_of_face, areas[ranked])
        return
    chosen = 0 if exam.component is None else exam.component - 1
    rivals = _rivals(exam.surface, rank_of_face, areas[ranked], chosen)
    if exam.component is None and rivals.any():
        similar = 1 + int(rivals.sum())
        problem = (
            f"the mesh has {count} separate pieces, {similar} of them of similar size: "
            f"{_described(exam.surface, rank_of_face, areas[ranked], 1 + int(np.flatnonzero(rivals).max()))}"
        )
        advice = "say which is meant with `--component 1`, 2, … (in Python: `clalign.load_mesh(path, component=1)`)"
        samples = np.unique(_rank_of_vertex(exam.surface, rank_of_face), return_index=True)[1]
        exam.add("components", count, problem, vertices=samples, advice=advice)
        return
    _keep(exam, rank_of_face, areas[ranked], chosen, rivals)


def _rivals(surface: Surface, rank_of_face: IntArray, areas: NDArray[np.float64], chosen: int) -> BoolArray:
    """(count,) True for pieces that may be meant as well: of similar size, and without a common vertex in the file."""
    rank = _rank_of_vertex(surface, rank_of_face)
    attached = np.zeros(len(areas), dtype=bool)
    attached[rank[np.isin(surface.file_index, surface.file_index[rank == chosen])]] = True
    return (areas > SIMILAR * areas[chosen]) & ~attached


def _check_strictly(exam: Examination, rank_of_face: IntArray, areas: NDArray[np.float64]) -> None:
    """Refuse what is not one piece but for some dust."""
    surface, count = exam.surface, len(areas)
    chosen = 0 if exam.component is None else exam.component - 1
    rank = _rank_of_vertex(surface, rank_of_face)
    others = np.flatnonzero(rank != chosen)
    samples = others[np.unique(rank[others], return_index=True)[1]]
    share = float(areas[chosen] / areas.sum())
    problem = f"the mesh has {count} separate pieces, the largest with {100 * areas[0] / areas.sum():.4g} % of the area"
    if 1 - share < LEFT_OUT or exam.component is not None:
        which = "the largest is kept" if exam.component is None else f"piece {exam.component} is kept"
        action = f"{which}; {len(others)} vertices are left out, without a match (-1 in the maps)"
        exam.add("small-components", count, problem, vertices=samples, action=action)
        exam.surface = surface.keep(rank_of_face == chosen)
        return
    advice = "with the largest piece alone, {repair}"
    if duplicate_places(surface.vertices):
        advice += "; add `--merge` to join vertices at equal positions first"
    exam.add("components", count, problem, vertices=samples, advice=advice)


def _keep(
    exam: Examination, rank_of_face: IntArray, areas: NDArray[np.float64], chosen: int, rivals: BoolArray
) -> None:
    """Go on with one piece; larger ones beside it are carried along with it, smaller ones and rivals are left out."""
    surface = exam.surface
    rank = _rank_of_vertex(surface, rank_of_face)
    kept = surface.keep(rank_of_face == chosen)
    # A given vertex with a copy on the chosen piece is matched there, whatever else it is part of.
    on_surface = kept.vertex_of_file() >= 0
    sizes = np.bincount(rank, minlength=len(areas))
    carried = (sizes >= SMALLEST_PIECE) & ~rivals
    carried[chosen] = False
    vertex_of_file = surface.vertex_of_file()
    off = np.flatnonzero((vertex_of_file >= 0) & ~on_surface)
    ranks = rank[vertex_of_file[off]]
    loose = off[carried[ranks]]
    places = vertex_of_file[loose]
    numbers = np.unique(rank[places], return_inverse=True)[1].reshape(-1)
    faces = surface.file_index[surface.faces[carried[rank_of_face]]]
    exam.loose = exam.loose.with_more(loose, surface.vertices[places], numbers.astype(np.int64), faces)
    samples = np.unique(rank, return_index=True)[1][1:]
    problem = f"the mesh has {len(areas)} separate pieces: {_described(surface, rank_of_face, areas, NAMED)}"
    which = f"piece {chosen + 1} is matched, as asked for" if chosen else "the largest is matched"
    left = len(off) - len(loose)
    parts = [which]
    if exam.alone:
        parts = [f"piece {chosen + 1} alone is kept"]
    if exam.alone or exam.cloud is not None:
        # Points of a cloud get their matches later, from the surface near them.
        loose, left = loose[:0], 0
    if len(loose):
        parts.append(f"{len(loose)} vertices of other pieces are carried along with it")
    if left:
        parts.append(f"{left} {plural(left, 'vertex is', 'vertices are')} left out, without a match (-1 in the maps)")
    exam.add("small-components", len(areas), problem, vertices=samples, action="; ".join(parts))
    exam.surface = kept
    exam.component = 1


def _rank_of_vertex(surface: Surface, rank_of_face: IntArray) -> IntArray:
    rank = np.zeros(len(surface.vertices), dtype=np.int64)
    rank[surface.faces.ravel()] = np.repeat(rank_of_face, 3)
    return rank


def _described(surface: Surface, rank_of_face: IntArray, areas: NDArray[np.float64], most: int) -> str:
    """Number, size and place of the largest pieces, by area."""
    rank = _rank_of_vertex(surface, rank_of_face)
    words = []
    # Places are told to a thousandth of the box.
    step = 10.0 ** (np.floor(np.log10(max(float(np.ptp(surface.vertices, axis=0).max()), 1e-300))) - 3)
    for number in range(min(most, NAMED, len(areas))):
        mine = surface.vertices[rank == number]
        middle = 0.5 * mine.min(axis=0) + 0.5 * mine.max(axis=0)
        place = ", ".join(f"{value:.4g}" for value in np.round(middle / step) * step + 0.0)
        share = f"{100 * areas[number] / areas.sum():.3g} % of the area"
        words.append(f"piece {number + 1} with {len(mine):,} vertices and {share} around ({place})")
    return "; ".join(words) + ("; …" if len(areas) > len(words) else "")
