"""Nearest points and scores of candidate maps on the device."""

from __future__ import annotations

import numpy as np

from clalign.engine.backend import RELATIVE_DISTANCE_FLOOR, DistortionKind
from clalign.engine.device import DeviceArray
from clalign.engine.kernels_arrays import PART, ceil_div, require_shapes
from clalign.engine.kernels_products import KernelProducts
from clalign.errors import InputError

BOUND = 32
"""Depth after which a tile of the nearest points is checked: can one of its scores still be the best of its row?"""

WORTH_A_CHECK = 1.5
"""Depth, in units of `BOUND`, from which checks are made: norms of what is left cost a pass over all rows."""

ROWS_OF_PART = 64
"""Rows of a distance matrix that one work-item of the batched distortion sums."""


class KernelSearches(KernelProducts):
    """`backend.Searches` on a device; see there for the formulas."""

    def nearest(
        self,
        queries: DeviceArray,
        points: DeviceArray,
        penalty: DeviceArray | None = None,
        *,
        absolute: bool = False,
        guess: DeviceArray | None = None,
        out: tuple[DeviceArray, DeviceArray] | None = None,
    ) -> tuple[DeviceArray, DeviceArray]:
        """Index and score of the point of largest score; ties to the lowest index."""
        (m, depth), p = queries.shape, points.shape[0]
        require_shapes("nearest", points=(points.shape[1:], (depth,)))
        if penalty is not None:
            require_shapes("nearest", penalty=(penalty.shape, (p,)))
        if guess is not None:
            require_shapes("nearest", guess=(guess.shape, (m,)))
        index = self._result("nearest", (m,), out and out[0], np.int32)
        score = self._result("nearest", (m,), out and out[1])
        lanes = self.device.lanes
        padded_size = ceil_div(p, lanes) * lanes
        groups = self._nearest_groups(ceil_div(m, self._tile))
        checks = 0 if absolute or depth < WORTH_A_CHECK * BOUND else ceil_div(depth, BOUND) - 1
        defines: dict[str, str | int] = {
            "RT": self._tile,
            "NEAREST_GROUPS": groups,
            "ABSOLUTE": int(absolute),
            "BOUND": BOUND,
        }
        padded = self.device.scratch("penalty", padded_size)
        launch, kernel = self.device.launch, self.device.kernel
        launch(kernel("nearest", "pad_penalty", **defines), padded_size, p, padded_size, penalty, padded)
        packed = self._pack_panels("right", points, p, depth, 1, depth)
        query_rest = point_rest = guessed = None
        if checks:
            rows = ceil_div(m, self._tile) * self._tile
            query_rest = self.device.scratch("rests.queries", rows * checks)
            launch(kernel("nearest", "query_rests", **defines), rows, m, depth, checks, queries, query_rest)
            point_rest = self.device.scratch("rests.points", padded_size * checks)
            panels = padded_size // lanes
            launch(kernel("nearest", "point_rests", **defines), panels, panels, depth, checks, packed, point_rest)
            if guess is not None:
                guessed = self.device.scratch("guessed", rows)
                scores = kernel("nearest", "guessed_scores", **defines)
                launch(scores, rows, m, p, depth, queries, packed, padded, guess, guessed)
        items = ceil_div(m, groups * self._tile)
        sides = (queries, packed, padded, query_rest, point_rest, guessed)
        launch(kernel("nearest", "nearest", **defines), items, m, p, depth, checks, *sides, index, score)
        return index, score

    def _nearest_groups(self, row_groups: int) -> int:
        """Row groups of one work-item: the more, the fewer times all points are read, as long as every unit is busy."""
        if self.device.group > 1:
            return 1
        return 32 if row_groups >= 32 * 8 * self.device.facts.units else 8

    def distortion_batch(
        self,
        dx: DeviceArray,
        dy: DeviceArray,
        w: DeviceArray,
        index: DeviceArray,
        kind: DistortionKind = "squared",
        *,
        out: DeviceArray | None = None,
    ) -> DeviceArray:
        """Σ_il w_i w_l e(dx[T_i, T_l], dy[i, l]) for every column T of index."""
        if kind not in ("squared", "relative"):
            raise InputError(f"distortion_batch: kind must be squared or relative, got {kind!r}")
        m, maps = index.shape
        p = dx.shape[0]
        require_shapes("distortion_batch", dx=(dx.shape, (p, p)), dy=(dy.shape, (m, m)), w=(w.shape, (m,)))
        result = self._result("distortion_batch", (maps,), out)
        rows = self.device.scratch("maps", maps * m, np.int32)
        parts = ceil_div(m, ROWS_OF_PART)
        partial = self.device.scratch("partial", parts * maps)
        defines = self._candidate_defines(kind)
        launch, kernel = self.device.launch, self.device.kernel
        launch(kernel("candidates", "transpose_maps", **defines), maps, m, maps, index, rows)
        scores = kernel("candidates", "distortion_parts", **defines)
        launch(scores, (parts, maps), m, p, parts, dx, dy, w, rows, partial)
        launch(kernel("reduce", "finish_rows", RB=PART), maps, maps, parts, partial, result)
        return result

    def map_distance(
        self, dx: DeviceArray, w: DeviceArray, index: DeviceArray, *, out: DeviceArray | None = None
    ) -> DeviceArray:
        """Σ_i w_i dx[index[i, a], index[i, b]]."""
        m, maps = index.shape
        p = dx.shape[0]
        require_shapes("map_distance", dx=(dx.shape, (p, p)), w=(w.shape, (m,)))
        result = self._result("map_distance", (maps, maps), out)
        kernel = self.device.kernel("candidates", "map_distance", **self._candidate_defines("squared"))
        self.device.launch(kernel, (ceil_div(maps, self.device.lanes), maps), m, maps, p, dx, w, index, result)
        return result

    def _candidate_defines(self, kind: DistortionKind) -> dict[str, str | int]:
        suffix = "f" if self.dtype.itemsize == 4 else ""
        floor = f"{RELATIVE_DISTANCE_FLOOR}{suffix}"
        return {"RELATIVE": int(kind == "relative"), "DB": ROWS_OF_PART, "FLOOR": floor}
