"""Nearest points and scores of candidate maps on the device."""

from __future__ import annotations

import numpy as np

from clalign.engine.kernels_arrays import PART, Array, ArrayPair, ceil_div, operation, require_shapes
from clalign.engine.kernels_products import KernelProducts
from clalign.errors import InputError

CHECK_STEPS = 32
"""Depth after which a tile of the nearest points is checked: can one of its scores still be the best of its row?"""

LEAST_CHECKED = 1.5
"""Depth, in units of `CHECK_STEPS`, from which checks are made: tail norms cost a pass over all rows."""

MANY_ROWS = 8
"""Work-items of each unit that the larger number of row groups must leave."""

DISTORTION_ROWS = 64
"""Rows of a distance matrix that one work-item of the batched distortion sums."""


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
        width = self.device.panel_width
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
        return index, score

    @operation
    def soft_map_argmax(self, c: Array, psi: Array, w: Array, *, out: ArrayPair | None = None) -> ArrayPair:
        (n, k), n_y = c.shape, psi.shape[0]
        require_shapes("soft_map_argmax", psi=(psi.shape[1:], (k,)), w=(w.shape, (n_y,)))
        index = self._result("soft_map_argmax", (n,), out and out[0], np.int32)
        score = self._result("soft_map_argmax", (n,), out and out[1])
        groups = self._nearest_groups(n)
        packed = self._pack_panels("right", psi, n_y, k, 1, k)
        kernel = self.device.kernel("soft_map_argmax", "soft_map_argmax", RT=self._tile, GROUPS=groups)
        self.device.launch(kernel, ceil_div(n, groups * self._tile), n, n_y, k, c, packed, w, index, score)
        return index, score

    def _nearest_groups(self, rows: int) -> int:
        """Row groups of one work-item: the more, the fewer times all points are read, as long as every unit is busy."""
        usual, most = self.device.constants.nearest_groups
        return most if ceil_div(rows, self._tile) >= most * MANY_ROWS * self.device.facts.units else usual

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
        rows = self.device.scratch("maps", maps * m, np.int32)
        parts = ceil_div(m, DISTORTION_ROWS)
        partial = self.device.scratch("partial", parts * maps)
        defines = self._candidate_defines(floor)
        launch, kernel = self.device.launch, self.device.kernel
        launch(kernel("candidates", "transpose_maps", **defines), maps, m, maps, index, rows)
        scores = kernel("candidates", "distortion_parts", **defines)
        launch(scores, (parts, maps), m, p, parts, dx, dy, w, rows, partial)
        launch(kernel("reduce", "finish_rows", RB=PART), maps, maps, parts, partial, result)
        return result

    @operation
    def map_distance(self, dx: Array, w: Array, index: Array, *, out: Array | None = None) -> Array:
        m, maps = index.shape
        p = dx.shape[0]
        require_shapes("map_distance", dx=(dx.shape, (p, p)), w=(w.shape, (m,)))
        result = self._result("map_distance", (maps, maps), out)
        kernel = self.device.kernel("candidates", "map_distance", **self._candidate_defines())
        self.device.launch(kernel, (ceil_div(maps, self.device.panel_width), maps), m, maps, p, dx, w, index, result)
        return result

    def _candidate_defines(self, floor: float | None = None) -> dict[str, str | int]:
        defines: dict[str, str | int] = {"DB": DISTORTION_ROWS}
        suffix = "f" if self.dtype.itemsize == 4 else ""
        return defines if floor is None else {**defines, "FLOOR": f"{float(floor)!r}{suffix}"}
