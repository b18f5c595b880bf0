"""Files and folders that are written wholly or not at all, tables that grow row by row, and the user's cache folder.

A folder is built beside its destination under a name that starts with a dot, flushed to the disk, and renamed. A kill
at any moment leaves the old folder, the new one, or (between two renames) the old one under a name that `recover`
puts back; what a killed process left behind is removed by the next one that writes to the same place.
"""

from __future__ import annotations

import contextlib
import csv
import io
import logging
import os
import secrets
import shutil
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields
from pathlib import Path
from typing import IO, Any, Generic, TypeVar, get_type_hints

from clalign.errors import ResultError

try:
    import fcntl
except ImportError:  # Windows has no flock: leftovers are told from live folders by their age, kernels compiled anew
    fcntl = None  # type: ignore[assignment]

_log = logging.getLogger(__name__)

_STALE_SECONDS = 86400.0

KERNEL_VARIABLE = "POCL_CACHE_DIR"
"""Environment variable with the folder in which PoCL keeps compiled kernels."""

_kernel_lock: int | None = None
_claim = threading.Lock()

Row = TypeVar("Row")


def check_destination(folder: Path, marker: str, *, force: bool) -> None:
    """Refuse a folder that must not be written to, before any long work is done for it.

    Parameters
    ----------
    folder : where the result is to go.
    marker : name of a file that only a folder written by this program has; without it `force` replaces nothing.
    force : replace an earlier result.

    Raises
    ------
    ResultError
        The path is a file, an earlier result that may not be replaced, a folder with other content, or no folder can
        be made beside it.
    """
    try:
        _check_free(folder, marker, force=force)
        _probe(folder)
    except OSError as error:
        reason = error.strerror or str(error)
        raise ResultError(f"{folder}: cannot be written ({reason}); choose another --out") from error


def _check_free(folder: Path, marker: str, *, force: bool) -> None:
    recover(folder)
    if folder.is_dir():
        if any(folder.iterdir()):
            if not (folder / marker).is_file():
                raise ResultError(f"{folder}: the folder holds files that are not a result; choose another --out")
            if not force:
                raise ResultError(f"{folder}: already holds a result; give --force to replace it, or another --out")
    elif folder.exists() or folder.is_symlink():
        raise ResultError(f"{folder}: is not a folder; choose another --out")


def _probe(folder: Path) -> None:
    """Make and remove a folder where the unfinished one will be; access rights do not tell everything beforehand."""
    folder = folder.absolute()
    parent = folder.parent
    while not parent.exists():
        parent = parent.parent
    if not parent.is_dir():
        raise ResultError(f"{folder}: cannot be written, {parent} is not a folder; choose another --out")
    try:
        probe = parent / (_prefix(folder, "new") + secrets.token_hex(6))
        probe.mkdir()
        probe.rmdir()
    except OSError as error:
        reason = error.strerror or str(error)
        raise ResultError(
            f"{folder}: cannot be written, {parent} takes no new folder ({reason}); choose another --out"
        ) from error


@contextlib.contextmanager
def replaced_file(path: Path, *, durable: bool = False) -> Iterator[IO[bytes]]:
    """Open a temporary file that takes the place of `path` when the block ends without an error, and is removed else.

    durable : force the content to the disk first, so that a power cut leaves the old file or the new one.
    """
    unfinished = path.with_name(f".{path.name}.{secrets.token_hex(6)}.part")
    try:
        with unfinished.open("xb") as stream:
            yield stream
            if durable:
                stream.flush()
                os.fsync(stream.fileno())
        os.replace(unfinished, path)
    finally:
        with contextlib.suppress(OSError):
            unfinished.unlink()


@contextlib.contextmanager
def atomic_folder(folder: Path, marker: str, *, force: bool = False) -> Iterator[Path]:
    """Yield an empty folder that takes the place of `folder` when the block ends without an error.

    Raises
    ------
    ResultError
        As `check_destination`, or the operating system refused to write (the disk is full, say); nothing is left
        behind then, and an earlier result is untouched.
    """
    folder = folder.absolute()
    check_destination(folder, marker, force=force)
    with _beside(folder, folder) as temporary:
        yield temporary
        _flush(temporary)
        _swap(temporary, folder)


@contextlib.contextmanager
def atomic_files(paths: Sequence[Path], *, force: bool = False) -> Iterator[list[Path]]:
    """Yield a temporary path for each of several files of one folder; they appear when the block ends without an error.

    The first is the main one, the others belong to it. They are removed before it is replaced and come after it, so
    that a companion which is there at all fits, even after a kill between two renames.

    Raises
    ------
    ResultError
        A file exists and may not be replaced, or the operating system refused to write; nothing is left behind then.
    """
    check_files(paths, force=force)
    main, *companions = (path.absolute() for path in paths)
    with _beside(main, paths[0]) as temporary:
        yield [temporary / path.name for path in (main, *companions)]
        _flush(temporary)
        for path in companions:
            path.unlink(missing_ok=True)
        for path in (main, *companions):
            os.replace(temporary / path.name, path)
        _flush_one(main.parent)


@contextlib.contextmanager
def _beside(destination: Path, named: Path) -> Iterator[Path]:
    """Yield a temporary folder beside a destination, which is `named` so where the operating system refuses."""
    temporary: Path | None = None
    lock: int | None = None
    try:
        destination.parent.mkdir(parents=True, exist_ok=True)
        _remove_leftovers(destination)
        temporary, lock = _locked_temporary(destination)
        yield temporary
    except OSError as error:
        reason = error.strerror or str(error)
        raise ResultError(f"{named}: could not be written ({reason}); nothing was left half-written") from error
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)
        _unlock(lock)


def check_files(paths: Sequence[Path], *, force: bool) -> None:
    """Refuse files that exist and may not be replaced, before any long work is done for them.

    Raises
    ------
    ResultError
        Naming the first such file.
    """
    for path in paths:
        if path.is_dir():
            raise ResultError(f"{path}: is a folder; name a file")
        if not force and (path.exists() or path.is_symlink()):
            raise ResultError(f"{path}: already exists; give --force to replace it, or another name")


def recover(folder: Path) -> None:
    """Put an earlier result back that a kill between two renames left under its other name."""
    folder = folder.absolute()
    if folder.exists() or not folder.parent.is_dir():
        return
    for kept in sorted(folder.parent.glob(f"{_prefix(folder, 'old')}*")):
        with _abandoned(kept) as abandoned:
            if abandoned:
                _log.warning("%s: put back after an interrupted write", folder)
                os.replace(kept, folder)
                return


def _prefix(folder: Path, kind: str) -> str:
    return f".{folder.name}.clalign-{kind}-"


def _locked_temporary(folder: Path) -> tuple[Path, int | None]:
    """Make a temporary folder that the lock of a living process marks as in use."""
    while True:
        temporary = folder.parent / (_prefix(folder, "new") + secrets.token_hex(6))
        temporary.mkdir()
        lock = _lock(temporary)
        # Another process may have taken it for a leftover between its creation and the lock.
        if temporary.exists():
            return temporary, lock
        _unlock(lock)


def _lock(folder: Path) -> int | None:
    """Lock a folder until `_unlock` or the end of the process, however it ends; renaming keeps the lock."""
    if fcntl is None:
        return None
    handle = os.open(folder, os.O_RDONLY)
    fcntl.flock(handle, fcntl.LOCK_EX)
    return handle


def _unlock(lock: int | None) -> None:
    if lock is not None:
        os.close(lock)


@contextlib.contextmanager
def _abandoned(path: Path) -> Iterator[bool]:
    """Tell whether no living process works in `path`; the folder stays locked inside the block."""
    if fcntl is None:
        yield path.exists() and time.time() - path.stat().st_mtime > _STALE_SECONDS
        return
    with contextlib.ExitStack() as stack:
        try:
            lock = os.open(path, os.O_RDONLY)
            stack.callback(os.close, lock)
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            free = path.exists()
        except OSError:
            free = False
        yield free


def _remove_leftovers(folder: Path) -> None:
    for kind in ("new", "old"):
        for left in folder.parent.glob(f"{_prefix(folder, kind)}*"):
            with _abandoned(left) as abandoned:
                if abandoned:
                    _log.info("removing %s, left by an interrupted write", left)
                    shutil.rmtree(left, ignore_errors=True)


def _flush(folder: Path) -> None:
    """Force every file of the folder, then the folder, to the disk."""
    for path in [*folder.rglob("*"), folder]:
        _flush_one(path)


def _flush_one(path: Path) -> None:
    if path.is_dir() and os.name != "posix":
        return
    handle = os.open(path, os.O_RDONLY if path.is_dir() or os.name == "posix" else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _swap(temporary: Path, folder: Path) -> None:
    if not folder.exists():
        os.rename(temporary, folder)
        _flush_one(folder.parent)
        return
    # A folder cannot be renamed over another one with content, so there is one moment without a folder of that
    # name; `recover` mends it should the process be killed just then, and the lock tells it to wait until then.
    kept = folder.parent / temporary.name.replace(_prefix(folder, "new"), _prefix(folder, "old"))
    lock = _lock(folder)
    try:
        os.rename(folder, kept)
        try:
            os.rename(temporary, folder)
        except OSError:
            os.rename(kept, folder)
            raise
        _flush_one(folder.parent)
        shutil.rmtree(kept, ignore_errors=True)
    finally:
        _unlock(lock)


def append_rows(path: Path, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Add rows to a CSV file, below a header if it is new, and force them to the disk.

    A line that a kill cut short is removed first.
    """
    with path.open("a+b") as stream:
        if stream.tell() and stream.seek(-1, os.SEEK_END) >= 0 and stream.read(1) != b"\n":
            stream.seek(0)
            stream.truncate(stream.read().rfind(b"\n") + 1)
        begun = stream.seek(0, os.SEEK_END) > 0
        stream.write(_csv(rows if begun else [header, *rows]).encode())
        stream.flush()
        os.fsync(stream.fileno())


def complete_rows(path: Path, header: Sequence[str]) -> list[list[str]]:
    """Return the complete rows of a CSV file of `append_rows`; none without a file.

    Raises
    ------
    ResultError
        The file has another header.
    """
    if not path.is_file():
        return []
    # Line by line, as no cell holds a line break: a line that was cut inside quotes must not swallow the next one.
    *lines, _ = path.read_text(encoding="utf-8").split("\n")
    rows = [next(csv.reader([line])) for line in lines if line]
    if rows and rows[0] != list(header):
        raise ResultError(f"{path}: was not written by this version of clalign; choose another --out")
    return [cells for cells in rows[1:] if len(cells) == len(header)]


class RowFile(Generic[Row]):
    """Rows of one dataclass in a CSV file that any program reads, one line each.

    Fields are texts, or int, float or bool or else None, which is an empty cell; those with ``"stored": False`` in
    their metadata are left out.

    Parameters
    ----------
    path : the file.
    kind : the dataclass.
    digits : of floats.
    """

    def __init__(self, path: Path, kind: type[Row], digits: int = 9) -> None:
        self.path, self.kind, self.digits = path, kind, digits
        stored: Any = kind
        self.header = [item.name for item in fields(stored) if item.metadata.get("stored", True)]

    def read(self) -> list[Row]:
        """Return the complete rows; see `complete_rows` for what is raised."""
        hints = get_type_hints(self.kind)
        return [
            self.kind(**{name: _value(hints[name], cell) for name, cell in zip(self.header, cells, strict=True)})
            for cells in complete_rows(self.path, self.header)
        ]

    def append(self, row: Row) -> None:
        """Add a row and force it to the disk."""
        append_rows(self.path, self.header, [self._cells(row)])

    def write(self, rows: Iterable[Row]) -> None:
        """Write the whole file anew; the earlier one is replaced at once."""
        with replaced_file(self.path, durable=True) as stream:
            stream.write(_csv([self.header, *map(self._cells, rows)]).encode())

    def _cells(self, row: Row) -> list[str]:
        return [self._cell(getattr(row, name)) for name in self.header]

    def _cell(self, value: Any) -> str:
        if value is None:
            return ""
        # A line break inside a cell is good CSV, but a cut line could then not be told from a whole one.
        return f"{value:.{self.digits}g}" if isinstance(value, float) else " ".join(str(value).splitlines())


def _csv(rows: Iterable[Sequence[str]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def _value(hint: Any, cell: str) -> Any:
    if hint == bool | None and cell:
        return cell == "True"
    for kind in (bool, int, float):
        if hint == kind | None:
            return kind(cell) if cell else None
    return cell


def size_text(size: float) -> str:
    """Return a number of bytes as people read it."""
    if size >= 2**30:
        return f"{size / 2**30:.1f} GiB"
    for unit, name in ((2**20, "MiB"), (2**10, "KiB")):
        if size >= unit:
            return f"{size / unit:.0f} {name}"
    return f"{size:.0f} bytes"


def cache_folder() -> Path:
    """Return the folder named by the environment variable ``CLALIGN_CACHE``, or the user's cache folder."""
    named = os.environ.get("CLALIGN_CACHE", "")
    if named:
        return Path(named).expanduser()
    import platformdirs

    return Path(platformdirs.user_cache_dir("clalign"))


def claim_kernel_folder() -> None:
    """Give this process a folder of compiled kernels that no other process writes to, and keep it until the end.

    PoCL's breaks when several processes write to it. Folders are numbered and used again by later processes, so that
    kernels are compiled once a worker, not once a run. Works only before the driver is loaded.
    """
    global _kernel_lock
    with _claim:
        if _kernel_lock is not None:
            return
        if fcntl is None:
            os.environ[KERNEL_VARIABLE] = tempfile.mkdtemp(prefix="clalign-kernels-")
            _kernel_lock = -1
            return
        named = os.environ.get(KERNEL_VARIABLE)
        root = Path(named) if named else cache_folder() / "kernels"
        number = 0
        while _kernel_lock is None:
            folder = root / f"worker-{number}"
            folder.mkdir(parents=True, exist_ok=True)
            handle = os.open(folder, os.O_RDONLY)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                _kernel_lock = handle
            except OSError:
                os.close(handle)
                number += 1
        os.environ[KERNEL_VARIABLE] = str(folder)
