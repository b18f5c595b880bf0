"""Results put together from a known map, so that presentation is tested without running a match."""

from __future__ import annotations

import fabricated as made
import numpy as np
import pytest
import shapes
from fabricated import Fabricate
from numpy.typing import NDArray

from clalign.correspondence import Correspondence
from clalign.geometry.operators import lumped_mass
from clalign.geometry.spectra import Spectrum
from clalign.mesh.mesh import Mesh, mesh_from_arrays


@pytest.fixture(scope="session")
def fabricated() -> Fabricate:
    return made.fabricate


@pytest.fixture(scope="session")
def small() -> Correspondence:
    return made.small()


def waves(mesh: Mesh, basis: int, scale_invariant: int) -> tuple[Spectrum, Spectrum]:
    """Smooth functions in place of eigenfunctions, for meshes on which these would take too long."""
    mass = lumped_mass(mesh.vertices, mesh.faces)
    frequencies = np.random.default_rng(8).normal(scale=4.0, size=(3, max(basis, scale_invariant)))
    functions = np.cos(mesh.vertices @ frequencies)
    functions /= np.sqrt(mass @ functions**2)
    values = np.arange(functions.shape[1], dtype=np.float64)
    return Spectrum(values[:basis], functions[:, :basis], mass), Spectrum(
        values[:scale_invariant], functions[:, :scale_invariant], mass
    )


def torus(around: int, across: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """A bent, uneven ring of around * across vertices."""
    u, v = np.meshgrid(np.arange(around) / around, np.arange(across) / across, indexing="ij")
    u, v = 2 * np.pi * u.ravel(), 2 * np.pi * v.ravel()
    thick = 0.35 + 0.12 * np.cos(u)
    radius = 1.0 + thick * np.cos(v)
    vertices = np.stack([1.2 * radius * np.cos(u), 1.7 * radius * np.sin(u), thick * np.sin(v)], axis=1)
    i, j = np.divmod(np.arange(around * across), across)
    here, right = i * across + j, (i + 1) % around * across + j
    up, both = i * across + (j + 1) % across, (i + 1) % around * across + (j + 1) % across
    return vertices, np.concatenate([np.stack([here, right, both], 1), np.stack([here, both, up], 1)])


@pytest.fixture(scope="session")
def large() -> Correspondence:
    """Two rings of 50,176 vertices, the second bent and numbered in another order."""
    vertices, faces = torus(256, 196)
    other, other_faces, new_of_old = shapes.renumbered(shapes.bent(vertices, 0.5), faces, 6)
    meshes = mesh_from_arrays(vertices, faces, "ring"), mesh_from_arrays(other, other_faces, "bent ring")
    return made.fabricate(*meshes, new_of_old, np.argsort(new_of_old), scale_invariant=100, spectra_of=waves)
