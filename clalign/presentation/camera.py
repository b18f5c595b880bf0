"""Which way to look at two shapes: the front of one, and the rotation that makes the other face alike."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_SMALLEST_ANGLE = np.deg2rad(45.0)


def facing_rotation(source: NDArray[np.floating], target: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the rotation that makes source points face like their target points (identity if it is small).

    Parameters
    ----------
    source, target : (n, 3) float, row i of one belonging to row i of the other.

    Returns
    -------
    (3, 3) float64 rotation of the best rigid fit (Kabsch) if its angle is more than 45 degrees, else the identity.
    """
    moment = (np.asarray(target) - np.mean(target, axis=0)).T @ (np.asarray(source) - np.mean(source, axis=0))
    left, _, right = np.linalg.svd(moment)
    left[:, 2] *= np.sign(np.linalg.det(left @ right))
    rotation = left @ right
    angle = np.arccos(np.clip((np.trace(rotation) - 1.0) / 2.0, -1.0, 1.0))
    return np.asarray(rotation) if angle > _SMALLEST_ANGLE else np.eye(3)
