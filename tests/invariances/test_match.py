"""What must not change the match of two shapes, and what must change it in a known way."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from shapes import Pair
from skips import backend

from clalign import match
from clalign.correspondence import Correspondence
from clalign.geometry.geodesics import all_pairs
from clalign.mesh.mesh import mesh_from_arrays
from clalign.options import Options

Arrays = tuple[NDArray[np.float64], NDArray[np.int64]]

#: Every stage at a size that 642 vertices deserve.
OPTIONS = Options().replace(
    {
        "spectrum.basis": 40,
        "spectrum.refinement": 60,
        "spectrum.scale_invariant": 80,
        "geodesics.factor_samples": 60,
        "geodesics.search_samples": 250,
        "alignment.samples": 250,
        "alignment.outer_iterations": 2,
        "alignment.iterations": 8,
    }
)


class Distances(NamedTuple):
    """Geodesic distances on the target, to measure by how much two maps differ."""

    between: NDArray[np.float64]

    def apart(self, first: NDArray[np.int64], second: NDArray[np.int64]) -> float:
        """Return the mean distance between two maps, in units of the square root of the area."""
        return float(self.between[first, second].mean())


def matched(source: Arrays, target: Arrays, **changes: Any) -> Correspondence:
    named = {name.replace("__", "."): value for name, value in changes.items()}
    return match(source, target, OPTIONS.replace({"engine.backend": backend()} | named))


@pytest.fixture(scope="module")
def pair(bumpy_pair: Pair) -> Pair:
    return bumpy_pair


@pytest.fixture(scope="module")
def plain(pair: Pair) -> Correspondence:
    return matched(pair.source, pair.target)


@pytest.fixture(scope="module")
def on_target(pair: Pair) -> Distances:
    return Distances(all_pairs(mesh_from_arrays(*pair.target)))


@pytest.fixture(scope="module")
def on_source(pair: Pair) -> Distances:
    return Distances(all_pairs(mesh_from_arrays(*pair.source)))


def test_the_match_is_right(plain: Correspondence, pair: Pair, on_target: Distances, on_source: Distances) -> None:
    """Neighbouring vertices are about 0.04 apart."""
    assert on_target.apart(plain.target_of_source, pair.truth) < 0.01
    assert on_source.apart(plain.source_of_target, np.argsort(pair.truth)) < 0.01


def test_running_again_gives_the_same_bits(plain: Correspondence, pair: Pair) -> None:
    again = matched(pair.source, pair.target)
    for name in ("target_of_source", "source_of_target", "rotation", "functional_map", "distortion"):
        np.testing.assert_array_equal(getattr(again, name), getattr(plain, name), err_msg=name)
    assert again.history == plain.history
    assert again.losses == plain.losses


@pytest.mark.parametrize("side", ["source", "target"])
def test_the_map_follows_the_numbering(
    plain: Correspondence, pair: Pair, on_target: Distances, on_source: Distances, side: str
) -> None:
    if side == "source":
        vertices, faces, new_of_old = shapes.renumbered(*pair.source, 11)
        other = matched((vertices, faces), pair.target)
        forward, backward = other.target_of_source[new_of_old], np.argsort(new_of_old)[other.source_of_target]
    else:
        vertices, faces, new_of_old = shapes.renumbered(*pair.target, 12)
        other = matched(pair.source, (vertices, faces))
        forward, backward = np.argsort(new_of_old)[other.target_of_source], other.source_of_target[new_of_old]
    assert_same(plain, forward, backward, on_target, on_source)


def assert_same(
    plain: Correspondence,
    forward: NDArray[np.int64],
    backward: NDArray[np.int64],
    on_target: Distances,
    on_source: Distances,
) -> None:
    """Rounding may tip a few vertices over to a neighbour, no further."""
    assert (forward == plain.target_of_source).mean() > 0.99
    assert on_target.apart(forward, plain.target_of_source) < 0.001
    assert on_target.between[forward, plain.target_of_source].max() < 0.15
    assert (backward == plain.source_of_target).mean() > 0.99
    assert on_source.apart(backward, plain.source_of_target) < 0.001


def turned(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    rotation = np.linalg.qr(np.random.default_rng(8).normal(size=(3, 3)))[0]
    return vertices @ (rotation * np.linalg.det(rotation)).T


MOTIONS: dict[str, Callable[[NDArray[np.float64]], NDArray[np.float64]]] = {
    "rotated": turned,
    "moved": lambda vertices: vertices + np.array([30.0, -7.0, 12.0]),
    "a thousand times larger": lambda vertices: 1000.0 * vertices,
    "a thousand times smaller": lambda vertices: 0.001 * vertices,
    "all at once": lambda vertices: 1000.0 * turned(vertices) + 5000.0,
}


@pytest.mark.parametrize("motion", MOTIONS)
def test_motions_and_scale_change_nothing(
    plain: Correspondence, pair: Pair, on_target: Distances, on_source: Distances, motion: str
) -> None:
    vertices, faces = pair.source
    other = matched((MOTIONS[motion](vertices), faces), pair.target)
    assert_same(plain, other.target_of_source, other.source_of_target, on_target, on_source)
    assert other.losses["total"] == pytest.approx(plain.losses["total"], rel=0.01)


def test_swapping_the_shapes_gives_the_inverse(
    plain: Correspondence, pair: Pair, on_target: Distances, on_source: Distances
) -> None:
    """Up to the read-out: the losses are sampled on the source, so R differs a little."""
    swapped = matched(pair.target, pair.source)
    assert on_target.apart(swapped.source_of_target, plain.target_of_source) < 0.01
    assert on_source.apart(swapped.target_of_source, plain.source_of_target) < 0.01


def test_a_mesh_matches_itself(bumpy: Arrays) -> None:
    result = matched(bumpy, bumpy)
    own = np.arange(len(bumpy[0]))
    assert (result.target_of_source == own).mean() >= 0.99
    assert (result.source_of_target == own).mean() >= 0.99
    assert result.orientation > 0.99
    assert result.warnings == ()


def test_a_mesh_matches_itself_renumbered_and_turned(bumpy: Arrays) -> None:
    vertices, faces, new_of_old = shapes.renumbered(turned(bumpy[0]), bumpy[1], 9)
    result = matched(bumpy, (vertices, faces))
    assert (result.target_of_source == new_of_old).mean() >= 0.99
    assert (result.source_of_target == np.argsort(new_of_old)).mean() >= 0.99


def test_a_mirrored_copy_is_matched_with_orientation_reversing(bumpy: Arrays) -> None:
    vertices, faces, new_of_old = shapes.renumbered(bumpy[0] * np.array([-1.0, 1.0, 1.0]), bumpy[1][:, ::-1].copy(), 9)
    reversing = matched(bumpy, (vertices, faces), search__orientation="reversing")
    assert (reversing.target_of_source == new_of_old).mean() >= 0.99
    assert reversing.orientation < -0.99


def test_different_vertex_counts(bumpy: Arrays) -> None:
    """A shape and the same surface at a quarter of the vertices: each finds the nearest vertex of the other."""
    coarse = shapes.bumpy_sphere(2)
    vertices, faces, new_of_old = shapes.renumbered(*coarse, 3)
    result = matched(bumpy, (vertices, faces), spectrum__refinement=40, spectrum__scale_invariant=40)
    assert result.target_of_source.shape == (len(bumpy[0]),)
    assert result.source_of_target.shape == (len(vertices),)
    # The first vertices of a subdivision are the vertices that were subdivided.
    distances = all_pairs(mesh_from_arrays(*bumpy))
    assert distances[result.source_of_target[new_of_old], np.arange(len(vertices))].mean() < 0.05
    nearest = cKDTree(coarse[0]).query(bumpy[0])[1]
    coarse_distances = all_pairs(mesh_from_arrays(vertices, faces))
    assert coarse_distances[result.target_of_source, new_of_old[nearest]].mean() < 0.08


def test_another_triangulation(bumpy: Arrays) -> None:
    """The same surface with every sixth vertex left out: areas and neighbours differ everywhere."""
    kept, faces = shapes.decimated(*bumpy, 540)
    vertices, faces, new_of_kept = shapes.renumbered(bumpy[0][kept], faces, 3)
    result = matched(bumpy, (vertices, faces))
    distances = all_pairs(mesh_from_arrays(*bumpy))
    assert distances[result.source_of_target[new_of_kept], kept].mean() < 0.03


def test_a_shape_with_a_boundary(bumpy: Arrays) -> None:
    """A cap is cut off both poses; what is left matches."""
    vertices, faces = bumpy
    faces = faces[(vertices[faces][:, :, 2] < 0.35).all(axis=1)]
    used = np.unique(faces)
    place = np.full(len(vertices), -1)
    place[used] = np.arange(len(used))
    open_vertices, open_faces = vertices[used], place[faces]
    source_vertices, source_faces, source_of_old = shapes.renumbered(open_vertices, open_faces, 1)
    target_vertices, target_faces, target_of_old = shapes.renumbered(shapes.bent(open_vertices, 0.15), open_faces, 2)
    result = matched((source_vertices, source_faces), (target_vertices, target_faces))
    truth = target_of_old[np.argsort(source_of_old)]
    distances = all_pairs(mesh_from_arrays(target_vertices, target_faces))
    assert distances[result.target_of_source, truth].mean() < 0.02


@pytest.mark.usefixtures("opencl")
@pytest.mark.parametrize("cycle", [False, True])
def test_both_backends_give_one_map(
    plain: Correspondence, pair: Pair, on_target: Distances, on_source: Distances, cycle: bool
) -> None:
    opencl = matched(pair.source, pair.target, alignment__cycle=True) if cycle else plain
    numpy = matched(pair.source, pair.target, alignment__cycle=cycle, engine__backend="reference")
    assert_same(opencl, numpy.target_of_source, numpy.source_of_target, on_target, on_source)
    assert numpy.losses["total"] == pytest.approx(opencl.losses["total"], rel=0.01)
