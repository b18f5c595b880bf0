"""Folders, and groups of files, that are written wholly or not at all.

A folder is built beside its destination under a name that starts with a dot, flushed to the disk, and renamed. A kill
at any moment leaves the old folder, the new one, or (between two renames) the old one under a name that `recover`
puts back; what a killed process left behind is removed by the next one that writes to the same place.
"""

from __future__ import annotations

import contextlib
import logging
import os
import secrets
import shutil
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from clalign.errors import ResultError

try:
    import fcntl
except ImportError:  # Windows has no flock: leftovers are then told from live folders by their age
    fcntl = None  # type: ignore[assignment]

_log = logging.getLogger(__name__)

_STALE_SECONDS = 86400.0


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
                raise ResultError(
                    f"{folder}: already holds a result; give --force (in Python force=True) to replace it, or another "
                    "--out"
                )
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
