"""One pair of a benchmark: its files, and the meshes with their truth once loaded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from clalign.benchmark.perturb import renumber
from clalign.errors import ResultError
from clalign.evaluation.truth import Truth, read_mirror, read_pair_truth
from clalign.mesh.mesh import Mesh, load_mesh

TRUTH_SUFFIX = ".truth.txt"


def truth_file(folder: Path, mesh: str) -> Path:
    """Return the file of a mesh (its stem) whose line i is the same point as line i of any other of the folder."""
    return folder / f"{mesh}{TRUTH_SUFFIX}"


def mirror_file(folder: Path) -> Path | None:
    """Return the file of a folder whose line i is the mirror image of point i, or None where there is none."""
    path = folder / "mirror.txt"
    return path if path.is_file() else None


@dataclass(frozen=True)
class TruthFiles:
    """Where the truth of a pair is.

    source, target : two files whose line i is the same point (``.vts`` is 1-based); None for vertex i ↔ vertex i.
    mirror : file whose line i is the mirror image of line i, or None.
    """

    source: Path | None = None
    target: Path | None = None
    mirror: Path | None = None

    def missing(self) -> list[Path]:
        """Return the files that do not exist."""
        return [path for path in (self.source, self.target, self.mirror) if path is not None and not path.is_file()]

    def read(self, source: Mesh, target: Mesh) -> tuple[Truth, Truth | None]:
        """Return the truth and the mirrored truth.

        Raises
        ------
        ResultError
            The files are wrong, or there are none and the meshes have different vertex counts.
        """
        if self.source is not None and self.target is not None:
            truth = read_pair_truth(
                self.source, self.target, source_count=source.file_count, target_count=target.file_count
            )
        elif source.file_count == target.file_count:
            truth = Truth.identity(source.file_count)
        else:
            raise ResultError(
                f"{source.name} has {source.file_count} vertices and {target.name} has {target.file_count}: vertex i "
                "cannot be vertex i of the other"
            )
        if self.mirror is None:
            return truth, None
        return truth, truth.mirrored(read_mirror(self.mirror, count=truth.count))


@dataclass(frozen=True)
class LoadedPair:
    """A pair in memory: `truth` and `mirrored` speak of the meshes as they are here (renumbered, if so asked)."""

    name: str
    source: Mesh
    target: Mesh
    truth: Truth
    mirrored: Truth | None


class BenchmarkPair(Protocol):
    """What a benchmark runs: something with a name, unique in its suite, that can be loaded."""

    @property
    def name(self) -> str:
        """Name of the pair."""

    def load(self) -> LoadedPair:
        """Read the meshes and the truth."""


@dataclass(frozen=True)
class Pair:
    """A pair of meshes to be matched.

    name : unique in its suite, "ap0 ap4".
    source_path, target_path : mesh files.
    truth : where the truth is.
    shuffle_seed : when not None, the target's vertices and faces get a random order before matching, because one
        vertex order on both meshes flatters every method.
    """

    name: str
    source_path: Path
    target_path: Path
    truth: TruthFiles
    shuffle_seed: int | None = None

    def missing(self) -> list[Path]:
        """Return the files of this pair that do not exist."""
        meshes = [path for path in (self.source_path, self.target_path) if not path.is_file()]
        return meshes + self.truth.missing()

    def load(self) -> LoadedPair:
        """Read everything.

        Raises
        ------
        MeshError, ResultError
            A file is missing or wrong; the message names it.
        """
        source, target = load_mesh(self.source_path), load_mesh(self.target_path)
        truth, mirrored = self.truth.read(source, target)
        if self.shuffle_seed is not None:
            shuffled = renumber(target, self.shuffle_seed)
            target, new_of_old = shuffled.mesh, shuffled.truth.target_points
            truth = truth.renumbered(new_of_old)
            mirrored = None if mirrored is None else mirrored.renumbered(new_of_old)
        return LoadedPair(self.name, source, target, truth, mirrored)
