"""The records that mesh checks speak in: one finding, the surface that is left, and the diagnosis of a whole mesh."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from clalign.errors import MeshError

SHOWN = 5
"""How many offending vertices and faces a finding names."""


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
    """What the user can do about it; `{repair}` stands for the repair command, see `Defect.way_out`."""

    def sentence(self) -> str:
        """Problem, place and action in one sentence."""
        places = [
            f"{one if len(numbers) == 1 else many} {', '.join(map(str, numbers))}"
            + (", …" if len(numbers) == SHOWN != self.count else "")
            for one, many, numbers in (("vertex", "vertices", self.vertices), ("face", "faces", self.faces))
            if numbers
        ]
        where = f" ({'; '.join(places)})" if places else ""
        return f"{self.problem}{where}" + (f": {self.action}" if self.action else "")

    def way_out(self, path: str | None) -> str:
        """Advice for the user of the file `path`, or of two arrays."""
        copy = "`clalign.mesh.repair.repair(vertices, faces)` returns a repaired copy"
        if path is not None:
            copy = f"`clalign check {shlex.quote(path)} --repair OUT` writes a repaired copy"
        return self.advice.replace("{repair}", copy)


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
    joined_to: NDArray[np.int64]
    """(file_count,) the given number of the vertex that each given vertex was joined to; its own if to none."""

    @staticmethod
    def whole(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Surface:
        """The surface of all given vertices and faces."""
        count = len(vertices)
        return Surface(vertices, faces, np.arange(count), np.arange(len(faces)), np.arange(count))

    def keep(self, faces: NDArray[np.bool_]) -> Surface:
        """The marked faces with the vertices that they use."""
        kept = self.faces[faces]
        used = np.zeros(len(self.vertices), dtype=bool)
        used[kept.ravel()] = True
        place = np.cumsum(used) - 1
        return Surface(self.vertices[used], place[kept], self.file_index[used], self.face_index[faces], self.joined_to)

    def vertex_of_file(self) -> NDArray[np.int64]:
        """(file_count,) the vertex here of every given one: of several copies that with the most faces, -1 for none."""
        around = np.bincount(self.faces.ravel(), minlength=len(self.vertices))
        # Of equal numbers the last one stays: the copies are written in rising order of preference.
        order = np.lexsort((-np.arange(len(around)), around))
        best = np.full(len(self.joined_to), -1, dtype=np.int64)
        best[self.file_index[order]] = order
        return best[self.joined_to]


@dataclass(frozen=True)
class LoosePieces:
    """What hangs loose beside the surface (eyes, a tongue, a shell) and is carried along with it."""

    file_index: NDArray[np.int64]
    """(k,) the given numbers of its vertices."""
    vertices: NDArray[np.float64]
    """(k, 3) their places, in the unit of the surface that they go with."""
    piece: NDArray[np.int64]
    """(k,) number of the piece that each belongs to, counted from 0."""
    faces: NDArray[np.int64]
    """(q, 3) its triangles, in the given numbers."""

    @staticmethod
    def none() -> LoosePieces:
        """Nothing loose."""
        return LoosePieces(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros((0, 3), np.int64))

    def with_more(
        self,
        file_index: NDArray[np.int64],
        vertices: NDArray[np.float64],
        piece: NDArray[np.int64],
        faces: NDArray[np.int64],
    ) -> LoosePieces:
        """These pieces and others, which are numbered after them."""
        return LoosePieces(
            np.concatenate([self.file_index, file_index]),
            np.concatenate([self.vertices, vertices]),
            np.concatenate([self.piece, piece + len(np.unique(self.piece))]),
            np.concatenate([self.faces, faces]),
        )


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
    loose: LoosePieces = field(default_factory=LoosePieces.none)
    """What is carried along with the surface."""

    @property
    def refused(self) -> tuple[Defect, ...]:
        """The defects that the method cannot work with."""
        return tuple(defect for defect in self.defects if defect.severity is Severity.REFUSED)

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences about everything that was put right."""
        return tuple(defect.sentence() for defect in self.defects if defect.severity is Severity.HANDLED)

    def usable_surface(self, name: str, path: str | None = None) -> Surface:
        """The surface.

        Raises
        ------
        MeshError
            if a defect is refused; names the file or the mesh, every reason and the way out.
        """
        refused = self.refused
        if self.surface is not None and not refused:
            return self.surface
        reasons = "; ".join(defect.sentence() for defect in refused)
        advice = "; ".join(distinct([defect.way_out(path) for defect in refused]))
        raise MeshError(f"{path or name}: {reasons}. Way out: {advice}.")


def distinct(ways: Sequence[str]) -> list[str]:
    """Return advice in its order, each once, without what stands word for word in another."""
    once = list(dict.fromkeys(way for way in ways if way))
    return [way for way in once if not any(way in other for other in once if other != way)]
