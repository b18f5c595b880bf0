"""Smooth warps that give a body other proportions: what is no isometry, and has a right map all the same."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clalign.geometry.geodesics import farthest_point_geodesics
from clalign.mesh.mesh import Mesh
from clalign.rules import TipRules
from clalign.search.tips import tips

Points = NDArray[np.float64]

SAMPLES = 100
"""Farthest-point samples among which the ends of limbs are looked for; they are among the first."""
ROOT = (0.15, 0.45)
"""Share by which the end of a limb is nearer than the end of any other, where the limb begins and where it is whole."""
WAVES = 6
WAVELENGTHS = (0.35, 0.8)
"""In units of the diagonal of the bounding box."""


def waves(mesh: Mesh, rng: np.random.Generator, amplitude: float = 0.05) -> Points:
    """Return the vertices (n, 3) moved by a sum of long sine waves of random directions.

    amplitude : root of the summed squares of the waves' amplitudes, in units of the diagonal of the bounding box.
    """
    vertices = mesh.file_vertices()
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    moved = vertices.copy()
    for _ in range(WAVES):
        along, aside = rng.normal(size=(2, 3))
        along *= 2 * np.pi / (np.linalg.norm(along) * diagonal * rng.uniform(*WAVELENGTHS))
        phases = vertices @ along + rng.uniform(0, 2 * np.pi)
        moved += amplitude * diagonal / np.sqrt(WAVES) * np.sin(phases)[:, None] * aside / np.linalg.norm(aside)
    return moved


def limbs(mesh: Mesh, rng: np.random.Generator) -> Points:
    """Return the vertices with every limb at 0.6 to 1.6 of its size, drawn for each."""
    return scaled_limbs(mesh, rng.uniform(0.6, 1.6, TipRules().most))


def ape(mesh: Mesh, rng: np.random.Generator) -> Points:
    """Return the vertices with the two farthest limbs at 0.6, a human's legs, and the next two, the arms, at 1.5."""
    return scaled_limbs(mesh, np.array([0.6, 0.6, 1.5, 1.5, 1.0, 1.0]))


def trunk(mesh: Mesh, rng: np.random.Generator) -> Points:
    """Return the vertices with the trunk at 1.3 of its size beside the limbs."""
    return scaled_limbs(mesh, np.full(TipRules().most, 1 / 1.3))


def scaled_limbs(mesh: Mesh, factors: NDArray[np.float64]) -> Points:
    """Return the vertices (n, 3) with every limb scaled about the middle of its root, whatever the pose.

    A limb is what is nearer to its end than to those of others; the warp fades out towards its root (`ROOT`).

    Parameters
    ----------
    factors : of the limbs, the one that ends farthest from the rest of the body first.
    """
    geodesics = farthest_point_geodesics(mesh, SAMPLES, SAMPLES)
    ends = tips(geodesics.distances, geodesics.weights, TipRules())
    distances = geodesics.rows[ends].astype(np.float64)
    vertices = mesh.file_vertices()
    moved = vertices.copy()
    for number, factor in enumerate(factors[: ends.size] if ends.size > 1 else ()):
        others = np.delete(distances, number, axis=0).min(axis=0)
        nearer = 1.0 - distances[number] / np.maximum(others, 1e-12)
        share = np.clip((nearer - ROOT[0]) / (ROOT[1] - ROOT[0]), 0.0, 1.0)
        share = share**2 * (3.0 - 2.0 * share)
        ring = share * (1.0 - share)
        root = ring @ vertices / max(float(ring.sum()), 1e-12)
        moved += ((factor - 1.0) * share)[:, None] * (vertices - root)
    return moved


@dataclass(frozen=True)
class Warp:
    """A warp of a pair.

    points : the vertices of a mesh after it.
    both : whether the target is warped too, by a draw of its own.
    """

    points: Callable[[Mesh, np.random.Generator], Points]
    both: bool = False


#: Warps by name.
WARPS = {"waves": Warp(waves, both=True), "limbs": Warp(limbs), "ape": Warp(ape), "trunk": Warp(trunk)}
