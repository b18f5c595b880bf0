"""Pictures of a match and of functions on shapes, drawn without a display."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clalign.correspondence import Correspondence
from clalign.presentation.camera import Up, facing_rotation, front_view
from clalign.presentation.raster import png_bytes, rasterise, with_word, write_png
from clalign.transfer.colours import carried_colours, position_colours
from clalign.transfer.surface_map import SurfaceMap, surface_map

_MARGIN = 0.05


def save_match_picture(
    correspondence: Correspondence, path: str | Path, *, height: int = 900, up: Up | None = None
) -> None:
    """Save a PNG of both shapes, source left, with the target's colours carried to the source by the map.

    Parameters
    ----------
    correspondence : the match.
    path : where to write the PNG file.
    height : of the picture, in pixels.
    up : coordinate axis of the target that points up, if the guess from its extent is wrong.
    """
    write_png(path, match_image(correspondence, height=height, up=up))


def match_png(correspondence: Correspondence, *, height: int = 480, up: Up | None = None) -> bytes:
    """Return the picture of `save_match_picture` as the bytes of a PNG file."""
    return png_bytes(match_image(correspondence, height=height, up=up))


def match_image(correspondence: Correspondence, *, height: int = 900, up: Up | None = None) -> NDArray[np.uint8]:
    """Return the picture of `save_match_picture` as an (height, width, 3) uint8 array."""
    source, target = correspondence.source, correspondence.target
    view = front_view(target.vertices, up)
    to_target = surface_map(correspondence)
    target_colours = position_colours(target.vertices, view)
    source_colours = carried_colours(target_colours, to_target)
    source_view = view @ map_rotation(source.vertices, target.vertices, to_target)
    return draw_row(
        [
            (source.vertices @ source_view.T, source.faces, source_colours),
            (target.vertices @ view.T, target.faces, target_colours),
        ],
        height,
        words=("source", "target"),
    )


def map_rotation(
    source: NDArray[np.floating], target: NDArray[np.floating], to_target: SurfaceMap
) -> NDArray[np.float64]:
    """Return the rotation that lets the source face like the target (identity where they already do)."""
    matched = to_target.matched
    if np.count_nonzero(matched) < 3:
        return np.eye(3)
    return facing_rotation(source[matched], to_target.pull(target)[matched])


def draw_row(
    shapes: Sequence[tuple[NDArray[np.float64], NDArray[np.integer], NDArray[np.float64]]],
    height: int,
    *,
    words: Sequence[str] = (),
) -> NDArray[np.uint8]:
    """Draw shapes side by side at one scale.

    Parameters
    ----------
    shapes : for each the vertices (n, 3) in viewing coordinates (right, up, towards the viewer), faces (m, 3) and
        colours (n, 3) in [0, 1].
    height : of the picture, in pixels.
    words : one below each shape, where the picture is high enough; none if empty.

    Returns
    -------
    (height, width, 3) uint8, on white.
    """
    tallest = max(float(np.ptp(vertices[:, 1])) for vertices, _, _ in shapes)
    widest = max(float(np.ptp(vertices[:, 0])) for vertices, _, _ in shapes)
    margin = round(_MARGIN * height)
    # A wide, low shape must not make the picture many times wider than high.
    scale = (height - 2 * margin) / max(tallest, 0.4 * widest, 1e-300)
    panels = []
    for vertices, faces, colours in shapes:
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        width = int(np.ceil((high[0] - low[0]) * scale)) + 2 * margin
        placed = (vertices - (low + high) / 2) * scale + (width / 2, height / 2, 0.0)
        panels.append(rasterise(placed, faces, colours, (width, height)))
    if words:
        panels = [with_word(panel, word, margin) for panel, word in zip(panels, words, strict=True)]
    return np.concatenate(panels, axis=1)
