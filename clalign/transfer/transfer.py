"""Carries things through a match: functions, labels, landmarks, texture coordinates and deformations.

Everything is in the numbering of the mesh files: row i belongs to vertex i of the file, and rows of vertices that have
no match say so (NaN, or -1 for whole numbers). Vertices of loose pieces take what their own match has.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import scipy.sparse.linalg
from numpy.typing import ArrayLike, NDArray

from clalign.correspondence import Correspondence
from clalign.errors import InputError
from clalign.geometry.operators import lumped_mass, stiffness
from clalign.maps.file_maps import carried as moved_along
from clalign.mesh.mesh import Mesh
from clalign.transfer.labels import without_speckles
from clalign.transfer.surface_map import SurfaceMap, surface_map

Side = Literal["source", "target"]
Route = Literal["points", "precise", "functional"]


def sides(correspondence: Correspondence, origin: Side) -> tuple[Mesh, Mesh]:
    """Return the mesh that things come from and the one that they go to.

    Raises
    ------
    InputError
        `origin` is neither "source" nor "target".
    """
    if origin == "source":
        return correspondence.source, correspondence.target
    if origin == "target":
        return correspondence.target, correspondence.source
    raise InputError(f"the origin must be 'source' or 'target', got {origin!r}")


def map_from(correspondence: Correspondence, origin: Side, *, precise: bool = False) -> SurfaceMap:
    """Return the map that pulls values of `origin` to the other shape; `precise` as of `surface_map`."""
    return surface_map(correspondence, "to_target" if origin == "source" else "to_source", precise=precise)


def carry_values(
    correspondence: Correspondence, values: ArrayLike, *, origin: Side = "source", route: Route = "points"
) -> NDArray[np.float64]:
    """Carry scalars, colours, texture coordinates or positions of vertices to the other shape.

    Parameters
    ----------
    values : (vertices in the origin's file,) or (…, c) float.
    origin : the shape that the values belong to.
    route : "points" gives each vertex the value at its match (interpolated inside a face where the match has
        sub-vertex places); "precise" interpolates inside faces for any match, from its eigenfunctions, which is
        smoother; "functional" sends smooth functions of the source through C, so that what comes out is smooth but
        loses detail finer than the eigenfunctions. Where the source has no finite value it is filled in smoothly
        before, and the matches of those vertices get NaN.

    Returns
    -------
    (vertices in the other file,) or (…, c) float64; NaN where there is no match, or no value at it.

    Raises
    ------
    InputError
        Wrong number of rows, or the functional route from the target (C leads from the source to the target).
    """
    here, there = sides(correspondence, origin)
    given = _rows(values, here, np.float64)
    rows = here.from_file(given)
    if route == "functional":
        if origin != "source":
            raise InputError("C leads from the source to the target; carry from the source, or use route 'points'")
        if correspondence.shown_map:
            raise InputError("C belongs to the chosen map, not to its alternatives; use route 'points'")
        known = np.isfinite(rows)
        carried = _through_functional_map(correspondence, _filled_in(here, rows, known))
        # One value that is missing would else be missing in every coefficient, and so everywhere.
        carried[map_from(correspondence, origin).pull((~known).astype(np.float64)) > 0] = np.nan
    else:
        pull = map_from(correspondence, origin, precise=route == "precise")
        carried = pull.pull(rows)
        carried[~pull.matched] = np.nan
    return _with_loose(correspondence, origin, there.to_file(carried, np.nan), given)


def carry_labels(
    correspondence: Correspondence, labels: ArrayLike, *, origin: Side = "source", speckles: bool = False
) -> NDArray[np.int64]:
    """Give each vertex of the other shape the label of the vertex that it is matched with, without speckles.

    Labels (vertices in the origin's file,) become (vertices in the other file,) int64, -1 where there is no match.

    Parameters
    ----------
    speckles : keep what `clalign.transfer.labels.without_speckles` would take out.

    Raises
    ------
    InputError
        Wrong number of labels, or labels that are not whole numbers.
    """
    return carried_labels(correspondence, labels, origin=origin, speckles=speckles)[0]


def carried_labels(
    correspondence: Correspondence, labels: ArrayLike, *, origin: Side = "source", speckles: bool = False
) -> tuple[NDArray[np.int64], str]:
    """Do what `carry_labels` does, and return what was cleaned, as a sentence, too."""
    here, there = sides(correspondence, origin)
    numbers = np.asarray(labels)
    if not np.issubdtype(numbers.dtype, np.integer):
        if not np.array_equal(numbers, np.rint(numbers)):
            raise InputError("labels must be whole numbers; carry them as scalars otherwise")
        numbers = np.rint(numbers)
    given = _rows(numbers, here, np.int64)
    rows, vertex = here.from_file(given), map_from(correspondence, origin).vertex
    carried, said = np.where(vertex >= 0, rows[np.maximum(vertex, 0)], -1), "labels as they were matched"
    if not speckles and rows.ndim == 1:
        clean = without_speckles(carried, there, rows, here)
        carried, said = clean.labels, clean.sentence()
    return _with_loose(correspondence, origin, there.to_file(carried, -1), given), said


def carry_landmarks(
    correspondence: Correspondence, landmarks: ArrayLike, *, origin: Side = "source"
) -> NDArray[np.int64]:
    """Return the matches of chosen vertices (p,), numbered from 0 as in the files; -1 where there is no match.

    Raises
    ------
    InputError
        A landmark is not a vertex of the origin's file.
    """
    here, _ = sides(correspondence, origin)
    chosen = np.asarray(landmarks)
    if chosen.ndim != 1 or not np.issubdtype(chosen.dtype, np.integer):
        raise InputError(f"landmarks must be a list of vertex numbers, got {chosen.dtype} of shape {chosen.shape}")
    outside = np.flatnonzero((chosen < 0) | (chosen >= here.file_count))
    if outside.size:
        raise InputError(
            f"landmark {outside[0]} is vertex {chosen[outside[0]]}, but {here.name} has vertices 0 to "
            f"{here.file_count - 1}; vertices are numbered from 0"
        )
    forward = origin == "source"
    return (correspondence.target_of_source if forward else correspondence.source_of_target)[chosen].astype(np.int64)


def carry_deformation(
    correspondence: Correspondence, deformed: ArrayLike, *, origin: Side = "source"
) -> NDArray[np.float64]:
    """Deform the other shape as the origin is deformed, keeping the other's own proportions.

    How the origin stretches and turns around every vertex is carried through the map, and the other shape is the
    least-squares (Poisson) fit to that, as in deformation transfer (Sumner and Popović 2004). Turns are taken in space,
    so both shapes should be in like poses and face the same way before the deformation. Loose pieces of the other shape
    move with its surface.

    Parameters
    ----------
    deformed : (vertices in the origin's file, 3) float, new positions in the unit and place of the origin's file.

    Returns
    -------
    (vertices in the other file, 3) float64, positions in the other file's unit; NaN for vertices that are left out.

    Raises
    ------
    InputError
        Wrong shape, or positions that are not finite.
    """
    here, there = sides(correspondence, origin)
    positions = here.from_file(_rows(deformed, here, np.float64))
    if positions.shape != here.vertices.shape or not np.isfinite(positions).all():
        raise InputError(
            f"a deformation needs three finite coordinates for each of the {here.file_count} vertices of {here.name}"
        )
    new = (positions - here.offset) / here.scale
    pull = map_from(correspondence, origin)
    gradients = pull.pull(_vertex_gradients(here.vertices, new, here.faces).reshape(-1, 9)).reshape(-1, 3, 3)
    gradients[~pull.matched] = np.eye(3)
    mass = lumped_mass(here.vertices, here.faces)
    moved = mass @ (new - here.vertices) / mass.sum()
    fitted = _fit_gradients(there, gradients)
    their_mass = lumped_mass(there.vertices, there.faces)
    fitted += their_mass @ (there.vertices - fitted) / their_mass.sum() + moved
    found = there.to_file(fitted, np.nan)
    if len(there.loose.file_index):
        itself = np.arange(there.n_vertices)
        found[there.loose.file_index] = moved_along(
            there, replace(there, vertices=fitted), itself, there.loose.vertices
        )
    return found * there.scale + there.offset


def _through_functional_map(correspondence: Correspondence, rows: NDArray[np.float64]) -> NDArray[np.float64]:
    functional_map = correspondence.functional_map
    rows_y, rows_x = functional_map.shape
    source = correspondence.source_basis
    coefficients = source.functions[:, :rows_x].T @ (source.mass * rows.T).T
    return np.asarray(correspondence.target_basis.functions[:, :rows_y] @ (functional_map @ coefficients))


def _filled_in(mesh: Mesh, rows: NDArray[np.float64], known: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return values (n,) or (n, c) with those that are not known made harmonic between the others; 0 if none is."""
    filled = np.where(known, rows, 0.0)
    if known.all():
        return filled
    matrix = stiffness(mesh.vertices, mesh.faces).tocsr()
    for values, there in zip(filled.reshape(len(rows), -1).T, known.reshape(len(rows), -1).T, strict=True):
        if there.any() and not there.all():
            unknown = matrix[~there]
            values[~there] = scipy.sparse.linalg.spsolve(
                unknown[:, ~there].tocsc(), -(unknown[:, there] @ values[there])
            )
    return filled


def _vertex_gradients(
    rest: NDArray[np.float64], deformed: NDArray[np.float64], faces: NDArray[np.int32]
) -> NDArray[np.float64]:
    """Return (n, 3, 3) linear maps that take the surroundings of each vertex at rest to the deformed ones."""
    frames = []
    for vertices in (rest, deformed):
        first = vertices[faces[:, 1]] - vertices[faces[:, 0]]
        second = vertices[faces[:, 2]] - vertices[faces[:, 0]]
        normal = np.cross(first, second)
        # Scaled like a length, so that a uniformly scaled triangle scales in its normal direction too.
        normal /= np.maximum(np.sqrt(np.linalg.norm(normal, axis=1, keepdims=True)), 1e-150)
        frames.append(np.stack([first, second, normal], axis=2))
    area = np.linalg.norm(np.cross(frames[0][:, :, 0], frames[0][:, :, 1]), axis=1)
    usable = area > 1e-12 * area.max()
    gradients = np.tile(np.eye(3), (len(faces), 1, 1))
    gradients[usable] = frames[1][usable] @ np.linalg.inv(frames[0][usable])
    weights = np.where(usable, area, 0.0)
    owners = faces.ravel()
    total = np.bincount(owners, weights=np.repeat(weights, 3), minlength=len(rest))
    summed = np.stack(
        [
            np.bincount(owners, weights=np.repeat(weights * entry, 3), minlength=len(rest))
            for entry in gradients.reshape(-1, 9).T
        ],
        axis=1,
    ).reshape(-1, 3, 3)
    alone = total <= 0
    summed[alone] = np.eye(3)
    return np.asarray(summed / np.where(alone, 1.0, total)[:, None, None])


def _fit_gradients(mesh: Mesh, gradients: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the positions x' whose edges are nearest to (T_i + T_j)/2 (x_i - x_j) in cotangent weights."""
    matrix = stiffness(mesh.vertices, mesh.faces).tocsr()
    pairs = matrix.tocoo()
    apart = pairs.row != pairs.col
    i, j, weight = pairs.row[apart], pairs.col[apart], -pairs.data[apart]
    edges = mesh.vertices[i] - mesh.vertices[j]
    wanted = weight[:, None] * np.einsum("eab,eb->ea", (gradients[i] + gradients[j]) / 2, edges)
    right = np.stack([np.bincount(i, weights=column, minlength=mesh.n_vertices) for column in wanted.T], axis=1)
    # Positions are determined up to a translation: the first vertex is held, and the caller moves the whole.
    solver = scipy.sparse.linalg.splu(matrix[1:, 1:].tocsc())
    return np.concatenate([np.zeros((1, 3)), solver.solve(right[1:])])


def _rows(values: ArrayLike, mesh: Mesh, dtype: type) -> NDArray:
    """Return a copy of the values, (file_count, …), of a mesh."""
    array = np.asarray(values)
    if array.ndim not in (1, 2) or len(array) != mesh.file_count:
        raise InputError(
            f"there are {array.shape[0] if array.ndim else 0} rows, but {mesh.name} has {mesh.file_count} vertices in "
            "its file; one row a vertex is needed"
        )
    return array.astype(dtype)


def _with_loose(correspondence: Correspondence, origin: Side, carried: NDArray, given: NDArray) -> NDArray:
    """Return values of one file, those of its loose pieces set to the given ones of the other file at their matches."""
    _, there = sides(correspondence, origin)
    loose = there.loose.file_index
    match = (correspondence.source_of_target if origin == "source" else correspondence.target_of_source)[loose]
    carried[loose[match >= 0]] = given[match[match >= 0]]
    return carried
