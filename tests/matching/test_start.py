"""Starts: a map with errors, an earlier result, another program's functional map, and how shapes lie in space."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import shapes
from assembled import assembled, truth
from numpy.typing import NDArray
from prepared import MIDDLE
from scipy.spatial.transform import Rotation

from clalign.correspondence import Correspondence
from clalign.errors import InputError, ResultError
from clalign.geometry.operators import lumped_mass, stiffness
from clalign.geometry.spectra import solve
from clalign.maps.point_maps import write_map
from clalign.matching.pair import match
from clalign.matching.start import lying_map, starting_map
from clalign.mesh.mesh import Mesh, mesh_from_arrays
from clalign.rules import StartRules

OPTIONS = MIDDLE.replace({"alignment.outer_iterations": 1})

Bodies = tuple[Mesh, Mesh, NDArray[np.int64]]


@pytest.fixture(scope="module")
def bodies() -> Bodies:
    vertices, faces = shapes.bumpy_sphere(3)
    other, other_faces, new_of_old = shapes.renumbered(shapes.bent(vertices, 0.3), faces, 5)
    return mesh_from_arrays(vertices, faces, "one"), mesh_from_arrays(other, other_faces, "other"), new_of_old


@pytest.fixture(scope="module")
def searched(bodies: Bodies) -> Correspondence:
    return match(*bodies[:2], OPTIONS)


def mean_error(result: Correspondence, truth: NDArray[np.int64]) -> float:
    places = result.target.vertices
    return float(np.linalg.norm(places[result.target_of_source] - places[truth], axis=1).mean())


def damaged(truth: NDArray[np.int64], rng: np.random.Generator) -> NDArray[np.int64]:
    """A true map of which 30 % are wrong and another 30 % not known."""
    wrong, unknown = np.split(rng.permutation(len(truth))[: 2 * (3 * len(truth) // 10)], 2)
    changed = truth.copy()
    changed[wrong] = rng.integers(0, len(truth), len(wrong))
    changed[unknown] = -1
    return changed


@pytest.mark.parametrize("form", ["array", "file", "result", "folder"])
def test_a_map_with_errors_or_an_earlier_result(
    form: str, bodies: Bodies, searched: Correspondence, rng: np.random.Generator, tmp_path: Path
) -> None:
    source, target, truth = bodies
    start: object = damaged(truth, rng)
    if form == "file":
        start = tmp_path / "map.txt"
    elif form == "result":
        start = searched
    elif form == "folder":
        searched.save(tmp_path / "earlier")
        start = tmp_path / "earlier"
    if form in ("file", "folder"):
        given = damaged(truth, np.random.default_rng(0)) if form == "file" else searched.target_of_source
        if form == "file":
            write_map(tmp_path / "map.txt", given)
        np.testing.assert_array_equal(starting_map(start, source, target, StartRules()), given)
        return
    result = match(source, target, OPTIONS, start=start)
    assert mean_error(result, truth) <= mean_error(searched, truth) + 2e-3
    assert math.isnan(result.confidence)
    assert result.orientation > 0.9
    assert result.alternatives == ()


def test_a_functional_map_in_other_functions(bodies: Bodies, searched: Correspondence) -> None:
    """Eigenfunctions of another solver: other signs, other units of area."""
    source, target, truth = bodies
    spectra = []
    for mesh, sign in ((source, 1.0), (target, -1.0)):
        places = mesh.file_positions()
        found = solve(stiffness(places, mesh.faces), lumped_mass(places, mesh.faces), 20)
        spectra.append((mesh.to_file(sign * found.functions, 0.0), found.mass))
    (phi, _), (psi, mass) = spectra
    pulled = psi * mass[:, None]
    functional = pulled[truth].T @ phi
    result = match(source, target, OPTIONS, start=(functional, phi, psi))
    assert mean_error(result, truth) <= mean_error(searched, truth) + 2e-3


def test_shapes_that_lie_on_each_other(bodies: Bodies) -> None:
    source, _, _ = bodies
    faces = source.file_faces
    deformed, deformed_faces, truth = shapes.renumbered(source.file_positions() * [1.0, 1.04, 0.97], faces, 9)
    lying = mesh_from_arrays(deformed, deformed_faces, "lying")
    found = lying_map(source, lying, StartRules(), rigid=False)
    assert np.mean(found == truth) > 0.6
    result = match(source, lying, OPTIONS, start="extrinsic")
    assert mean_error(result, truth) < 0.02
    turn = Rotation.from_euler("xyz", [0.12, -0.1, 0.12])
    turned = mesh_from_arrays(turn.apply(deformed) + np.array([0.1, 0.05, -0.08]), deformed_faces, "turned")
    assert np.mean(lying_map(source, turned, StartRules(), rigid=False) == truth) < 0.3
    assert np.mean(lying_map(source, turned, StartRules(), rigid=True) == truth) > 0.5
    assert mean_error(match(source, turned, OPTIONS, start="rigid"), truth) < 0.02


def test_starts_that_do_not_fit_are_named(bodies: Bodies, tmp_path: Path) -> None:
    source, target, truth = bodies
    (tmp_path / "words.txt").write_text("3\nnose\n")
    for start, words in [
        (truth[:-1], "expected one entry for each of 642"),
        (np.full(642, -1), "knows the matches of 0 vertices"),
        (np.full(642, 5000), "vertices 0 to 641"),
        (truth.astype(float), "expected 'extrinsic'"),
        (tmp_path / "none.txt", "cannot be read"),
        (tmp_path / "words.txt", "line 2 is 'nose'"),
        ((np.eye(3), np.ones((5, 3)), np.ones((642, 3))), "with 5 and 642 rows"),
        ((np.eye(4), np.ones((642, 3)), np.ones((642, 3))), "more than there are functions"),
    ]:
        with pytest.raises((InputError, ResultError), match=words):
            starting_map(start, source, target, StartRules())


def test_a_match_known_at_another_copy_of_a_joined_vertex_counts() -> None:
    """A seam gives one place several numbers in the file, of which a user may know any."""
    file, other = assembled(), assembled(0.3, seed=4)
    source, target = (mesh_from_arrays(each.vertices, each.faces, name) for each, name in ((file, "a"), (other, "b")))
    whole = truth(file, other)
    every = starting_map(whole, source, target, StartRules())
    for side in (0, 1):
        start = whole.copy()
        start[file.seam[:, side]] = -1
        np.testing.assert_array_equal(starting_map(start, source, target, StartRules()), every)
