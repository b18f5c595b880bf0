"""Pictures of a match and of functions on shapes, drawn without a display."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clalign.correspondence import Correspondence
from clalign.mesh.front import Up, front_view
from clalign.presentation.camera import facing_rotation
from clalign.presentation.raster import png_bytes, rasterise, with_word, write_png
from clalign.transfer.colours import UNMATCHED, carried_colours, position_colours
from clalign.transfer.surface_map import surface_map

_MARGIN = 0.05


def save_match_picture(
    correspondence: Correspondence, path: str | Path, *, height: int = 900, up: Up | None = None
) -> None:
    """Save a PNG of both shapes, source left, with the target's colours carried to the source by the map.

    The picture is `height` pixels high; `up` is the coordinate axis of the target that points up, if the guess from its
    extent is wrong.
    """
    write_png(path, match_image(correspondence, height=height, up=up))


def match_png(correspondence: Correspondence, *, height: int = 480, up: Up | None = None) -> bytes:
    """Return the picture of `save_match_picture` as the bytes of a PNG file."""
    return png_bytes(match_image(correspondence, height=height, up=up))


def match_image(correspondence: Correspondence, *, height: int = 900, up: Up | None = None) -> NDArray[np.uint8]:
    """Return the picture of `save_match_picture` as an (height, width, 3) uint8 array."""
    meshes, views = (correspondence.source, correspondence.target), pair_views(correspondence, up)
    shapes = [
        (mesh.vertices @ view.T, mesh.faces, colours)
        for mesh, view, colours in zip(meshes, views, pair_colours(correspondence, views[1]), strict=True)
    ]
    return draw_row(shapes, height, words=("source", "target"))


def pair_views(correspondence: Correspondence, up: Up | None = None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (3, 3) rotations of source and target to viewing axes in which the source faces like the target."""
    source, target = correspondence.source.vertices, correspondence.target.vertices
    view, to_target = front_view(target, up), surface_map(correspondence)
    matched = to_target.matched
    if np.count_nonzero(matched) < 3:
        return view, view
    return view @ facing_rotation(source[matched], to_target.pull(target)[matched]), view


def pair_colours(
    correspondence: Correspondence, view: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (n, 3) colours of source and target: by place on the target (`view` turns it), carried to the source.

    Vertices without a match, on either, are grey.
    """
    colours = position_colours(correspondence.target.vertices, view)
    matched = surface_map(correspondence, "to_target").matched
    on_target = np.where(matched[:, None], colours, UNMATCHED)
    return carried_colours(colours, surface_map(correspondence)), on_target


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
