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
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clalign.collection.members import Member
from clalign.collection.network import Network
from clalign.collection.rows import PairRow, plain
from clalign.errors import OptionError, ResultError
from clalign.options import Options
from clalign.storage.files import replaced_file
from clalign.storage.folders import atomic_folder, recover

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

Subfolder = Literal["pairs", "consistent"]


@dataclass(frozen=True)
class PairMaps:
    """The maps of one pair.

    Attributes
    ----------
    target_of_source, source_of_target : (file vertices,) int32 in the numbering of the files, -1 off the surface.
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


class Store:
    """Reads and writes the folder of one collection."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder).expanduser().absolute()

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
            self._check_options(options)
        elif held:
            raise ResultError(f"{self.folder}: holds files that are not a collection; choose another --out")
        document = {"format": FORMAT, "options": options.as_dict(), **settings}
        with replaced_file(path) as stream:
            stream.write((json.dumps(document, indent=2, ensure_ascii=False) + "\n").encode())

    def _check_options(self, options: Options) -> None:
        before = self.settings()["options"]
        now = json.loads(json.dumps(options.as_dict()))
        if before == now:
            return
        changed = [
            f"{group}.{name}" if isinstance(value, dict) else group
            for group, value in now.items()
            for name in (value if isinstance(value, dict) else [""])
            if (
                before.get(group, {}).get(name) != value[name]
                if isinstance(value, dict)
                else before.get(group) != value
            )
        ]
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
        folder = self.pair_folder(subfolder, source, target)
        recover(folder)
        try:
            document = json.loads((folder / PAIR_FILE).read_text(encoding="utf-8"))
            return PairRow(**document["row"]) if document["key"] == key else None
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def write_pair(
        self, subfolder: Subfolder, row: PairRow, key: str, maps: PairMaps, more: Callable[[Path], None] | None = None
    ) -> None:
        """Write the folder of a pair, wholly or not at all.

        Parameters
        ----------
        more : called with the unfinished folder, to add files that belong to the same whole.
        """
        with atomic_folder(self.pair_folder(subfolder, row.source, row.target), PAIR_FILE, force=True) as unfinished:
            np.savez(
                unfinished / MAPS_FILE,
                target_of_source=maps.target_of_source,
                source_of_target=maps.source_of_target,
                functional_map=maps.functional_map,
            )
            if more is not None:
                more(unfinished)
            text = json.dumps({"key": key, "row": plain(row)}, indent=1, ensure_ascii=False, allow_nan=False)
            (unfinished / PAIR_FILE).write_text(text + "\n", encoding="utf-8")

    def read_maps(self, subfolder: Subfolder, source: str, target: str) -> PairMaps:
        """Read the maps of a pair.

        Raises
        ------
        ResultError
            They are not there or damaged.
        """
        path = self.pair_folder(subfolder, source, target) / MAPS_FILE
        try:
            with path.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
                return PairMaps(*(stored[name] for name in ("target_of_source", "source_of_target", "functional_map")))
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise ResultError(f"{path}: cannot be read ({error})") from error

    def final_maps(self, row: PairRow) -> PairMaps:
        """Read the maps of a row that is "ok"."""
        return self.read_maps("pairs" if row.kind == "direct" else "consistent", row.source, row.target)

    def write_network(self, names: Sequence[str], network: Network) -> None:
        """Write ``network.npz``."""
        with replaced_file(self.folder / NETWORK_FILE) as stream:
            np.savez(
                stream,
                names=np.array(names),
                frames=network.frames,
                component=network.component,
                residuals=network.residuals,
                weights=network.weights,
            )

    def read_network(self) -> tuple[list[str], Network]:
        """Return the names of the shapes and their network.

        Raises
        ------
        ResultError
            There is none, or it is damaged.
        """
        path = self.folder / NETWORK_FILE
        try:
            with path.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
                fields = ("frames", "component", "residuals", "weights")
                return stored["names"].tolist(), Network(*(stored[name] for name in fields))
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise ResultError(f"{path}: cannot be read ({error}); match with --consistency repair") from error


def merged(direct: PairRow, repaired: PairRow) -> PairRow:
    """Return the row of a repaired pair: what the match said, and what the map is now."""
    seconds = (direct.seconds or 0.0) + (repaired.seconds or 0.0)
    stages = ";".join(part for part in (direct.stages, repaired.stages) if part)
    return replace(direct, kind="repaired", distortion=repaired.distortion, seconds=seconds, stages=stages)
