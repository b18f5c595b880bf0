"""Nearest points and scores of candidate maps on GPUs."""

from __future__ import annotations

import numpy as np

from clalign.engine.gpu_products import GpuProducts
from clalign.engine.launching import Array, ceil_div, distortion_definitions, equal_parts


class GpuSearches(GpuProducts):
    """Best points of rows, and scores of candidate maps; what is computed, the twins in `Reference` say."""

    def nearest(
        self,
        queries: Array,
        points: Array,
        penalty: Array | None,
        guess: Array | None,
        index: Array,
        score: Array,
    ) -> None:
        """Queue the point of largest score of every query."""
        self._best(queries, points, penalty, False, index, score)

    def soft_map_argmax(self, c: Array, psi: Array, w: Array, index: Array, score: Array) -> None:
        """Queue the hard map of a soft one."""
        self._best(c, psi, w, True, index, score)

    def distortion_batch(
        self, dx: Array, dy: Array, w: Array, index: Array, floor: float | None, result: Array
    ) -> None:
        """Queue the distortion of every map."""
        (m, maps), p = index.shape, dx.shape[0]
        kernel = self.device.kernel(
            "gpu_candidates", "distortion", **distortion_definitions(floor, self.device.dtype.itemsize)
        )
        self._launch_groups(kernel, (1, maps), m, p, maps, dx, dy, w, index, result)

    def map_distance(self, dx: Array, w: Array, index: Array, result: Array) -> None:
        """Queue the distance of every two maps."""
        (m, maps), p = index.shape, dx.shape[0]
        defines = distortion_definitions(None, self.device.dtype.itemsize)
        kernel = self.device.kernel("gpu_candidates", "map_distance", **defines)
        self.device.launch(kernel, (maps, maps), m, maps, p, dx, w, index, result)

    def _best(
        self, queries: Array, points: Array, bias: Array | None, squared: bool, index: Array, score: Array
    ) -> None:
        (m, depth), p = queries.shape, points.shape[0]
        tile = self.constants.best
        defines = {**tile.definitions, "UNROLL": self.constants.unroll, "SQUARED": int(squared)}
        groups, tiles = ceil_div(m, tile.rows), ceil_div(p, tile.columns)
        splits, split_tiles = equal_parts(tiles, self._splits(groups, tiles, 1))
        found = (index, score)
        if splits > 1:
            found = (
                self.device.scratch("best.index", splits * m, np.int32),
                self.device.scratch("best.score", splits * m),
            )
        kernel = self.device.kernel("gpu_best", "best", **defines)
        self._launch_groups(kernel, (groups, splits), m, p, depth, split_tiles, queries, points, bias, *found)
        if splits > 1:
            kernel = self.device.kernel("gpu_best", "finish_best", **defines)
            self.device.launch(kernel, m, m, splits, *found, index, score)
