"""The pairs of a folder with the target damaged, each in one of the ways of `clalign.benchmark.damage`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clalign.benchmark.damage import DAMAGES
from clalign.benchmark.layouts import Layout, humans
from clalign.benchmark.pairs import BenchmarkPair, LoadedPair
from clalign.errors import OptionError
from clalign.evaluation.truth import Truth
from clalign.mesh.mesh import mesh_from_arrays

CLEAN = "clean"
ALL_DAMAGES = (CLEAN, *DAMAGES)


@dataclass(frozen=True)
class DamagedPair:
    """A pair whose target is damaged, with its vertices and faces shuffled as well.

    name : of the pair.
    pair : the sound pair.
    damage : one of `DAMAGES`, or "clean".
    seed : of what is drawn.
    """

    name: str
    pair: BenchmarkPair
    damage: str
    seed: int = 0

    def load(self) -> LoadedPair:
        """Read the pair and damage the target.

        Raises
        ------
        ClalignError
            The pair is not usable, or the damage needs a package that is not installed.
        """
        sound = self.pair.load()
        if self.damage == CLEAN:
            return sound
        rng = np.random.default_rng(self.seed)
        target = sound.target
        damaged = DAMAGES[self.damage](target.file_positions(), target.file_faces, rng)
        new_number = rng.permutation(len(damaged.vertices))
        vertices = np.empty_like(damaged.vertices)
        vertices[new_number] = damaged.vertices
        faces = rng.permutation(new_number[damaged.faces], axis=0)
        mesh = mesh_from_arrays(vertices, faces, f"{target.name} ({self.damage})")
        # The last entry stands for a vertex that has gone.
        new_of_old = np.append(new_number, -1)[damaged.new_of_old]
        known = new_of_old[sound.truth.target_points] >= 0
        truth = _moved(sound.truth, new_of_old, known)
        mirrored = sound.mirrored
        if mirrored is not None:
            known &= new_of_old[mirrored.target_points] >= 0
            truth, mirrored = _moved(sound.truth, new_of_old, known), _moved(mirrored, new_of_old, known)
        return LoadedPair(self.name, sound.source, mesh, truth, mirrored)


def _moved(truth: Truth, new_of_old: NDArray[np.int64], known: NDArray[np.bool_]) -> Truth:
    return Truth(truth.source_points[known], new_of_old[truth.target_points[known]])


def damaged(path: str | Path, damages: Sequence[str] = ALL_DAMAGES, pairs: str | None = None) -> tuple[Layout, ...]:
    """Return one suite for each damage, of all pairs of a folder in the layout of the humans.

    Raises
    ------
    OptionError
        No such damage.
    ResultError
        No such folder or pairs file.
    """
    unknown = [damage for damage in damages if damage not in ALL_DAMAGES]
    if unknown:
        raise OptionError(f"unknown damage {unknown[0]!r}; there are {', '.join(ALL_DAMAGES)}")
    layouts = humans(path, pairs)
    folder = Path(path).resolve().name
    # Lists take turns, so that a limit leaves pairs of each.
    longest = max(len(layout.pairs) for layout in layouts)
    every = [layout.pairs[turn] for turn in range(longest) for layout in layouts if turn < len(layout.pairs)]
    problems = tuple(problem for layout in layouts for problem in layout.problems)
    return tuple(
        Layout(
            f"{folder}/{damage}",
            tuple(DamagedPair(pair.name, pair, damage, number) for number, pair in enumerate(every)),
            problems,
        )
        for damage in damages
    )
