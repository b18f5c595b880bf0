"""Labels without speckles: what a map scatters that the shape they come from does not have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from clalign.mesh.mesh import Mesh
from clalign.mesh.topology import edge_table, graph_components, vertex_areas

UNLABELLED = -1
PASSES = 3
"""Over neighbourhoods; a speckle of two vertices is gone after the second."""
SMALLEST_ISLAND = 0.5
"""An island is removed if its area is below this part of that of the smallest one of its label where it comes from."""


@dataclass(frozen=True)
class CleanLabels:
    """Labels of the vertices of a surface.

    Attributes
    ----------
    labels : (n,) int64, -1 for none.
    smoothed : vertices that took the label of most of their neighbourhood.
    islands, in_islands : islands that were removed, and the vertices in them.
    """

    labels: NDArray[np.int64]
    smoothed: int
    islands: int
    in_islands: int

    def sentence(self) -> str:
        """Return what was done, for people."""
        return (
            f"{self.smoothed} vertices took the label of most of their neighbourhood; {self.islands} islands with "
            f"{self.in_islands} vertices were removed"
        )


def without_speckles(
    labels: NDArray[np.int64], mesh: Mesh, origin_labels: NDArray[np.int64], origin: Mesh
) -> CleanLabels:
    """Return carried labels without what the shape that they come from does not have.

    A vertex takes the label of most of its neighbourhood where its own has a smaller share of that than anywhere on the
    origin, unless a label would vanish; and an island of a label that is much smaller than its smallest one there is
    given to the labels around it. So thin lines, single vertices and small regions that were drawn stay.

    Parameters
    ----------
    labels, mesh : (n,) carried labels and their surface; -1 for none, which is left as it is.
    origin_labels, origin : (m,) the labels that were drawn, and their surface.
    """
    least = _least_shares(origin_labels, origin)
    found, table = labels.copy(), _Neighbours.of(mesh)
    for _ in range(PASSES):
        share, best = table.votes(found)
        lost = (found != UNLABELLED) & (best != found) & (share < _looked_up(least, found, 0.0) - 1e-12)
        if not lost.any():
            break
        found[lost] = best[lost]
    vanished = np.isin(labels, np.setdiff1d(labels, found))
    found[vanished] = labels[vanished]
    smoothed = int((found != labels).sum())
    number, component = _islands(found, mesh)
    areas = np.bincount(component, weights=vertex_areas(mesh.vertices, mesh.faces), minlength=number)
    label_of = np.full(number, UNLABELLED)
    label_of[component] = found
    smallest = _smallest_islands(origin_labels, origin)
    small = (label_of != UNLABELLED) & (areas < SMALLEST_ISLAND * _looked_up(smallest, label_of, 0.0))
    for label in np.unique(label_of[small]):
        # A label does not vanish: its largest island stays.
        mine = np.flatnonzero(label_of == label)
        small[mine[np.argmax(areas[mine])]] = False
    gone = small[component]
    filled = found.copy()
    filled[gone] = UNLABELLED
    while (left := gone & (filled == UNLABELLED)).any():
        _, best = table.votes(filled)
        if not (taken := left & (best != UNLABELLED)).any():
            filled[left] = found[left]
            break
        filled[taken] = best[taken]
    return CleanLabels(filled, smoothed, int(small.sum()), int(gone.sum()))


@dataclass(frozen=True)
class _Neighbours:
    """(n, n) 1 for each neighbour of a vertex and for itself."""

    near: sparse.csr_matrix

    @staticmethod
    def of(mesh: Mesh) -> _Neighbours:
        edges = edge_table(mesh.faces, mesh.n_vertices).edges
        own = np.arange(mesh.n_vertices)
        rows, columns = np.concatenate([edges[:, 0], edges[:, 1], own]), np.concatenate([edges[:, 1], edges[:, 0], own])
        return _Neighbours(sparse.coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(own),) * 2).tocsr())

    def votes(self, labels: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """The share of each vertex' own label in its neighbourhood (n,), and the label with the largest one (n,)."""
        known = labels != UNLABELLED
        names, place = np.unique(labels[known], return_inverse=True)
        if not len(names):
            return np.zeros(len(labels)), labels.copy()
        marks = sparse.coo_matrix(
            (np.ones(len(place)), (np.flatnonzero(known), place.reshape(-1))), shape=(len(labels), len(names))
        ).tocsr()
        votes = (self.near @ marks).tocoo()
        total = np.bincount(votes.row, weights=votes.data, minlength=len(labels))
        order = np.lexsort((votes.col, -votes.data, votes.row))
        rows, first = np.unique(votes.row[order], return_index=True)
        best = np.full(len(labels), UNLABELLED)
        best[rows] = names[votes.col[order][first]]
        own = np.zeros(len(labels))
        mine = names[votes.col] == labels[votes.row]
        own[votes.row[mine]] = votes.data[mine]
        return np.divide(own, total, out=np.zeros(len(labels)), where=total > 0), best


def _least_shares(labels: NDArray[np.int64], mesh: Mesh) -> dict[int, float]:
    share, _ = _Neighbours.of(mesh).votes(labels)
    return {int(label): float(share[labels == label].min()) for label in np.unique(labels) if label != UNLABELLED}


def _islands(labels: NDArray[np.int64], mesh: Mesh) -> tuple[int, NDArray[np.int64]]:
    """Parts of a surface in which vertices hang together with their label: how many, and the part of each vertex."""
    one, other = edge_table(mesh.faces, mesh.n_vertices).edges.T
    same = labels[one] == labels[other]
    return graph_components(mesh.n_vertices, one[same], other[same])


def _smallest_islands(labels: NDArray[np.int64], mesh: Mesh) -> dict[int, float]:
    number, component = _islands(labels, mesh)
    areas = np.bincount(component, weights=vertex_areas(mesh.vertices, mesh.faces), minlength=number)
    smallest: dict[int, float] = {}
    for label, area in zip(labels.tolist(), areas[component].tolist(), strict=True):
        smallest[label] = min(area, smallest.get(label, np.inf))
    return smallest


def _looked_up(table: dict[int, float], labels: NDArray[np.int64], missing: float) -> NDArray[np.float64]:
    return np.array([table.get(label, missing) for label in labels.tolist()])
