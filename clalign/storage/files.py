"""Files that are whole or not there, sizes and durations as text, and where the program keeps what it has computed."""

from __future__ import annotations

import atexit
import contextlib
import json
import logging
import os
import secrets
import shutil
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from clalign.errors import ResultError

try:
    import fcntl
except ImportError:  # Windows has no flock: every process compiles its kernels anew
    fcntl = None  # type: ignore[assignment]

logger = logging.getLogger(__name__)

KERNEL_VARIABLE = "POCL_CACHE_DIR"
"""Environment variable with the folder in which PoCL keeps compiled kernels."""

_kernel_lock: int | None = None
_claim = threading.Lock()


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


def text_bytes(text: str) -> bytes:
    r"""Return text as UTF-8, with a visible escape for what UTF-8 does not have.

    Python holds a byte of a file name that is no UTF-8 as a lone surrogate; it becomes ``\udcf6``, which JSON reads
    back as the same name, and a person can still read.
    """
    return text.encode("utf-8", errors="backslashreplace")


def visible(text: str) -> str:
    """Return text as `text_bytes` writes it, for those who take nothing but text that has an encoding."""
    return text_bytes(text).decode()


def write_text(path: str | Path, text: str) -> None:
    """Write a text file as `text_bytes`, with the line ends of `text`.

    Raises
    ------
    ResultError
        The file cannot be written.
    """
    try:
        Path(path).write_bytes(text_bytes(text))
    except OSError as error:
        raise ResultError(f"{path}: cannot be written ({error.strerror})") from error


def write_json(path: Path, value: Any, indent: int = 2) -> None:
    """Write plain values as a JSON document; OSError as the system gives it."""
    path.write_bytes(text_bytes(json.dumps(value, indent=indent, ensure_ascii=False, allow_nan=False) + "\n"))


def make_folder(folder: Path) -> None:
    """Make a folder, and those above it, where it is not there yet.

    Raises
    ------
    ResultError
        It cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ResultError(f"{folder}: cannot make this folder ({error.strerror})") from error


def size_text(size: float) -> str:
    """Return a number of bytes as people read it."""
    if size >= 2**30:
        return f"{size / 2**30:.1f} GiB"
    for unit, name in ((2**20, "MiB"), (2**10, "KiB")):
        if size >= unit:
            return f"{size / unit:.0f} {name}"
    return f"{size:.0f} bytes"


def duration_text(seconds: float) -> str:
    """Return a duration that is only estimated as people read it: no digits that are not known."""
    if seconds < 90:
        return f"{max(5 * round(seconds / 5), 5)} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def cache_folder() -> Path:
    """Return the folder named by the environment variable ``CLALIGN_CACHE``, or the user's cache folder."""
    named = os.environ.get("CLALIGN_CACHE", "")
    if named:
        return Path(named).expanduser()
    import platformdirs

    return Path(platformdirs.user_cache_dir("clalign"))


def ensure_driver_caches() -> None:
    """Let kernels go to a temporary folder, and pyopencl keep nothing, where the user's caches take no files.

    PoCL would have no device there, and pyopencl would fail in the middle of the work. Works only before either is
    loaded, and leaves alone what the user has set.
    """
    import platformdirs

    caches = Path(platformdirs.user_cache_dir())
    if all(map(takes_files, (caches / "pyopencl", caches / "pocl" / "kcache"))):
        return
    os.environ.setdefault("PYOPENCL_NO_CACHE", "1")
    if not os.environ.get(KERNEL_VARIABLE):
        folder = os.environ[KERNEL_VARIABLE] = _passing_folder()
        logger.info("%s takes no files; kernels are compiled anew, in %s", caches, folder)


def _passing_folder() -> str:
    """Make a temporary folder that goes with the process."""
    folder = tempfile.mkdtemp(prefix="clalign-kernels-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def takes_files(folder: Path) -> bool:
    """Tell whether files can be written in a folder, or in the one that it would be made in."""
    try:
        while not folder.exists() and folder != folder.parent:
            folder = folder.parent
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


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
            os.environ[KERNEL_VARIABLE] = _passing_folder()
            _kernel_lock = -1
            return
        ensure_driver_caches()
        named = os.environ.get(KERNEL_VARIABLE)
        root = Path(named) if named else cache_folder() / "kernels"
        if not takes_files(root):
            root = Path(_passing_folder())
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
