"""The folder of a collection: settings, index, and for every pair a folder that is whole or not there.

``collection.json`` holds the settings, ``pairs.csv`` and ``shapes.csv`` the index, ``pairs/SOURCE/TARGET/`` the maps
that were matched, ``consistent/SOURCE/TARGET/`` those that the network derived or repaired, ``network.npz`` the
network and ``shapes/`` the prepared shapes.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clalign.collection.members import Member
from clalign.collection.network import Network
from clalign.errors import OptionError, ResultError
from clalign.option_values import flattened
from clalign.options import Options
from clalign.storage.files import replaced_file, text_bytes, write_json
from clalign.storage.folders import atomic_folder, recover
from clalign.storage.rows import RowFile

try:
    import fcntl
except ImportError:  # Windows: two runs in one folder are then not told apart
    fcntl = None  # type: ignore[assignment]

FORMAT = 1
SETTINGS_FILE = "collection.json"
NETWORK_FILE = "network.npz"
PAIR_FILE = "pair.json"
MAPS_FILE = "maps.npz"
RESULT_FOLDER = "result"
CACHE_FOLDER = "shapes"

PAIRS_FILE = "pairs.csv"
SHAPES_FILE = "shapes.csv"

Subfolder = Literal["pairs", "consistent"]
Kind = Literal["direct", "repaired", "derived"]
Status = Literal["ok", "failed", "skipped"]


@dataclass(frozen=True)
class PairRow:
    """What is known of one pair. Lengths in sqrt(area), times in seconds; None, an empty cell, is not known.

    Attributes
    ----------
    source, target : names of the shapes.
    kind : "direct" for a map that was matched, "derived" for one that came from the network alone, "repaired" for one
        that was matched and then replaced because it contradicted the network.
    status : "ok"; "failed"; "skipped" because a shape of the pair failed.
    message : why there is no map.
    confidence, orientation : of the match, see `clalign.Correspondence`.
    distortion : mean change of distances under the map.
    cycle_error, network_error : of the matched map, before any repair: median deviation around triangles, and
        deviation from the network's map (see `clalign.collection.network`).
    total, align, unsup : losses at the kept point.
    seconds : of the work on this pair, all stages together.
    stages : "name=seconds" joined by ";".
    loaded : prepared shapes of the pair that the worker had to fetch from the cache, or compute.
    peak_memory : bytes of the worker process at its largest so far.
    warnings : joined by " | ".
    device : that computed, as it names itself.
    worker : that did the work.
    """

    source: str
    target: str
    kind: Kind = "direct"
    status: Status = "ok"
    message: str = ""
    confidence: float | None = None
    orientation: float | None = None
    distortion: float | None = None
    cycle_error: float | None = None
    network_error: float | None = None
    total: float | None = None
    align: float | None = None
    unsup: float | None = None
    seconds: float | None = None
    stages: str = ""
    loaded: int | None = None
    peak_memory: int | None = None
    warnings: str = ""
    device: str = ""
    worker: str = ""

    @property
    def ok(self) -> bool:
        """Whether there is a map."""
        return self.status == "ok"


@dataclass(frozen=True)
class ShapeRow:
    """What is known of one shape; `eigenvalues` (not in the file) are the first of its LBO that are positive."""

    name: str
    path: str
    status: Status = "ok"
    message: str = ""
    vertices: int | None = None
    faces: int | None = None
    seconds: float | None = None
    notes: str = ""
    eigenvalues: tuple[float, ...] = field(default=(), metadata={"stored": False})

    @property
    def ok(self) -> bool:
        """Whether the shape could be prepared."""
        return self.status == "ok"


@dataclass(frozen=True)
class PairMaps:
    """The maps of one pair.

    Attributes
    ----------
    target_of_source, source_of_target : (file vertices,) int32 in the numbering of the files, -1 for no match.
    functional_map : (L, L) float64, least-squares functional map of both maps in the first L LBO functions.
    """

    target_of_source: NDArray[np.int32]
    source_of_target: NDArray[np.int32]
    functional_map: NDArray[np.float64]

    def reversed(self) -> PairMaps:
        """Return the same maps as those of the reversed pair."""
        return PairMaps(self.source_of_target, self.target_of_source, self.functional_map.T.copy())


def pair_key(source: Member, target: Member, options: Options, more: str = "") -> str:
    """Return a text that differs whenever the maps of a pair may differ."""
    import clalign

    facts = [FORMAT, clalign.__version__, source.digest, target.digest, options.as_dict(), more]
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:24]


def subfolder_of(kind: Kind) -> Subfolder:
    """Return where the pairs of a kind are."""
    return "pairs" if kind == "direct" else "consistent"


class Store:
    """Reads and writes the folder of one collection; `pairs` and `shapes` are its index, one row each."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder).expanduser().absolute()
        self.pairs = RowFile(self.folder / PAIRS_FILE, PairRow)
        self.shapes = RowFile(self.folder / SHAPES_FILE, ShapeRow)

    def begin(self, options: Options, settings: dict[str, Any], *, resume: bool) -> None:
        """Make the folder, or check that it may be gone on with.

        Raises
        ------
        ResultError
            It holds other files, or a collection while `resume` is False, or it cannot be written.
        OptionError
            The collection in it was matched with other options.
        """
        path = self.folder / SETTINGS_FILE
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            held = [entry.name for entry in self.folder.iterdir() if not entry.name.startswith(".")]
        except OSError as error:
            raise ResultError(f"{self.folder}: cannot be used as a folder ({error.strerror})") from error
        if path.is_file():
            if not resume:
                raise ResultError(f"{self.folder}: already holds a collection; give --resume, or another --out")
            self.check_options(options)
        elif held:
            raise ResultError(f"{self.folder}: holds files that are not a collection; choose another --out")
        document = {"format": FORMAT, "options": options.as_dict(), **settings}
        with replaced_file(path) as stream:
            stream.write(text_bytes(json.dumps(document, indent=2, ensure_ascii=False) + "\n"))

    def check_options(self, options: Options) -> None:
        """Refuse other options than those of the collection that is there.

        Raises
        ------
        OptionError
            They differ; the message names them.
        ResultError
            The folder is not a collection.
        """
        before = flattened(self.settings()["options"])
        now = flattened(json.loads(json.dumps(options.as_dict())))
        if before == now:
            return
        changed = [name for name, value in now.items() if before.get(name) != value]
        raise OptionError(
            f"{self.folder}: was matched with other values of {', '.join(changed) or 'the options'}; use the same ones "
            "to go on, or another --out"
        )

    def settings(self) -> dict[str, Any]:
        """Return ``collection.json``.

        Raises
        ------
        ResultError
            The folder is not a collection.
        """
        path = self.folder / SETTINGS_FILE
        try:
            document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError as error:
            raise ResultError(f"{self.folder}: is not a collection, it has no {SETTINGS_FILE}") from error
        except (OSError, ValueError) as error:
            raise ResultError(f"{path}: cannot be read ({error})") from error
        if document.get("format") != FORMAT:
            raise ResultError(f"{path}: has format {document.get('format')!r}, this version reads {FORMAT}")
        return document

    @contextlib.contextmanager
    def lock(self) -> Iterator[None]:
        """Keep other runs out of the folder while the block runs.

        Raises
        ------
        ResultError
            Another run works in it.
        """
        if fcntl is None:
            yield
            return
        handle = os.open(self.folder / ".lock", os.O_RDWR | os.O_CREAT)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(handle)
            raise ResultError(f"{self.folder}: another run works in this folder; wait for its end") from error
        try:
            yield
        finally:
            os.close(handle)

    def pair_folder(self, subfolder: Subfolder, source: str, target: str) -> Path:
        """Return the folder of a pair, whether or not it is there."""
        return self.folder / subfolder / source / target

    def pair_names(self, subfolder: Subfolder) -> Iterator[tuple[str, str]]:
        """Yield source and target of every pair folder that is there, whole or not."""
        for folder in sorted((self.folder / subfolder).glob("*/*")):
            if not folder.name.startswith("."):
                yield folder.parent.name, folder.name

    def finished(self, subfolder: Subfolder, source: str, target: str, key: str) -> PairRow | None:
        """Return the row of a pair whose folder is whole and was written under this key, else None."""
        recover(self.pair_folder(subfolder, source, target))
        try:
            written, row = self._written(subfolder, source, target)
        except ResultError:
            return None
        return row if written == key else None

    def row(self, subfolder: Subfolder, source: str, target: str) -> PairRow:
        """Read the row of a pair as it was written with its maps.

        Raises
        ------
        ResultError
            It is not there or damaged.
        """
        return self._written(subfolder, source, target)[1]

    def _written(self, subfolder: Subfolder, source: str, target: str) -> tuple[str, PairRow]:
        """Read the key and the row of a pair; raises ResultError where they are not there or damaged."""
        path = self.pair_folder(subfolder, source, target) / PAIR_FILE
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
            return document["key"], PairRow(**document["row"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ResultError(f"{path}: cannot be read ({error})") from error

    def write_pair(
        self, subfolder: Subfolder, row: PairRow, key: str, maps: PairMaps, more: Callable[[Path], None] | None = None
    ) -> None:
        """Write the folder of a pair, wholly or not at all.

        Parameters
        ----------
        more : called with the unfinished folder, to add files that belong to the same whole.
        """
        with atomic_folder(self.pair_folder(subfolder, row.source, row.target), PAIR_FILE, force=True) as unfinished:
            np.savez(unfinished / MAPS_FILE, **vars(maps))
            if more is not None:
                more(unfinished)
            write_json(unfinished / PAIR_FILE, {"key": key, "row": asdict(row)}, indent=1)

    def read_maps(self, subfolder: Subfolder, source: str, target: str) -> PairMaps:
        """Read the maps of a pair.

        Raises
        ------
        ResultError
            They are not there or damaged.
        """
        return PairMaps(**_arrays(self.pair_folder(subfolder, source, target) / MAPS_FILE, PairMaps))

    def final_maps(self, row: PairRow) -> PairMaps:
        """Read the maps of a row that is "ok"."""
        return self.read_maps(subfolder_of(row.kind), row.source, row.target)

    def write_network(self, names: Sequence[str], network: Network) -> None:
        """Write ``network.npz``."""
        with replaced_file(self.folder / NETWORK_FILE) as stream:
            arrays = {item.name: getattr(network, item.name) for item in fields(network)}
            np.savez(stream, names=np.array(names), **arrays)

    def read_network(self) -> tuple[list[str], Network]:
        """Return the names of the shapes and their network.

        Raises
        ------
        ResultError
            There is none, or it is damaged.
        """
        arrays = _arrays(self.folder / NETWORK_FILE, Network, "names", way_out="; match with --consistency repair")
        return arrays.pop("names").tolist(), Network(**arrays)


def _arrays(path: Path, kind: type, *more: str, way_out: str = "") -> dict[str, NDArray[Any]]:
    """Read the fields of a dataclass of arrays, and some more, from a file of ``numpy.savez``."""
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            return {name: stored[name] for name in (*more, *(item.name for item in fields(kind)))}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise ResultError(f"{path}: cannot be read ({error}){way_out}") from error


def merged(direct: PairRow, repaired: PairRow) -> PairRow:
    """Return the row of a repaired pair: what the match said, and what the map is now."""
    seconds = (direct.seconds or 0.0) + (repaired.seconds or 0.0)
    stages = ";".join(part for part in (direct.stages, repaired.stages) if part)
    return replace(direct, kind="repaired", distortion=repaired.distortion, seconds=seconds, stages=stages)
