"""Consistent maps over a set: rotations of every shape to one latent basis, and the cycles that find wrong pairs.

A map network has an orthogonal C_ij for some pairs of shapes. It is consistent around every cycle exactly if there are
rotations Q_i, from one latent basis to the basis of each shape, with C_ij = Q_j Q_iᵀ. The best ones are found by
spectral synchronisation: with W the symmetric block matrix of the weighted C_ij and D the weights' sums, the leading
eigenvectors of D^-½ W D^-½ hold √d_i Q_i in their blocks, up to one rotation of the latent basis.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

from clalign.maps.functional_maps import polar_factor
from clalign.rules import CollectionRules

_ITERATIONS = 2000
_TOLERANCE = 1e-10
_CHUNK = 2048


@dataclass(frozen=True)
class MapEdges:
    """The functional maps of some pairs among n shapes.

    Attributes
    ----------
    count : n.
    pairs : (E, 2) int64, first and second shape of each pair; no pair twice, in neither order.
    maps : (E, K, K) float64, orthogonal C taking coefficients on the first shape to coefficients on the second.
    weights : (E,) float64, positive: how far each is trusted.
    """

    count: int
    pairs: NDArray[np.int64]
    maps: NDArray[np.float64]
    weights: NDArray[np.float64]

    @property
    def size(self) -> int:
        """K, the number of functions on every shape."""
        return self.maps.shape[1]

    @cached_property
    def numbers(self) -> dict[tuple[int, int], int]:
        """The row of each pair."""
        return {(i, j): edge for edge, (i, j) in enumerate(self.pairs.tolist())}

    def between(self, first: int, second: int) -> NDArray[np.float64]:
        """Return the map from one shape to another, in whichever order the pair is given."""
        edge = self.numbers.get((first, second))
        return self.maps[self.numbers[second, first]].T if edge is None else self.maps[edge]


@dataclass(frozen=True)
class Network:
    """Rotations of all shapes to one latent basis.

    Attributes
    ----------
    frames : (n, K, K) float64, orthogonal Q_i taking latent coefficients to those on shape i.
    component : (n,) int64; maps exist between shapes of equal number, which pairs join to each other.
    residuals : (E,) float64, deviation (see `deviation`) of each given map from the network's.
    weights : (E,) float64, what each given map was worth in the end.
    """

    frames: NDArray[np.float64]
    component: NDArray[np.int64]
    residuals: NDArray[np.float64]
    weights: NDArray[np.float64]

    def functional(self, first: int, second: int) -> NDArray[np.float64]:
        """Return the (K, K) map Q_j Q_iᵀ, which agrees with all others around every cycle.

        Raises
        ------
        ValueError
            No chain of pairs joins the two shapes.
        """
        if self.component[first] != self.component[second]:
            raise ValueError(f"no chain of pairs joins the shapes {first} and {second}")
        return np.asarray(self.frames[second] @ self.frames[first].T)

    @cached_property
    def digest(self) -> str:
        """Short text that differs when the network does."""
        # Rounded, so that the last bits of a sum in another order do not make everything be derived again.
        return hashlib.sha256(np.round(self.frames, 6).tobytes()).hexdigest()[:16]


def deviation(difference: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return |C − C'|_F / √(2K) of differences (..., K, K) of orthogonal maps.

    0 for equal maps, about 1 for unrelated ones and for a left-right flip, which changes the sign of half of the
    functions of a symmetric body.
    """
    size = difference.shape[-1]
    return np.asarray(np.linalg.norm(difference, axis=(-2, -1)) / np.sqrt(2.0 * size))


def synchronise(edges: MapEdges, rules: CollectionRules) -> Network:
    """Find the rotations that explain the maps best, without being led astray by wrong ones.

    Every reweighting solves the spectral problem and weighs each map by its deviation r from the result, by
    1 / (1 + r²/s²)² (Geman and McClure) with s the median deviation, so that a map that contradicts the others soon
    counts for nothing.

    Parameters
    ----------
    edges : the given maps.
    rules : `reweightings` 0 trusts the given weights.
    """
    component = components(edges.count, edges.pairs)
    weights = edges.weights
    frames = _spectral_frames(edges)
    residuals = _residuals(edges, frames)
    for _ in range(rules.reweightings):
        spread = max(float(np.median(residuals)) if residuals.size else 0.0, rules.smallest_spread)
        weights = edges.weights * np.maximum((1.0 + (residuals / spread) ** 2) ** -2.0, rules.least_weight)
        frames = _spectral_frames(replace(edges, weights=weights))
        before, residuals = residuals, _residuals(edges, frames)
        if np.abs(residuals - before).max(initial=0.0) < 1e-6:
            break
    return Network(frames, component, residuals, weights)


def cycle_errors(edges: MapEdges, *, most: int = 24, seed: int = 0) -> NDArray[np.float64]:
    """Return for every pair the median deviation of C_kj C_ik from C_ij over third shapes k.

    Parameters
    ----------
    edges : the given maps.
    most : third shapes looked at a pair; drawn with `seed` where there are more.

    Returns
    -------
    (E,) float64; NaN for pairs in no triangle.
    """
    neighbours: list[set[int]] = [set() for _ in range(edges.count)]
    for i, j in edges.numbers:
        neighbours[i].add(j)
        neighbours[j].add(i)
    draw = np.random.default_rng(seed)
    errors = np.full(len(edges.pairs), np.nan)

    for (i, j), edge in edges.numbers.items():
        thirds = np.array(sorted(neighbours[i] & neighbours[j]), dtype=np.int64)
        if thirds.size > most:
            thirds = draw.choice(thirds, most, replace=False)
        if thirds.size:
            around = np.stack([edges.between(k, j) @ edges.between(i, k) for k in thirds.tolist()])
            errors[edge] = np.median(deviation(around - edges.maps[edge]))
    return errors


def cycle_weights(
    confidence: NDArray[np.float64], errors: NDArray[np.float64], rules: CollectionRules
) -> NDArray[np.float64]:
    """Return what each map is worth before the network is known: its confidence, less where its cycles do not close.

    Parameters
    ----------
    confidence : (E,) in [0, 1].
    errors : (E,) of `cycle_errors`; a pair in no cycle keeps its confidence.
    """
    known = np.isfinite(errors)
    spread = max(float(np.quantile(errors[known], 0.25)) if known.any() else 0.0, rules.smallest_spread)
    doubt = np.where(known, np.nan_to_num(errors) / spread, 0.0)
    trusted = np.clip(confidence, rules.least_confidence, 1.0)
    return np.asarray(trusted * np.maximum((1.0 + doubt**2) ** -2.0, rules.least_weight))


def components(count: int, pairs: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return (count,) numbers of the groups that chains of pairs join."""
    return np.asarray(connected_components(_graph(count, pairs, np.ones(len(pairs))), directed=False)[1], np.int64)


def spanning_tree(count: int, pairs: NDArray[np.int64], cost: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the pairs (as rows of `pairs`) of a spanning forest of least cost; ties go to the earlier row."""
    order = np.argsort(cost, kind="stable")
    # A tree depends on the order of the costs alone, and ranks from 1 have neither ties nor zeros, scipy's "no edge".
    rank = np.argsort(order) + 1
    return np.sort(order[minimum_spanning_tree(_graph(count, pairs, rank)).data.astype(np.int64) - 1])


def _graph(count: int, pairs: NDArray[np.int64], values: NDArray[Any]) -> Any:
    return coo_array((values, (pairs[:, 0], pairs[:, 1])), shape=(count, count)).tocsr()


def _spectral_frames(edges: MapEdges) -> NDArray[np.float64]:
    """Return (n, K, K) frames; shapes that no chain of pairs joins are solved apart, each group in its own basis."""
    frames = np.tile(np.eye(edges.size), (edges.count, 1, 1))
    component = components(edges.count, edges.pairs)
    for label in range(component.max() + 1):
        members = np.flatnonzero(component == label)
        if members.size > 1:
            inside = component[edges.pairs[:, 0]] == label
            pairs = np.searchsorted(members, edges.pairs[inside])
            group = MapEdges(members.size, pairs, edges.maps[inside], edges.weights[inside])
            frames[members] = _connected_frames(group)
    return frames


def _connected_frames(edges: MapEdges) -> NDArray[np.float64]:
    """Subspace iteration on (I + D^-½ W D^-½) / 2, then the polar factor of every block.

    The shift by the identity keeps the eigenvalues of a star or a tree, which come in pairs ±λ, apart. The iteration
    starts from the maps along the most trusted tree, which is the answer already where there are no cycles.
    """
    degree = np.zeros(edges.count)
    for side in (0, 1):
        np.add.at(degree, edges.pairs[:, side], edges.weights)
    scaled = edges.weights / np.sqrt(degree[edges.pairs[:, 0]] * degree[edges.pairs[:, 1]])
    basis = _tree_frames(edges) * np.sqrt(degree)[:, None, None]
    shape = basis.shape
    basis = np.linalg.qr(basis.reshape(-1, edges.size))[0]
    for _ in range(_ITERATIONS):
        turned = 0.5 * (basis + _multiplied(edges, scaled, basis.reshape(shape)).reshape(basis.shape))
        new = np.linalg.qr(turned)[0]
        change = float(np.linalg.norm(new - basis @ (basis.T @ new)))
        basis = new
        if change < _TOLERANCE * np.sqrt(edges.size):
            break
    return polar_factor(basis.reshape(shape))


def _tree_frames(edges: MapEdges) -> NDArray[np.float64]:
    """Return (n, K, K) frames of a connected network: from the identity on shape 0 along the most trusted tree."""
    kept = spanning_tree(edges.count, edges.pairs, -edges.weights)
    tree = _graph(edges.count, edges.pairs[kept], np.ones(len(kept)))
    order, parents = breadth_first_order(tree, 0, directed=False)
    frames = np.tile(np.eye(edges.size), (edges.count, 1, 1))
    for here in order[1:].tolist():
        frames[here] = edges.between(int(parents[here]), here) @ frames[parents[here]]
    return frames


def _multiplied(edges: MapEdges, scaled: NDArray[np.float64], blocks: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the weighted block matrix times (n, K, K) blocks, some pairs at a time."""
    product = np.zeros_like(blocks)
    for start in range(0, len(scaled), _CHUNK):
        part = slice(start, start + _CHUNK)
        first, second = edges.pairs[part].T
        weighted = edges.maps[part] * scaled[part, None, None]
        np.add.at(product, second, weighted @ blocks[first])
        np.add.at(product, first, weighted.transpose(0, 2, 1) @ blocks[second])
    return product


def _residuals(edges: MapEdges, frames: NDArray[np.float64]) -> NDArray[np.float64]:
    residuals = np.empty(len(edges.pairs))
    for start in range(0, len(edges.pairs), _CHUNK):
        part = slice(start, start + _CHUNK)
        first, second = edges.pairs[part].T
        residuals[part] = deviation(edges.maps[part] - frames[second] @ frames[first].transpose(0, 2, 1))
    return residuals
