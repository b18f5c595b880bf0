"""Triple products n · (∇f × ∇g): what tells a map from its mirror image (Shtern & Kimmel 2014).

An orientation-preserving isometry carries ω(f, g) = n · (∇f × ∇g) along with f and g; a mirrored one changes its sign.
The products of the low eigenfunctions are expanded once in the eigenfunctions (`operators.orientation_tensor`), so no
candidate costs a pass over the faces.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def carried_products(
    functional: NDArray[np.floating], tensor: NDArray[np.float64], pairs: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Return (B, len(pairs), p): coefficients of ω_Y(C e_a, C e_b) for each pair (a, b).

    Parameters
    ----------
    functional : (B, k, k'), columns up to the largest index in `pairs`.
    tensor : (q, q, q) of Y.
    """
    size = min(functional.shape[1], tensor.shape[0])
    used = int(pairs.max()) + 1
    columns = np.ascontiguousarray(functional[:, :size, :used].transpose(0, 2, 1), dtype=np.float32)
    core = tensor[:size, :size].astype(np.float32)
    depth = core.shape[2]
    half = (columns.reshape(-1, size) @ core.reshape(size, size * depth)).reshape(-1, used, size, depth)
    products = np.empty((functional.shape[0], len(pairs), depth), dtype=np.float32)
    for number, (a, b) in enumerate(pairs):
        products[:, number] = np.matmul(columns[:, b, None, :], half[:, a])[:, 0]
    return products


def index_pairs(first: int, last: int) -> NDArray[np.int64]:
    """Return all (a, b) with first ≤ a < b ≤ last, as (pairs, 2); there may be none."""
    pairs = [(a, b) for a in range(first, last + 1) for b in range(a + 1, last + 1)]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def orientation_scores(
    functional: NDArray[np.floating], source: NDArray[np.float64], target: NDArray[np.float64], products: int
) -> NDArray[np.float64]:
    """Return each map's orientation in [−1, 1]: +1 keeps the orientation, −1 mirrors it.

    The normalised inner product of C ω_X(φ_a, φ_b) with ω_Y(C φ_a, C φ_b) over 1 ≤ a < b ≤ `products`.

    Parameters
    ----------
    functional : (B, k, k).
    source, target : (p, p, p) and (q, q, q), see `operators.orientation_tensor`.

    Returns
    -------
    (B,) float64.
    """
    size = min(functional.shape[1], source.shape[0], target.shape[0])
    pairs = index_pairs(1, min(products, size - 1))
    expected = source[pairs[:, 0], pairs[:, 1], :size].astype(np.float32)
    mapped = np.matmul(expected, functional[:, :size, :size].transpose(0, 2, 1))
    carried = carried_products(functional[:, :size], target, pairs)[:, :, :size]
    inner = np.einsum("bpc,bpc->b", mapped, carried)
    norms = np.linalg.norm(mapped, axis=(1, 2)) * np.linalg.norm(carried, axis=(1, 2))
    return (inner / np.maximum(norms, 1e-30)).astype(np.float64)
