"""Which side of a shape is its front, and which way is up, guessed from its extent."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

Up = Literal["x", "y", "z"]

_TIGHTER_BOX = 1.6
_CLEARLY_LONGER = 2.0


def front_view(vertices: NDArray[np.floating], up: Up | None = None) -> NDArray[np.float64]:
    """Return the rotation to viewing axes (right, up, towards the viewer) that shows a shape from its broad side.

    The shape is seen along the direction in which it is thinnest. Coordinate axes are kept where the bounding box
    along them is about as tight as along the principal axes, since then the file's axes mean something; y is up unless
    the thin direction is y (then z is).

    Parameters
    ----------
    vertices : (n, 3) float.
    up : coordinate axis that points up, if it is known.

    Returns
    -------
    (3, 3) float64 rotation: ``vertices @ rotation.T`` are viewing coordinates.
    """
    points = np.asarray(vertices, dtype=np.float64)
    points = points - points.mean(axis=0)
    extent = np.ptp(points, axis=0)
    if up is None:
        _, _, principal = np.linalg.svd(points, full_matrices=False)
        principal_extent = np.ptp(points @ principal.T, axis=0)
        if extent.prod() > _TIGHTER_BOX * principal_extent.prod() > 0:
            return _principal_view(principal)
    axes = np.eye(3)
    spread = points.std(axis=0)
    if up is not None:
        upward = "xyz".index(up)
        toward = min((axis for axis in range(3) if axis != upward), key=lambda axis: spread[axis])
    else:
        toward = int(np.argmin(spread))
        upward = {0: 2 if extent[2] > _CLEARLY_LONGER * extent[1] else 1, 1: 2, 2: 1}[toward]
    # With z up, shapes face the negative y axis by custom; otherwise they face the positive side of the thin axis.
    facing = -axes[toward] if (upward, toward) == (2, 1) else axes[toward]
    return np.stack([np.cross(axes[upward], facing), axes[upward], facing])


def _principal_view(principal: NDArray[np.float64]) -> NDArray[np.float64]:
    upward, right = principal[0], principal[1]
    # The longest direction goes up, with the sign of its largest coordinate, so that the view is reproducible.
    upward = upward * np.sign(upward[np.argmax(np.abs(upward))])
    right = right * np.sign(right[np.argmax(np.abs(right))])
    return np.stack([right, upward, np.cross(right, upward)])
