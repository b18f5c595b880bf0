"""Pointwise descriptors that a user has of both shapes: signatures of other programs, learned features, any numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.errors import InputError
from clalign.mesh.mesh import Mesh

DESCRIPTOR_WEIGHT = 0.25
"""Usual weight: they decide what eigenfunctions leave open, and hardly change the rest."""


@dataclass(frozen=True, eq=False)
class PointDescriptors:
    """Descriptors of one surface beside those of another.

    Attributes
    ----------
    values : (n, f) float64. Their mean over both surfaces is 0, and the sum of the variances of the columns is 1.
    weight : what their squared distances count, relative to those of the eigenfunctions that they stand beside.
    """

    values: NDArray[np.float64]
    weight: float

    def at(self, vertices: NDArray[np.int64]) -> PointDescriptors:
        """Return those of some vertices (m,)."""
        return PointDescriptors(self.values[vertices], self.weight)

    @property
    def weighted(self) -> NDArray[np.float64]:
        """The values times the root of the weight, to stand beside functions whose variances sum to 1."""
        return math.sqrt(self.weight) * self.values


def descriptors_of(
    given: Any, source: Mesh, target: Mesh, weight: float
) -> tuple[PointDescriptors, PointDescriptors] | None:
    """Take descriptors of a pair, one row a vertex of each file.

    Distances between rows are what tells: columns keep the scales that they have relative to each other.

    Parameters
    ----------
    given : (F_x, F_y), (file_count_x, f) and (file_count_y, f), or (file_count,) for a single number a vertex. Rows of
        vertices that are not on the surface are not read.
    source, target : the surfaces.
    weight : see `PointDescriptors`.

    Returns
    -------
    Descriptors of both surfaces; None for the weight 0.

    Raises
    ------
    InputError
        They are no two tables of finite numbers with a row for every vertex and the same columns, or all rows are the
        same; or the weight is negative.
    """
    if not (weight >= 0 and math.isfinite(weight)):
        raise InputError(f"descriptor_weight must not be negative, got {weight!r}")
    if not isinstance(given, (tuple, list)) or len(given) != 2:
        raise InputError(
            "descriptors: expected two arrays (F_x, F_y), one row a vertex of the source and of the target"
        )
    x, y = (
        _rows(name, values, mesh)
        for name, values, mesh in zip(("source", "target"), given, (source, target), strict=True)
    )
    if x.shape[1] != y.shape[1]:
        raise InputError(
            f"descriptors: {x.shape[1]} columns for the source and {y.shape[1]} for the target; column i must be the "
            "same quantity on both"
        )
    found = beside_each_other(x, y, weight)
    if found is None:
        raise InputError("descriptors: all rows are the same, so that they tell no vertex from another")
    return found if weight > 0 else None


def beside_each_other(
    x: NDArray[np.float64], y: NDArray[np.float64], weight: float
) -> tuple[PointDescriptors, PointDescriptors] | None:
    """Return rows (n_x, f) and (n_y, f) as descriptors: centred, and scaled together. None where all are the same."""
    middle = 0.5 * (x.mean(axis=0) + y.mean(axis=0))
    x, y = x - middle, y - middle
    variance = 0.5 * float(np.square(x).sum() / len(x) + np.square(y).sum() / len(y))
    if not variance > 0:
        return None
    scale = 1.0 / math.sqrt(variance)
    return PointDescriptors(scale * x, weight), PointDescriptors(scale * y, weight)


def _rows(name: str, given: Any, mesh: Mesh) -> NDArray[np.float64]:
    """Return the rows of the surface's vertices, (n, f), as float64."""
    values = np.asarray(given)
    if values.ndim == 1:
        values = values[:, None]
    if values.dtype.kind not in "buif" or values.ndim != 2 or not values.shape[1]:
        raise InputError(
            f"descriptors of the {name}: expected numbers (vertices, columns), got {values.dtype} of shape "
            f"{values.shape}"
        )
    if len(values) != mesh.file_count:
        raise InputError(
            f"descriptors of the {name}: {len(values)} rows, and {mesh.name} has {mesh.file_count} vertices; one row a "
            "vertex of the file is needed"
        )
    rows = mesh.from_file(values).astype(np.float64)
    bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    if bad.size:
        raise InputError(
            f"descriptors of the {name}: {bad.size} rows hold values that are not finite, the first that of vertex "
            f"{mesh.file_index[bad[0]]}"
        )
    return rows
