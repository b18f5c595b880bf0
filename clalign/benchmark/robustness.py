"""Every mesh of a folder against changed copies of itself: the pairs whose right answer is beyond doubt."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clalign.benchmark import perturb
from clalign.benchmark.layouts import Layout, mesh_files
from clalign.benchmark.pairs import LoadedPair, mirror_file
from clalign.errors import OptionError
from clalign.evaluation.truth import Truth, read_mirror
from clalign.mesh.mesh import Mesh, load_mesh

#: Changes by name; each takes the mesh only.
CHANGES: dict[str, Callable[[Mesh], perturb.Perturbed]] = {
    "noise": partial(perturb.noise, amount=0.2, direction="any"),
    "normal-noise": partial(perturb.noise, amount=0.2, direction="normal"),
    "half": partial(perturb.decimate, share=0.5),
    "rotated": perturb.rotate,
    "times-1000": partial(perturb.scale, factor=1000.0),
    "times-0.001": partial(perturb.scale, factor=0.001),
    "subdivided": perturb.subdivide,
}
DEFAULT_CHANGES = ("noise", "half", "rotated", "times-1000", "times-0.001")


@dataclass(frozen=True)
class ChangedPair:
    """A mesh and a changed copy of it, whose vertices are shuffled as well.

    name : "ap0 noise".
    path : of the mesh.
    change : one of `CHANGES`.
    mirror : file of the mirror image of every vertex, or None.
    """

    name: str
    path: Path
    change: str
    mirror: Path | None = None

    def load(self) -> LoadedPair:
        """Read the mesh and change it.

        Raises
        ------
        ClalignError
            The mesh is not usable, or the change needs a package that is not installed.
        """
        source = load_mesh(self.path)
        changed = CHANGES[self.change](source)
        shuffled = perturb.renumber(changed.mesh)
        truth = changed.truth.renumbered(shuffled.truth.target_points)
        mirrored = None
        if self.mirror is not None:
            truth, mirrored = _with_mirrored(truth, read_mirror(self.mirror, count=source.file_count))
        return LoadedPair(self.name, source, shuffled.mesh, truth, mirrored)


def _with_mirrored(truth: Truth, mirror: NDArray[np.int64]) -> tuple[Truth, Truth]:
    """Return the lines of the truth whose mirror image has a line too, and the mirrored truth of those."""
    target_of_source = np.full(mirror.size, -1, dtype=np.int64)
    target_of_source[truth.source_points] = truth.target_points
    images = target_of_source[mirror[truth.source_points]]
    known = images >= 0
    sources = truth.source_points[known]
    return Truth(sources, truth.target_points[known]), Truth(sources, images[known])


def robustness(path: str | Path, changes: Sequence[str] = DEFAULT_CHANGES) -> tuple[Layout, ...]:
    """Return one suite for each change, of all meshes in a folder.

    Raises
    ------
    OptionError
        No such change.
    ResultError
        No such folder, or no mesh in it.
    """
    unknown = [change for change in changes if change not in CHANGES]
    if unknown:
        raise OptionError(f"unknown change {unknown[0]!r}; there are {', '.join(CHANGES)}")
    folder, meshes = mesh_files(path)
    mirror = mirror_file(folder)
    layouts = []
    for change in changes:
        pairs = tuple(ChangedPair(f"{name} {change}", mesh, change, mirror) for name, mesh in meshes.items())
        layouts.append(Layout(f"{folder.name}/{change}", pairs, ()))
    return tuple(layouts)
