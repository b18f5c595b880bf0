"""From the maps of the pairs to a network, and from the network to the pairs that need another map."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from clalign.collection.network import MapEdges, Network, cycle_errors, cycle_weights, synchronise
from clalign.collection.store import PairRow, Store
from clalign.correspondence import finite_or_none
from clalign.maps.functional_maps import polar_factor
from clalign.rules import CollectionRules

NETWORK_BYTES = 4e9
"""Maps of the network in memory at most; a larger set is joined over fewer functions."""


@dataclass(frozen=True)
class NetworkCheck:
    """What the network says of the pairs.

    Attributes
    ----------
    network : the rotations.
    rows : the direct rows with their cycle and network errors filled in.
    wrong : places in `rows` of the maps that contradict the network.
    digest : short text that differs when the network does.
    """

    network: Network
    rows: tuple[PairRow, ...]
    wrong: tuple[int, ...]
    digest: str


def checked_by_network(
    store: Store, names: Sequence[str], rows: Sequence[PairRow], rules: CollectionRules
) -> NetworkCheck:
    """Synchronise the maps of all direct rows that are "ok", and find those that contradict the rest.

    Parameters
    ----------
    store : has the maps.
    names : of the shapes; the network numbers them so.
    rows : of matched pairs.
    """
    number = {name: index for index, name in enumerate(names)}
    used = [index for index, row in enumerate(rows) if row.ok]
    size = max(2, int(np.sqrt(NETWORK_BYTES / (8 * max(len(used), 1)))))
    maps = [
        store.read_maps("pairs", rows[index].source, rows[index].target).functional_map[:size, :size].copy()
        for index in used
    ]
    size = min((len(functional) for functional in maps), default=1)
    edges = MapEdges(
        len(names),
        np.array([(number[rows[i].source], number[rows[i].target]) for i in used], dtype=np.int64).reshape(-1, 2),
        polar_factor(np.stack([functional[:size, :size] for functional in maps])) if maps else np.ones((0, 1, 1)),
        np.ones(len(used)),
    )
    cycles = cycle_errors(edges)
    confidence = np.array([rows[index].confidence or 0.0 for index in used])
    network = synchronise(replace(edges, weights=cycle_weights(confidence, cycles, rules)), rules)
    checked_rows = list(rows)
    for place, index in enumerate(used):
        checked_rows[index] = replace(
            rows[index],
            cycle_error=finite_or_none(cycles[place]),
            network_error=finite_or_none(network.residuals[place]),
        )
    contradicting = tuple(index for place, index in enumerate(used) if network.residuals[place] > rules.wrong)
    # Rounded, so that the last bits of a sum in another order do not make everything be derived again.
    digest = hashlib.sha256(np.round(network.frames, 6).tobytes()).hexdigest()[:16]
    return NetworkCheck(network, tuple(checked_rows), contradicting, digest)


def missing_pairs(network: Network, names: Sequence[str], matched: set[frozenset[str]]) -> list[tuple[str, str]]:
    """Return the pairs of shapes, by name, that the network joins and that were not matched."""
    joined = network.component[:, None] == network.component
    pairs = ((names[i], names[j]) for i, j in np.argwhere(np.triu(joined, 1)).tolist())
    return [pair for pair in pairs if frozenset(pair) not in matched]
