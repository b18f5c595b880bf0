"""A finished collection: its shapes, its pairs, and the maps between any two shapes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clalign.collection.network import Network
from clalign.collection.store import PairMaps, PairRow, ShapeRow, Store
from clalign.errors import ResultError


@dataclass(frozen=True)
class Collection:
    """What `match_collection` made, in its folder.

    Attributes
    ----------
    store : the folder.
    shapes : one row a shape that was looked at.
    pairs : one row a pair, failed ones included.
    """

    store: Store
    shapes: tuple[ShapeRow, ...]
    pairs: tuple[PairRow, ...]

    @staticmethod
    def load(folder: str | Path) -> Collection:
        """Open the folder of a collection.

        Raises
        ------
        ResultError
            It is not one.
        """
        store = Store(folder)
        store.settings()
        return Collection(store, tuple(store.shapes.read()), tuple(store.pairs.read()))

    @property
    def folder(self) -> Path:
        """The folder."""
        return self.store.folder

    @property
    def failures(self) -> tuple[str, ...]:
        """One sentence for each shape and pair that failed or was skipped."""
        shapes = tuple(f"{row.name}: {row.message}" for row in self.shapes if not row.ok)
        pairs = tuple(f"{row.source} {row.target}: {row.message}" for row in self.pairs if row.status == "failed")
        return shapes + pairs

    def maps(self, source: str, target: str) -> PairMaps:
        """Return the maps of a pair, repaired or derived where they are so, in whichever order it was matched.

        Raises
        ------
        ResultError
            There is no such pair, or it has no map.
        """
        row = self._rows.get(frozenset((source, target)))
        if row is None:
            raise ResultError(f"{self.folder}: there is no pair {source} {target}; make it with --consistency all")
        if not row.ok:
            raise ResultError(f"{self.folder}: {source} {target} has no map: {row.message}")
        found = self.store.final_maps(row)
        return found if row.source == source else found.reversed()

    def functional_map(self, source: str, target: str) -> NDArray[np.float64]:
        """Return the network's (L, L) map, which agrees with those of all other pairs around every cycle.

        Takes coefficients in the first L LBO functions of the source to those of the target; orthogonal.

        Raises
        ------
        ResultError
            There is no network, no such shape, or no chain of pairs between the two.
        """
        names, network = self._network
        for name in (source, target):
            if name not in names:
                raise ResultError(f"{self.folder}: there is no shape {name!r} in the network")
        try:
            return network.functional(names[source], names[target])
        except ValueError as error:
            raise ResultError(f"{self.folder}: no chain of pairs joins {source} and {target}") from error

    @cached_property
    def _network(self) -> tuple[dict[str, int], Network]:
        names, network = self.store.read_network()
        return {name: index for index, name in enumerate(names)}, network

    @cached_property
    def _rows(self) -> dict[frozenset[str], PairRow]:
        return {frozenset((row.source, row.target)): row for row in self.pairs}
