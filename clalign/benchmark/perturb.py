"""Changed copies of a mesh whose truth to the original is known: what a matcher should not be disturbed by."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from clalign.errors import InputError
from clalign.evaluation.truth import Truth
from clalign.mesh.mesh import Mesh, mesh_from_arrays
from clalign.mesh.topology import edge_table, side_lengths, vertex_normals

NEIGHBOURS = 8


@dataclass(frozen=True)
class Perturbed:
    """A changed mesh and the truth from the original (source) to it (target)."""

    mesh: Mesh
    truth: Truth


def renumber(mesh: Mesh, seed: int = 0) -> Perturbed:
    """Give vertices and faces a random order, and each face a random first corner.

    ``truth.target_points[v]`` is the new number of the old file vertex v.
    """
    rng = np.random.default_rng(seed)
    new_of_old = rng.permutation(mesh.file_count)
    new_file_index = new_of_old[mesh.file_index]
    order = np.argsort(new_file_index)
    new_compact = np.empty(mesh.n_vertices, dtype=np.int64)
    new_compact[order] = np.arange(mesh.n_vertices)
    faces = new_compact[mesh.faces[rng.permutation(mesh.n_faces)]]
    # The last entry stands for no vertex, -1.
    vertex_of_file = np.append(new_compact, -1)[mesh.vertex_of_file[np.argsort(new_of_old)]]
    turns = (np.arange(3)[None, :] + rng.integers(0, 3, mesh.n_faces)[:, None]) % 3
    changed = dataclasses.replace(
        mesh,
        vertices=mesh.vertices[order],
        faces=np.take_along_axis(faces, turns, axis=1).astype(np.int32),
        file_index=new_file_index[order],
        vertex_of_file=vertex_of_file,
        loose=dataclasses.replace(
            mesh.loose, file_index=new_of_old[mesh.loose.file_index], faces=new_of_old[mesh.loose.faces]
        ),
    )
    return Perturbed(changed, Truth(np.arange(mesh.file_count), new_of_old))


def noise(mesh: Mesh, amount: float = 0.2, seed: int = 0, direction: Literal["normal", "any"] = "normal") -> Perturbed:
    """Move every vertex by a Gaussian of standard deviation `amount` times the mean edge length.

    direction : along the vertex normal, or the same amount in a random direction.
    """
    rng = np.random.default_rng(seed)
    vertices = mesh.file_vertices()
    # Each edge counts once a face.
    edge = side_lengths(vertices, mesh.faces).mean()
    lengths = amount * float(edge) * rng.standard_normal(mesh.n_vertices)
    if direction == "normal":
        directions = vertex_normals(vertices, mesh.faces)
    else:
        directions = rng.standard_normal((mesh.n_vertices, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return same_vertices(mesh, vertices + lengths[:, None] * directions, "noise")


def rotate(mesh: Mesh, seed: int = 0) -> Perturbed:
    """Turn the mesh by a random rotation about the origin of its file."""
    rotation = Rotation.from_rotvec(np.random.default_rng(seed).uniform(-2, 2, 3)).as_matrix()
    return same_vertices(mesh, mesh.file_vertices() @ rotation.T, "rotated")


def scale(mesh: Mesh, factor: float) -> Perturbed:
    """Multiply all coordinates, as when millimetres are read for metres."""
    return same_vertices(mesh, mesh.file_vertices() * factor, f"times {factor:g}")


def subdivide(mesh: Mesh) -> Perturbed:
    """Split every face into four at the middles of its edges; the old vertices come first, in their old order."""
    table = edge_table(mesh.faces, mesh.n_vertices)
    ab, bc, ca = mesh.n_vertices + table.edge_of_half_edge.reshape(3, -1)
    a, b, c = mesh.faces.T.astype(np.int64)
    faces = np.concatenate([np.stack(face, axis=1) for face in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    vertices = mesh.file_vertices()
    vertices = np.concatenate([vertices, vertices[table.edges].mean(axis=1)])
    changed = mesh_from_arrays(vertices, faces, f"{mesh.name} (subdivided)")
    return Perturbed(changed, Truth(mesh.file_index, np.arange(mesh.n_vertices)))


def decimate(mesh: Mesh, share: float = 0.5) -> Perturbed:
    """Collapse edges by the quadric error until `share` of the faces is left.

    The truth of each remaining vertex is the nearest original vertex whose normal points to the same side.

    Raises
    ------
    InputError
        `share` is outside (0, 1), or the package fast-simplification is not installed.
    """
    if not 0 < share < 1:
        raise InputError(f"the share of faces to keep must lie in (0, 1), got {share!r}")
    vertices, faces = simplified(mesh.vertices, mesh.faces, share)
    changed = mesh_from_arrays(vertices * mesh.scale + mesh.offset, faces, f"{mesh.name} (decimated)")
    there = changed.file_vertices()
    nearest = nearest_on_the_same_side(
        mesh.file_vertices(),
        vertex_normals(mesh.file_vertices(), mesh.faces),
        there,
        vertex_normals(there, changed.faces),
    )
    return Perturbed(changed, Truth(mesh.file_index[nearest], changed.file_index))


def simplified(
    vertices: NDArray[np.float64], faces: NDArray[np.integer], share: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return vertices and faces after edges were collapsed by the quadric error until `share` of the faces is left.

    Raises
    ------
    InputError
        The package fast-simplification is not installed.
    """
    try:
        import fast_simplification
    except ImportError as error:
        raise InputError("decimation needs the package fast-simplification: pip install fast-simplification") from error
    points, sides = fast_simplification.simplify(
        vertices.astype(np.float32), faces.astype(np.int32), target_reduction=1.0 - share
    )
    return points.astype(np.float64), sides.astype(np.int64)


def nearest_on_the_same_side(
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    queries: NDArray[np.float64],
    query_normals: NDArray[np.float64],
    neighbours: int = NEIGHBOURS,
) -> NDArray[np.int64]:
    """Return the (q,) nearest points, so that two sheets that almost touch are not confused.

    normals, query_normals : (p, 3) and (q, 3), of any length.
    neighbours : points among which one on the same side is looked for.
    """
    gaps, candidates = cKDTree(points).query(queries, k=min(neighbours, len(points)))
    agreement = np.einsum("qkx,qx->qk", normals[candidates], query_normals)
    gaps = np.where((agreement > 0) | ~(agreement > 0).any(axis=1, keepdims=True), gaps, np.inf)
    return candidates[np.arange(len(queries)), gaps.argmin(axis=1)]


def same_vertices(mesh: Mesh, vertices: NDArray[np.float64], change: str) -> Perturbed:
    """Return a mesh with its vertices at other places, `vertices` (n, 3), named after the change."""
    changed = mesh_from_arrays(vertices, mesh.faces, f"{mesh.name} ({change})")
    return Perturbed(changed, Truth(mesh.file_index, np.arange(mesh.n_vertices)))
