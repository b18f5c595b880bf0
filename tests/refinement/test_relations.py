"""Words for the maps between the symmetries of bodies whose symmetries are known."""

from __future__ import annotations

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray

from clalign.geometry.shape import Shape, prepare
from clalign.mesh.mesh import mesh_from_arrays
from clalign.options import Options
from clalign.refinement.relations import relation
from clalign.rules import RelationRules

RULES = RelationRules()
OPTIONS = Options().replace(
    {
        "spectrum.basis": 60,
        "spectrum.refinement": 60,
        "spectrum.scale_invariant": 60,
        "geodesics.search_samples": 300,
        "geodesics.factor_samples": 100,
    }
)


def _shape(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Shape:
    return prepare(mesh_from_arrays(vertices, faces), OPTIONS)


def _functional(shape: Shape, image: NDArray[np.float64]) -> NDArray[np.float64]:
    """C of the self-map that sends the vertices to the places (n, 3)."""
    apart = np.linalg.norm(image[:, None] - shape.mesh.vertices[None], axis=2)
    functions = shape.basis.functions
    return functions.T @ (shape.basis.mass[:, None] * functions[apart.argmin(axis=1)])


@pytest.fixture(scope="module")
def ellipsoid() -> Shape:
    vertices, faces = shapes.icosphere(3)
    # Seen from the front: x goes to the right, y up.
    return _shape(vertices * [0.8, 1.0, 0.5], faces)


@pytest.mark.parametrize(
    ("signs", "words"),
    [
        ((-1, 1, 1), "mirror image: left and right are exchanged"),
        ((1, -1, 1), "mirror image: top and bottom are exchanged"),
        ((1, 1, -1), "mirror image: front and back are exchanged"),
        ((-1, 1, -1), "half turn about the vertical axis"),
        ((1, -1, -1), "half turn about the left–right axis"),
        ((-1, -1, 1), "half turn about the front–back axis"),
        ((-1, -1, -1), "mirror image: two sides are exchanged"),
    ],
)
def test_symmetries_of_an_ellipsoid(ellipsoid: Shape, signs: tuple[int, int, int], words: str) -> None:
    other = _functional(ellipsoid, ellipsoid.mesh.vertices * signs)
    found = relation(ellipsoid, np.eye(60), other, reversing=np.prod(signs) < 0, rules=RULES)
    assert found.order == 2
    assert found.words(RULES) == words


@pytest.mark.parametrize("step", [1, 2])
def test_a_star_turns_fivefold(step: int) -> None:
    vertices, faces = shapes.icosphere(3)
    around = np.arctan2(vertices[:, 1], vertices[:, 0])
    longer = 1 + 0.5 * np.cos(5 * around) * (vertices[:, 0] ** 2 + vertices[:, 1] ** 2)
    star = _shape(vertices * longer[:, None] * [1.0, 1.0, 0.5], faces)
    angle = 2 * np.pi * step / 5
    turn = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    chosen = _functional(star, star.mesh.vertices * [1, 1, -1])
    other = chosen @ _functional(star, star.mesh.vertices @ turn)
    found = relation(star, chosen, other, reversing=False, rules=RULES)
    assert found.order == 5
    assert found.words(RULES) == "5-fold turn about the front–back axis: 5 of them lead back"


def test_a_part_is_named_with_its_share() -> None:
    """Two equal limbs of a body without any other symmetry, exchanged."""
    directions, faces = shapes.icosphere(3)
    limbs = np.array([[1.0, 0.5, 0.1], [-1.0, 0.5, 0.1], [0.0, -1.0, 0.4], [0.2, 0.9, -0.6]])
    limbs /= np.linalg.norm(limbs, axis=1, keepdims=True)
    body = directions * (1 + np.exp(14 * (directions @ limbs.T - 1)) @ [1.4, 1.4, 0.9, 0.6])[:, None]
    shape = _shape(body, faces)
    ends = directions @ limbs[:2].T > 0.8
    image = shape.mesh.vertices.copy()
    image[ends.any(axis=1), 0] *= -1
    found = relation(shape, np.eye(60), _functional(shape, image), reversing=False, rules=RULES)
    assert found.order == 2
    assert 0.1 < found.moved < 0.5
    assert found.words(RULES) == f"exchange: left and right are exchanged, in {found.moved:.0%} of the surface"
