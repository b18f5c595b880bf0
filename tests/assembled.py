"""A file as people have them: a body with a seam, a loose ball, one that touches it, a crumb and a lone vertex."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapes
from fabricated import fabricate
from numpy.typing import NDArray

from clalign.correspondence import Correspondence
from clalign.maps.file_maps import file_maps
from clalign.maps.point_maps import PointMaps
from clalign.mesh import topology
from clalign.mesh.mesh import Mesh, mesh_from_arrays

BODY, BALL = 162, 42


class File(NamedTuple):
    """Arrays of a file, and the numbers of what is in it.

    seam : (s, 2) the vertices that lie at one place, on both sides of the cut.
    loose, touching : the vertices of the balls; those of the touching one but for the vertex that it shares.
    shared : the vertex at which that ball touches the body.
    left_out : the vertices of the crumb, and the one in no face.
    new_of_old : the number of every vertex of a file that is not shuffled.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    seam: NDArray[np.int64]
    loose: NDArray[np.int64]
    touching: NDArray[np.int64]
    shared: int
    left_out: NDArray[np.int64]
    new_of_old: NDArray[np.int64]

    @property
    def carried(self) -> NDArray[np.int64]:
        """Every vertex that is carried along."""
        return np.concatenate([self.loose, self.touching])


def assembled(angle: float = 0.0, seed: int | None = None) -> File:
    """Return the file, bent by an angle and shuffled with a seed."""
    body, faces = shapes.bumpy_sphere(2)
    faces = faces.copy()
    above = body[faces].mean(axis=1)[:, 2] > 0
    rim = np.intersect1d(faces[above], faces[~above])
    cut = rim[body[rim, 0] > 0]
    # The ends of the cut stay one vertex, or it would be a hole.
    copies = BODY + np.arange(len(cut))
    place = np.arange(BODY)
    place[cut] = copies
    faces[above] = place[faces[above]]
    ball, ball_faces = shapes.icosphere(1)
    parts, every = [body, body[cut]], [faces]
    start = BODY + len(cut)
    parts.append(0.15 * ball + [0.6, 0.1, 0.0])
    loose = start + np.arange(BALL)
    every.append(ball_faces + start)
    start += BALL
    # The other ball touches the body with its lowest vertex, which is that of the body.
    shared, lowest = int(np.argmax(body[:, 1])), int(np.argmin(ball[:, 1]))
    numbers = start + np.arange(BALL) - (np.arange(BALL) > lowest)
    numbers[lowest] = shared
    parts.append(np.delete(0.2 * (ball - ball[lowest]), lowest, axis=0) + body[shared])
    touching = np.delete(numbers, lowest)
    every.append(numbers[ball_faces])
    start += BALL - 1
    parts.append(0.02 * np.eye(3) + [0.9, 0.2, 0.1])
    every.append(np.array([[start, start + 1, start + 2]]))
    parts.append(np.array([[9.0, 9.0, 9.0]]))
    left_out = start + np.arange(4)
    vertices, all_faces = shapes.bent(np.concatenate(parts), angle), np.concatenate(every)
    new_of_old = np.arange(len(vertices))
    if seed is not None:
        vertices, all_faces, new_of_old = shapes.renumbered(vertices, all_faces, seed)
    return File(
        vertices,
        all_faces,
        new_of_old[np.stack([cut, copies], axis=1)],
        new_of_old[loose],
        new_of_old[touching],
        int(new_of_old[shared]),
        new_of_old[left_out],
        new_of_old,
    )


def truth(source: File, target: File) -> NDArray[np.int64]:
    """Return for every vertex of one file the vertex of the other at its place."""
    return target.new_of_old[np.argsort(source.new_of_old)]


def matched(source: File, target: File) -> Correspondence:
    """Return the result of a match of two such files that is right everywhere."""
    here, there = (mesh_from_arrays(file.vertices, file.faces, name) for file, name in ((source, "a"), (target, "b")))
    forward = _surface_map(here, there, truth(source, target))
    backward = _surface_map(there, here, truth(target, source))
    maps = file_maps(here, there, PointMaps(forward, backward))
    return fabricate(here, there, maps.target_of_source, maps.source_of_target)


def _surface_map(here: Mesh, there: Mesh, index: NDArray[np.int64]) -> NDArray[np.int64]:
    found = there.vertex_of_file[index[here.file_index]]
    assert (found >= 0).all()
    return found


def is_closed(mesh: Mesh) -> bool:
    """Whether a surface has no boundary."""
    return not len(topology.boundary_edges(mesh.faces, mesh.n_vertices))
