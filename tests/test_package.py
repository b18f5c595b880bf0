"""The package's front door: light to import, complete, and silent."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import clalign
from clalign.data import bundled_pair
from clalign.mesh.mesh import load_mesh

PROBE = """
import json, sys
before = set(sys.modules)
import {module}
print(json.dumps(sorted(set(sys.modules) - before)))
"""


def modules_loaded_by(module: str) -> set[str]:
    done = subprocess.run(
        [sys.executable, "-X", "dev", "-c", PROBE.format(module=module)], capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    lines = done.stdout.splitlines()
    assert len(lines) == 1
    return {name.partition(".")[0] for name in json.loads(lines[0])}


@pytest.mark.parametrize("module", ["clalign", "clalign.cli.main"])
def test_import_loads_nothing_heavy_and_prints_nothing(module: str) -> None:
    heavy = {"pyopencl", "matplotlib", "trimesh", "potpourri3d", "nlopt", "scipy", "numpy", "rich", "pyvista"}
    assert modules_loaded_by(module) & heavy == set()


def test_results_and_evaluation_load_without_opencl_and_matplotlib() -> None:
    loaded = modules_loaded_by("clalign.correspondence, clalign.evaluation.errors")
    assert loaded & {"pyopencl", "matplotlib", "nlopt", "rich"} == set()


def test_every_public_name_is_there() -> None:
    for name in clalign.__all__:
        assert getattr(clalign, name) is not None
    assert set(clalign.__all__) <= set(dir(clalign))
    with pytest.raises(AttributeError, match="no attribute 'mach'"):
        _ = clalign.mach


def test_match_stays_the_function_however_modules_are_imported() -> None:
    code = "import clalign.matching.pair, clalign.evaluation.errors, clalign; print(callable(clalign.match))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "True\n"


def test_tests_mirror_the_rooms() -> None:
    """Beside them stand the tests of the pages, of what goes wrong, and of what must not change a match."""
    root = Path(__file__).parents[1]
    rooms = {path.parent.name for path in (root / "clalign").glob("*/__init__.py")} - {"data"}
    assert {path.parent.name for path in (root / "tests").glob("*/test_*.py")} == rooms | {
        "docs",
        "faults",
        "invariances",
    }


def test_version_is_the_one_that_the_citation_names() -> None:
    root = Path(__file__).parents[1]
    assert f"version: {clalign.__version__}\n" in (root / "CITATION.cff").read_text(encoding="utf-8")
    assert f"## {clalign.__version__} " in (root / "CHANGELOG.md").read_text(encoding="utf-8")
    assert tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dynamic"] == ["version"]


def test_bundled_truth_is_an_isometry_and_its_mirror_image_too() -> None:
    """Edges keep their lengths under both truths, as the body is symmetric; the two differ almost everywhere."""
    pair = bundled_pair()
    source, target = load_mesh(pair.source), load_mesh(pair.target)
    assert source.n_vertices == target.n_vertices == 6890
    edges = source.faces[:, :2]
    before = np.linalg.norm(np.diff(source.vertices[edges], axis=1)[:, 0], axis=1)
    maps = [np.loadtxt(path, dtype=np.int64) for path in (pair.truth, pair.mirrored)]
    assert np.array_equal(np.sort(maps[0]), np.arange(6890))
    for truth in maps:
        after = np.linalg.norm(np.diff(target.vertices[truth[edges]], axis=1)[:, 0], axis=1)
        assert np.median(np.abs(after / before - 1)) < 0.05
    assert np.mean(maps[0] == maps[1]) < 0.05


def test_bundled_meshes_are_numbered_independently() -> None:
    """The identity as a map is as bad as any: mean distance to the truth of the order of the body's size."""
    pair = bundled_pair()
    target = load_mesh(pair.target)
    truth = np.loadtxt(pair.truth, dtype=np.int64)
    assert np.linalg.norm(target.vertices - target.vertices[truth], axis=1).mean() > 0.3
    assert sum(path.stat().st_size for path in pair) < 1_000_000
