"""A map to start from instead of a search: one that a user has, or the one that shapes show as they lie in space."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from clalign.correspondence import FORWARD_FILE, Correspondence
from clalign.engine.backend import Backend
from clalign.errors import InputError
from clalign.geometry.shape import Shape
from clalign.maps.functional_maps import MatchedRows, functional_map, told_apart
from clalign.maps.nearest import nearest_rows
from clalign.maps.point_maps import check_map, read_map
from clalign.mesh.mesh import Mesh
from clalign.mesh.topology import vertex_normals
from clalign.rules import Rules, StartRules
from clalign.search.batch import SamplePair, up_sample
from clalign.search.find import Candidate, SearchResult
from clalign.search.score import map_scores

AS_THEY_LIE = "extrinsic"
RIGID = "rigid"


def starting_map(start: Any, source: Mesh, target: Mesh, rules: StartRules) -> NDArray[np.int64]:
    """Take a start in any form a caller may hold it in.

    Parameters
    ----------
    start : "extrinsic"
            every vertex is matched with the nearest one as the files lie in space, with a normal alike.
        "rigid"
            the same after a rigid motion that brings the source onto the target, found from where they lie.
        array (file_count_x,) int, or the path of a text file of them
            the target vertex of every source vertex, counted from 0; -1 where it is not known.
        Correspondence, or the path of a result folder
            an earlier result for the same files.
        (C, Φ, Ψ)
            a functional map (k_y, k_x) with the eigenfunctions (file_count_x, k_x) and (file_count_y, k_y) that it is
            expressed in, as of pyFM or geomfum.

    Returns
    -------
    (n_x,) int64, a vertex of the target's surface for every vertex of the source's, or -1.

    Raises
    ------
    InputError
        `start` is none of these, does not fit the meshes, or knows too few vertices.
    """
    if isinstance(start, str) and start in (AS_THEY_LIE, RIGID):
        found = lying_map(source, target, rules, rigid=start == RIGID)
    elif isinstance(start, (tuple, list)) and len(start) == 3 and np.ndim(start[0]) == 2:
        found = _of_functional_map(start[0], start[1], start[2], source, target)
    else:
        found = _on_surface(_file_map(start, source, target), source, target)
    known = int((found >= 0).sum())
    if told_apart(known) < 1:
        raise InputError(f"the start knows the matches of {known} vertices on the surface, which is too few")
    return found


def _on_surface(matches: NDArray[np.int64], source: Mesh, target: Mesh) -> NDArray[np.int64]:
    """(n_x,) a map between the files on the surfaces; of vertices that were joined, the first whose match is known."""
    found = source.map_from_file(target, matches)
    to_surface = np.where(matches >= 0, target.vertex_of_file[matches], -1)
    known = np.flatnonzero((to_surface >= 0) & (source.vertex_of_file >= 0))[::-1]
    first = np.full(source.n_vertices, -1)
    first[source.vertex_of_file[known]] = to_surface[known]
    return np.where(found >= 0, found, first)


def _file_map(start: Any, source: Mesh, target: Mesh) -> NDArray[np.int64]:
    if isinstance(start, (str, os.PathLike)):
        path = Path(start)
        start = read_map(path / FORWARD_FILE if path.is_dir() else path)
    values = np.asarray(start.target_of_source if isinstance(start, Correspondence) else start)
    if values.dtype.kind not in "iu":
        raise InputError(
            f"start: expected '{AS_THEY_LIE}', '{RIGID}', whole numbers, a file of them, a result or (C, Φ, Ψ), got "
            f"{type(start).__name__}"
        )
    check_map("start", values, source.file_count, target.file_count)
    return values.astype(np.int64)


def _of_functional_map(functional: Any, phi: Any, psi: Any, source: Mesh, target: Mesh) -> NDArray[np.int64]:
    """Nearest rows of Ψ for those of ΦCᵀ."""
    matrix, of_source, of_target = (np.asarray(each, dtype=np.float64) for each in (functional, phi, psi))
    rows = (len(of_source), len(of_target))
    if matrix.ndim != 2 or rows != (source.file_count, target.file_count):
        raise InputError(
            f"start: expected C (k_y, k_x) with functions on {source.file_count} and {target.file_count} vertices, got "
            f"{matrix.shape} with {rows[0]} and {rows[1]} rows"
        )
    of_source, of_target = of_source[:, : matrix.shape[1]], of_target[:, : matrix.shape[0]]
    if (of_target.shape[1], of_source.shape[1]) != matrix.shape:
        raise InputError(f"start: C has shape {matrix.shape}, more than there are functions")
    return nearest_rows(source.from_file(of_source) @ matrix.T, target.from_file(of_target))


def lying_map(source: Mesh, target: Mesh, rules: StartRules, *, rigid: bool) -> NDArray[np.int64]:
    """Return the nearest target vertex of every source vertex (n_x,) in space and normal, in the files' coordinates.

    rigid : first bring the source onto the target by a rigid motion, found by iterated closest points (Besl & McKay
        1992) that leaves out the farthest part (Chetverikov et al. 2002).
    """
    unit = target.scale
    points, others = source.file_vertices() / unit, target.file_vertices() / unit
    normals, other_normals = (vertex_normals(mesh.vertices, mesh.faces) for mesh in (source, target))
    tree = cKDTree(np.concatenate([others, rules.normals * other_normals], axis=1))

    def nearest() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        distance, index = tree.query(np.concatenate([points, rules.normals * normals], axis=1))
        return distance, index.astype(np.int64)

    distance, index = nearest()
    for _ in range(rules.rigid_steps if rigid else 0):
        close = np.argsort(distance, kind="stable")[: max(int(rules.trimmed * len(distance)), 3)]
        middle, other_middle = points[close].mean(axis=0), others[index[close]].mean(axis=0)
        left, _, right = np.linalg.svd((points[close] - middle).T @ (others[index[close]] - other_middle))
        proper = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
        rotation = left @ proper @ right
        points, normals = (points - middle) @ rotation + other_middle, normals @ rotation
        distance, found = nearest()
        if (found == index).all():
            break
        index = found
    return index


def started(source: Shape, target: Shape, matches: NDArray[np.int64], rules: Rules, backend: Backend) -> SearchResult:
    """Return what a search would, with the map that a start leads to as the only candidate; its margin is unknown.

    Parameters
    ----------
    matches : (n_x,) int64, a vertex of the target for every vertex of the source, or -1. Least squares over all of them
        bear wrong ones that do not agree with each other.
    """
    known = np.flatnonzero(matches >= 0)
    pair = SamplePair.of(source, target, backend)
    level = pair.fitted(rules.search.joined)
    size = min(level.size, max(told_apart(len(known)), 1))
    phi, psi = source.basis.functions[known, :size], target.basis.functions[matches[known], :size]
    first = functional_map([MatchedRows(psi, phi, source.mass[known])], ridge=rules.refinement.ridge)
    steps = [pair.fitted(each) for each in rules.search.settle if each.size >= size]
    batch = up_sample(pair, first[None], [*steps, *rules.search.fine])
    points = pair.fitted(rules.search.fine.last).points
    chosen = Candidate(
        batch.functional[0].astype(np.float64),
        float(map_scores(pair, batch, points, rules.search)[0]),
        float(pair.orientations(batch, rules.search.scored_products)[0]),
        0.0,
    )
    return SearchResult(chosen, (), float("nan"))
