"""Nearest points and scores of candidate maps in the numpy backend."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.engine.backend import RELATIVE_DISTANCE_FLOOR, DistortionKind
from clalign.engine.reference_arrays import stored
from clalign.engine.reference_soft import blocks

Array = NDArray[Any]


class ReferenceSearches:
    """Twins of `backend.Searches`; see there for the formulas."""

    dtype: np.dtype[Any]

    def nearest(
        self,
        queries: Array,
        points: Array,
        penalty: Array | None = None,
        *,
        absolute: bool = False,
        guess: Array | None = None,
        out: tuple[Array, Array] | None = None,
    ) -> tuple[Array, Array]:
        """Index and score of the point of largest score; ties to the lowest index. A guess saves nothing here."""
        index = np.zeros(queries.shape[0], dtype=np.int32)
        score = np.zeros(queries.shape[0], dtype=queries.dtype)
        for rows in blocks(queries.shape[0], points.shape[0]):
            values = queries[rows] @ points.T
            if absolute:
                values *= values
                if penalty is not None:
                    values *= penalty
            elif penalty is not None:
                values -= penalty
            index[rows] = np.argmax(values, axis=1)
            score[rows] = np.take_along_axis(values, index[rows, None].astype(np.int64), axis=1)[:, 0]
        if out is None:
            return index, score
        return stored(index, out[0]), stored(score, out[1])

    def distortion_batch(
        self,
        dx: Array,
        dy: Array,
        w: Array,
        index: Array,
        kind: DistortionKind = "squared",
        *,
        out: Array | None = None,
    ) -> Array:
        """Σ_il w_i w_l e(dx[T_i, T_l], dy[i, l]) for every column T of index."""
        values = np.zeros(index.shape[1], dtype=dx.dtype)
        floor = self.dtype.type(RELATIVE_DISTANCE_FLOOR)
        for column in range(index.shape[1]):
            chosen = index[:, column]
            mapped = dx[np.ix_(chosen, chosen)]
            if kind == "squared":
                error = (mapped - dy) ** 2
            else:
                error = np.abs(mapped - dy) / (mapped + dy + floor)
            values[column] = w @ error @ w
        return stored(values, out)

    def map_distance(self, dx: Array, w: Array, index: Array, *, out: Array | None = None) -> Array:
        """Σ_i w_i dx[index[i, a], index[i, b]]."""
        total = np.zeros((index.shape[1], index.shape[1]), dtype=dx.dtype)
        for weight, row in zip(w, index, strict=True):
            total += weight * dx[np.ix_(row, row)]
        return stored(total, out)
