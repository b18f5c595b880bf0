"""Small collections for tests, and options under which a pair takes about a second in plain numpy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import shapes
from numpy.typing import NDArray

from clalign.options import Options

CHANGES = {
    "engine.backend": "reference",
    "spectrum.basis": 30,
    "spectrum.refinement": 40,
    "spectrum.scale_invariant": 40,
    "geodesics.search_samples": 100,
    "geodesics.factor_samples": 40,
    "search.method": "tree",
}
OPTIONS = Options.preset("fast").replace(CHANGES)
ARGUMENTS = ["--preset", "fast", *(part for name, value in CHANGES.items() for part in ("--set", f"{name}={value}"))]

ANGLES = (0.0, 0.3, 0.6, -0.3)


def write_shapes(folder: Path, count: int = 4) -> dict[str, NDArray[np.int64]]:
    """Write bent bumpy spheres, each numbered in its own order; return the new number of every vertex by name."""
    folder.mkdir(parents=True, exist_ok=True)
    vertices, faces = shapes.bumpy_sphere(2)
    numbers = {}
    for index, angle in enumerate(ANGLES[:count]):
        points, triangles, numbers[f"s{index}"] = shapes.renumbered(shapes.bent(vertices, angle), faces, index)
        shapes.write_off(folder / f"s{index}.off", points, triangles)
    return numbers


def mean_error(
    target_of_source: NDArray[np.int32], folder: Path, pair: tuple[str, str], numbers: dict[str, NDArray[np.int64]]
) -> float:
    """Return the mean straight distance from the matches to the truth, in sqrt(area)."""
    from clalign.mesh.mesh import load_mesh

    target = load_mesh(folder / f"{pair[1]}.off").vertices
    truth = numbers[pair[1]][np.argsort(numbers[pair[0]])]
    return float(np.linalg.norm(target[target_of_source] - target[truth], axis=1).mean())
