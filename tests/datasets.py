"""Small folders in the layouts of the data sets, and matchers for benchmark runs."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapes
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from clalign.benchmark.methods import Outcome
from clalign.benchmark.pairs import LoadedPair
from clalign.errors import InputError

Arrays = tuple[NDArray[np.float64], NDArray[np.int64]]


def symmetric() -> tuple[Arrays, NDArray[np.int64]]:
    """An egg that is its own image under x → −x (162 vertices), and the number of every vertex's mirror image."""
    vertices, faces = shapes.icosphere(2)
    x, y, z = vertices.T
    egg = np.stack([x, 1.5 * y + 0.3 * y**2, 0.7 * z * (1.2 + 0.4 * y)], axis=1)
    mirror = cKDTree(egg).query(egg * [-1.0, 1.0, 1.0])[1].astype(np.int64)
    return (egg, faces), mirror


def write_ply(path: Path, vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Path:
    """Write an ASCII PLY file."""
    lines = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}"]
    lines += [f"property double {axis}" for axis in "xyz"]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(repr(float(value)) for value in row) for row in vertices]
    lines += [f"3 {a} {b} {c}" for a, b, c in faces.tolist()]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return path


def write_numbers(path: Path, numbers: NDArray[np.int64] | list[int]) -> Path:
    """Write one number a line."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(f"{number}\n" for number in np.asarray(numbers).tolist()), encoding="ascii")
    return path


def write_poses(folder: Path, names: list[str], suffix: str = ".ply") -> NDArray[np.int64]:
    """Write the egg bent by a different angle for each name, and return its mirror images."""
    (vertices, faces), mirror = symmetric()
    folder.mkdir(parents=True, exist_ok=True)
    for number, name in enumerate(names):
        bent = shapes.bent(vertices, 0.1 * number)
        (write_ply if suffix == ".ply" else shapes.write_off)(folder / f"{name}{suffix}", bent, faces)
    return mirror


def write_remeshed(folder: Path, names: list[str], truth_suffix: str, base: int) -> NDArray[np.int64]:
    """Write bent eggs, each in its own vertex order, with files that say where every point of the body is."""
    (vertices, faces), mirror = symmetric()
    for number, name in enumerate(names):
        own, own_faces, place = shapes.renumbered(shapes.bent(vertices, 0.1 * number), faces, number)
        if truth_suffix == ".vts":
            folder.mkdir(parents=True, exist_ok=True)
            shapes.write_off(folder / f"{name}.off", own, own_faces)
            write_numbers(folder / "corres" / f"{name}.vts", place + base)
        else:
            write_ply(folder / f"{name}.ply", own, own_faces)
            write_numbers(folder / f"{name}{truth_suffix}", place + base)
    return mirror


@dataclass(frozen=True)
class NearestMethod:
    """Nearest vertex in space: right for shapes that hardly moved. Fails or dies on a source of a given name."""

    name: str = "nearest"
    fails_on: str = ""
    dies_on: str = ""
    log: str = ""
    settings: str = "1"

    def __call__(self, pair: LoadedPair) -> Outcome:
        source, target = pair.source, pair.target
        if self.log:
            with Path(self.log).open("a", encoding="ascii") as stream:
                stream.write(f"{source.name} {target.name}\n")
        if target.name == self.fails_on:
            raise InputError(f"{target.name} is not to my taste")
        if target.name == self.dies_on:
            os._exit(3)
        nearest = cKDTree(target.file_vertices()).query(source.file_vertices())[1]
        index = np.full(source.file_count, -1, dtype=np.int64)
        index[source.file_index] = target.file_index[nearest]
        return Outcome(index, 0.5, {"search": 0.25}, confidence=0.75, orientation=1.0)


@dataclass(frozen=True)
class EndlessMethod:
    """Works for ever; a file in `folder`, named after the process and locked while it lives, says that it began."""

    folder: str
    name: str = "endless"
    settings: str = "1"

    def __call__(self, pair: LoadedPair) -> Outcome:
        import fcntl

        stream = (Path(self.folder) / str(os.getpid())).open("w", encoding="ascii")
        fcntl.flock(stream, fcntl.LOCK_EX)
        while True:
            time.sleep(1)
