"""Nearest points and scores of candidate maps on the device."""

from __future__ import annotations

import numpy as np

from clalign.engine.kernels_arrays import operation, require_shapes
from clalign.engine.kernels_products import KernelProducts
from clalign.engine.launching import Array, ArrayPair
from clalign.errors import InputError


class KernelSearches(KernelProducts):
    """Best points of rows, and scores of candidate maps."""

    @operation
    def nearest(
        self,
        queries: Array,
        points: Array,
        penalty: Array | None = None,
        *,
        guess: Array | None = None,
        out: ArrayPair | None = None,
    ) -> ArrayPair:
        (m, depth), p = queries.shape, points.shape[0]
        require_shapes("nearest", points=(points.shape[1:], (depth,)))
        if penalty is not None:
            require_shapes("nearest", penalty=(penalty.shape, (p,)))
        if guess is not None:
            require_shapes("nearest", guess=(guess.shape, (m,)))
        index = self._result("nearest", (m,), out and out[0], np.int32)
        score = self._result("nearest", (m,), out and out[1])
        self._launcher.nearest(queries, points, penalty, guess, index, score)
        return index, score

    @operation
    def soft_map_argmax(self, c: Array, psi: Array, w: Array, *, out: ArrayPair | None = None) -> ArrayPair:
        (n, k), n_y = c.shape, psi.shape[0]
        require_shapes("soft_map_argmax", psi=(psi.shape[1:], (k,)), w=(w.shape, (n_y,)))
        index = self._result("soft_map_argmax", (n,), out and out[0], np.int32)
        score = self._result("soft_map_argmax", (n,), out and out[1])
        self._launcher.soft_map_argmax(c, psi, w, index, score)
        return index, score

    @operation
    def distortion_batch(
        self,
        dx: Array,
        dy: Array,
        w: Array,
        index: Array,
        floor: float | None = None,
        *,
        out: Array | None = None,
    ) -> Array:
        if floor is not None and not floor > 0:
            raise InputError(f"distortion_batch: the floor of relative distances must be positive, got {floor!r}")
        m, maps = index.shape
        p = dx.shape[0]
        require_shapes("distortion_batch", dx=(dx.shape, (p, p)), dy=(dy.shape, (m, m)), w=(w.shape, (m,)))
        result = self._result("distortion_batch", (maps,), out)
        self._launcher.distortion_batch(dx, dy, w, index, floor, result)
        return result

    @operation
    def map_distance(self, dx: Array, w: Array, index: Array, *, out: Array | None = None) -> Array:
        m, maps = index.shape
        p = dx.shape[0]
        require_shapes("map_distance", dx=(dx.shape, (p, p)), w=(w.shape, (m,)))
        result = self._result("map_distance", (maps, maps), out)
        self._launcher.map_distance(dx, w, index, result)
        return result
