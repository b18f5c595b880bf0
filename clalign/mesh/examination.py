"""A mesh under examination: the surface as far as it has been put right, and what was found."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clalign.mesh.defects import SHOWN, Defect, LoosePieces, Severity, Surface
from clalign.mesh.topology import IntArray

NONE: IntArray = np.zeros(0, dtype=np.int64)


class Examination:
    """A surface with the defects put right so far, and all that was found.

    strict : refuse what cannot be read as it stands, instead of reading it as the surface that was most likely meant.
    component : number of the piece to keep, from 1 for the largest; None for the largest if it stands out.
    cut_open : cut a one-sided surface open instead of refusing it.
    alone : keep one piece for a copy of the mesh: nothing is carried along with it.
    normals : (n, 3) at points without faces.
    """

    def __init__(
        self,
        surface: Surface,
        *,
        strict: bool = False,
        component: int | None = None,
        cut_open: bool = False,
        alone: bool = False,
        normals: NDArray[np.float64] | None = None,
    ) -> None:
        self.surface = surface
        self.strict = strict
        self.component = component
        self.cut_open = cut_open
        self.alone = alone
        self.normals = normals
        self.cloud: Surface | None = None
        self.loose = LoosePieces.none()
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


def plural(count: int, one: str, many: str) -> str:
    """Return the word that goes with a count."""
    return one if count == 1 else many
