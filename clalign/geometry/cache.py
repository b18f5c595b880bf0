"""Arrays stored on disk under a key made from what they were computed from.

An entry is one ``.npz`` file named after its key. It is written under another name and then renamed, so that a reader,
in this process or another, sees it whole or not at all. An entry that cannot be read is dropped and computed again; a
folder that cannot be written to costs the time of computing, never the result.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.errors import OptionError
from clalign.storage.files import cache_folder, replaced_file

logger = logging.getLogger(__name__)

#: Part of every key; raised whenever the same input leads to other arrays than before.
FORMAT = 3
KEY_DIGITS = 40
DEFAULT_LIMIT = 2 * 1024**3
#: A temporary file of this age, in seconds, was left behind by a process that was killed.
ABANDONED_AFTER = 3600.0


@dataclass(frozen=True)
class CacheInfo:
    """What a cache holds: its folder, the number of entries, their bytes and the limit."""

    folder: Path
    entries: int
    size: int
    limit: int


def content_key(kind: str, arrays: Mapping[str, NDArray[Any]], values: Mapping[str, Any]) -> str:
    """Return a key for what is computed from some arrays and values, anything that JSON can write.

    Two inputs have the same key when kind, values and the exact bytes, shapes and types of the arrays agree. The key
    starts with the kind.
    """
    digest = hashlib.sha256(json.dumps([FORMAT, kind, values], sort_keys=True).encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.data)
    return f"{kind}-{digest.hexdigest()[:KEY_DIGITS]}"


def given_cache(cache: Any) -> ShapeCache | None:
    """Return the cache of a call; OptionError, which says how to call, if it is something else."""
    if cache is None or isinstance(cache, ShapeCache):
        return cache
    call = f"ShapeCache({os.fspath(cache)!r})" if isinstance(cache, str | os.PathLike) else "ShapeCache()"
    raise OptionError(
        f"cache must be a ShapeCache, not {type(cache).__name__}; pass {call} from clalign.geometry.cache"
    )


class ShapeCache:
    """A folder of arrays by key, of limited size; entries that were not used for longest go first.

    Parameters
    ----------
    folder : where the entries are; None for `storage.files.cache_folder`. It is made when the first entry is stored.
    limit_bytes : total size above which entries are removed. An entry larger than that is not stored.
    """

    def __init__(self, folder: str | Path | None = None, limit_bytes: int = DEFAULT_LIMIT) -> None:
        self.folder = cache_folder() if folder is None else Path(folder)
        self.limit_bytes = limit_bytes
        self._told = False

    def get(self, key: str) -> dict[str, NDArray[Any]] | None:
        """Return the arrays stored under a key, or None.

        A file that is damaged is removed with a warning, so that the next `put` replaces it.
        """
        path = self._path(key)
        try:
            with path.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
                arrays = {name: stored[name] for name in stored.files}
        except FileNotFoundError:
            return None
        # A damaged file makes zipfile and numpy raise almost anything, NotImplementedError and MemoryError included.
        except Exception as error:
            logger.warning("cache entry %s cannot be read (%s); it is computed again", path, error)
            with contextlib.suppress(OSError):
                path.unlink()
            return None
        # The time of last use only decides what is evicted. It cannot be set in a folder that is read-only or belongs
        # to somebody else, nor after another process has evicted the entry; what was read is whole all the same.
        with contextlib.suppress(OSError):
            os.utime(path)
        return arrays

    def put(self, key: str, arrays: Mapping[str, NDArray[Any]]) -> bool:
        """Store arrays under a key; return whether that worked. A full or read-only disk is logged, not raised."""
        contents: dict[str, Any] = dict(arrays)
        size = sum(array.nbytes for array in arrays.values())
        if size > self.limit_bytes:
            logger.info("cache entry %s of %d bytes exceeds the limit of %d; not stored", key, size, self.limit_bytes)
            return False
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with replaced_file(self._path(key)) as stream:
                np.savez(stream, **contents)
            self._shrink()
        except OSError as error:
            level = logging.DEBUG if self._told else logging.WARNING
            logger.log(level, "the cache in %s cannot be written (%s); going on without it", self.folder, error)
            self._told = True
            return False
        return True

    def clear(self) -> int:
        """Remove all entries and return how many there were."""
        entries = [path for path, _ in self._entries()]
        for path in entries:
            path.unlink(missing_ok=True)
        return len(entries)

    def info(self) -> CacheInfo:
        """Return what the cache holds at the moment."""
        sizes = [status.st_size for _, status in self._entries()]
        return CacheInfo(folder=self.folder, entries=len(sizes), size=sum(sizes), limit=self.limit_bytes)

    def _path(self, key: str) -> Path:
        return self.folder / f"{key}.npz"

    def _entries(self, suffix: str = ".npz") -> list[tuple[Path, os.stat_result]]:
        found = []
        # Nothing but files that look like ours: the folder may be one that the user keeps other arrays in.
        for path in self.folder.glob(f"*-{KEY_DIGITS * '[0-9a-f]'}*{suffix}"):
            # Another process may remove a file between the listing and the question about its size.
            with contextlib.suppress(OSError):
                found.append((path, path.stat()))
        return found

    def _shrink(self) -> None:
        """Remove the entries used longest ago until the limit holds, and files that were left unfinished.

        Files that cannot be removed, such as those of another user, are passed over.
        """
        entries = sorted(self._entries(), key=lambda entry: (entry[1].st_mtime_ns, entry[0].name))
        total = sum(status.st_size for _, status in entries)
        for path, status in entries:
            if total <= self.limit_bytes:
                break
            with contextlib.suppress(OSError):
                path.unlink(missing_ok=True)
                total -= status.st_size
        for path, status in self._entries(".part"):
            if time.time() - status.st_mtime > ABANDONED_AFTER:
                with contextlib.suppress(OSError):
                    path.unlink(missing_ok=True)
