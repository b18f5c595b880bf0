"""Nearest points and scores of candidate maps on CPUs."""

from __future__ import annotations

import numpy as np

from clalign.engine.cpu_arrays import PART
from clalign.engine.cpu_products import CpuProducts
from clalign.engine.launching import Array, ceil_div, distortion_definitions

CHECK_STEPS = 32
"""Depth after which a tile of the nearest points is checked: can one of its scores still be the best of its row?"""

LEAST_CHECKED = 1.5
"""Depth, in units of `CHECK_STEPS`, from which checks are made: tail norms cost a pass over all rows."""

MANY_ROWS = 8
"""Work-items of each unit that the larger number of row groups must leave."""

DISTORTION_ROWS = 64
"""Rows of a distance matrix that one work-item of the batched distortion sums."""


class CpuSearches(CpuProducts):
    """Best points of rows, and scores of candidate maps; what is computed, the twins in `Reference` say."""

    def nearest(
        self, queries: Array, points: Array, penalty: Array | None, guess: Array | None, index: Array, score: Array
    ) -> None:
        """Queue the point of largest score of every query."""
        (m, depth), p = queries.shape, points.shape[0]
        width = self.width
        panels, rows = ceil_div(p, width), ceil_div(m, self._tile) * self._tile
        checks = 0 if depth < LEAST_CHECKED * CHECK_STEPS else ceil_div(depth, CHECK_STEPS) - 1
        groups = self._nearest_groups(m)
        defines = {"RT": self._tile, "GROUPS": groups, "CHECK_STEPS": CHECK_STEPS}
        launch, kernel = self.device.launch, self.device.kernel
        padded = self.device.scratch("penalty", panels * width)
        launch(kernel("nearest", "pad_penalty", **defines), panels * width, p, panels * width, penalty, padded)
        packed = self._pack_panels("right", points, p, depth, 1, depth)
        query_norms = point_norms = thresholds = None
        if checks:
            query_norms = self.device.scratch("tail_norms.queries", rows * checks)
            launch(kernel("nearest", "query_tail_norms", **defines), rows, m, depth, checks, queries, query_norms)
            point_norms = self.device.scratch("tail_norms.points", panels * width * checks)
            launch(kernel("nearest", "point_tail_norms", **defines), panels, panels, depth, checks, packed, point_norms)
            if guess is not None:
                thresholds = self.device.scratch("thresholds", rows)
                guessed = kernel("nearest", "guessed_thresholds", **defines)
                launch(guessed, rows, m, p, depth, queries, packed, padded, guess, thresholds)
        sides = (queries, packed, padded, query_norms, point_norms, thresholds)
        items = ceil_div(m, groups * self._tile)
        launch(kernel("nearest", "nearest", **defines), items, m, p, depth, checks, *sides, index, score)

    def soft_map_argmax(self, c: Array, psi: Array, w: Array, index: Array, score: Array) -> None:
        """Queue the hard map of a soft one."""
        (n, k), n_y = c.shape, psi.shape[0]
        groups = self._nearest_groups(n)
        packed = self._pack_panels("right", psi, n_y, k, 1, k)
        kernel = self.device.kernel("soft_map_argmax", "soft_map_argmax", RT=self._tile, GROUPS=groups)
        self.device.launch(kernel, ceil_div(n, groups * self._tile), n, n_y, k, c, packed, w, index, score)

    def distortion_batch(
        self, dx: Array, dy: Array, w: Array, index: Array, floor: float | None, result: Array
    ) -> None:
        """Queue the distortion of every map."""
        (m, maps), p = index.shape, dx.shape[0]
        rows = self.device.scratch("maps", maps * m, np.int32)
        parts = ceil_div(m, DISTORTION_ROWS)
        partial = self.device.scratch("partial", parts * maps)
        defines = self._candidate_defines(floor)
        launch, kernel = self.device.launch, self.device.kernel
        launch(kernel("candidates", "transpose_maps", **defines), maps, m, maps, index, rows)
        scores = kernel("candidates", "distortion_parts", **defines)
        launch(scores, (parts, maps), m, p, parts, dx, dy, w, rows, partial)
        launch(kernel("reduce", "finish_rows", RB=PART), maps, maps, parts, partial, result)

    def map_distance(self, dx: Array, w: Array, index: Array, result: Array) -> None:
        """Queue the distance of every two maps."""
        (m, maps), p = index.shape, dx.shape[0]
        kernel = self.device.kernel("candidates", "map_distance", **self._candidate_defines(None))
        self.device.launch(kernel, (ceil_div(maps, self.width), maps), m, maps, p, dx, w, index, result)

    def _nearest_groups(self, rows: int) -> int:
        """Row groups of one work-item: the more, the fewer times all points are read, as long as every unit is busy."""
        usual, most = self.constants.nearest_groups
        return most if ceil_div(rows, self._tile) >= most * MANY_ROWS * self.device.facts.units else usual

    def _candidate_defines(self, floor: float | None) -> dict[str, str | int]:
        return {"DB": DISTORTION_ROWS, **distortion_definitions(floor, self.device.dtype.itemsize)}
