"""Farthest-point samples computed in an interpreter of its own.

The heat method's bindings hold the interpreter lock. Beside the spectra, whose threads come back to Python between
solves of a millisecond, that costs more than it gains: every one of them waits for a row. And where native code crashes
on a mesh, it is the other interpreter that ends. Started is a plain interpreter, not a process of `multiprocessing`:
that would run the user's script a second time.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import signal
import subprocess
import sys
import threading
from concurrent.futures import CancelledError
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from clalign.errors import MemoryBudgetError, MeshError
from clalign.geometry.heat import FarthestPoints, Surface, farthest_points
from clalign.geometry.heat_server import REFUSED, REQUEST, packed, receive, send, unpacked
from clalign.geometry.workers import SINGLE_THREADED, processor_count

logger = logging.getLogger(__name__)

#: Samples × vertices from which on the process is worth its start: about half a second of the heat method.
WORTH_A_PROCESS = 1_000_000
#: What the interpreter runs. It finds modules where this one does, but for the folder that it is started in.
PROGRAM = """import json, sys
sys.path[:] = json.loads(sys.argv[1])
from clalign.geometry.heat_server import main
main()"""
#: Statuses above are codes of a crash on Windows; elsewhere a signal is a negative status.
LARGEST_STATUS = 255
#: Signals that native code brings upon itself, and those that come from outside, mostly for want of memory.
CRASHES = ("SIGSEGV", "SIGABRT", "SIGBUS", "SIGFPE", "SIGILL")
ENDED = ("SIGKILL", "SIGTERM")


class HeatProcess:
    """One interpreter for `farthest_points`, started when first needed and ended when the ``with`` block is left.

    It works on one mesh at a time; `shape.prepare_all` has one of these for every mesh, and as many of them at work as
    there are processors. Wherever the interpreter cannot be had (a single processor, a frozen program) or fails by
    itself, the work is done here, with the same result bit for bit and the same errors.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()
        self._stopped = False

    def __enter__(self) -> HeatProcess:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def farthest_points(self, surface: Surface, central: int, count: int, kept: int) -> FarthestPoints:
        """Do what `heat.farthest_points` does; to be called by one thread at a time.

        Raises
        ------
        MeshError
            The heat method fails or crashes on the mesh.
        MemoryBudgetError
            The interpreter was ended from outside. The work is not done here then: it would be this process that the
            system ends next, with all that it holds.
        CancelledError
            `stop` was called.
        """
        found = None
        if count * len(surface.vertices) >= WORTH_A_PROCESS and processor_count() > 1:
            found = self._asked(surface, np.array([central, count, kept]))
        self._go_on()
        return farthest_points(surface, central, count, kept, self._go_on) if found is None else found

    def stop(self) -> None:
        """End the interpreter at once, and the work that is done here at its next sample. Any thread may call this."""
        with self._lock:
            self._stopped = True
            process = self._process
        if process is not None:
            process.kill()
            process.wait()
            _close(process)

    def _go_on(self) -> None:
        """Raise CancelledError after `stop`."""
        if self._stopped:
            raise CancelledError

    def _asked(self, surface: Surface, numbers: NDArray[np.int64]) -> FarthestPoints | None:
        """Return the interpreter's answer, or None where there is none."""
        process = self._running()
        if process is None or process.stdin is None or process.stdout is None:
            return None
        request = packed({**vars(surface), "name": np.array(surface.name), "numbers": numbers})
        try:
            send(process.stdin, REQUEST, request)
            message = receive(process.stdout)
        except (OSError, ValueError):
            # Its end of the pipe is closed, or this one is, by `stop`.
            message = None
        if message is None:
            self._lost(process, surface.name)
            return None
        if message[0] == REFUSED:
            raise MeshError(message[1].decode())
        return FarthestPoints(**unpacked(message[1]))

    def _running(self) -> subprocess.Popen[bytes] | None:
        with self._lock:
            if self._process is None and not self._stopped and _is_interpreter(sys.executable):
                try:
                    self._process = _started()
                except OSError as error:
                    logger.info("no second interpreter (%s); distances are computed in this one", error)
            return self._process

    def _lost(self, process: subprocess.Popen[bytes], name: str) -> None:
        status = process.wait()
        if self._stopped:
            return
        with self._lock:
            self._process = None
        _close(process)
        cause = _cause(status)
        if status > LARGEST_STATUS or cause in CRASHES:
            raise MeshError(
                f"{name}: geodesic distances cannot be computed (the heat method was ended by {cause}); look "
                "for degenerate faces, or remesh"
            )
        if cause in ENDED:
            raise MemoryBudgetError(
                f"{name}: the process that computes geodesic distances was ended from outside ({cause}), as a system "
                "does that runs out of memory; end other programs, decimate the mesh, or set CLALIGN_THREADS=1, which "
                "computes in one process, one mesh at a time"
            )
        logger.info("the second interpreter ended by %s; distances are computed in this one", cause)


def _is_interpreter(executable: str | None) -> bool:
    """Tell whether this is a Python that takes a program, not one frozen or embedded into something else."""
    return bool(executable) and not getattr(sys, "frozen", False) and "python" in Path(executable or "").name.lower()


def _started() -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-P", "-W", "ignore", "-c", PROGRAM, json.dumps(_module_path())],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=os.environ | SINGLE_THREADED,
        # A Ctrl-C is for this process, which ends that one: so no traceback of two processes, whoever comes first.
        start_new_session=True,
        creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
    )


def _module_path() -> list[str]:
    """Return where this interpreter finds modules, without its working folder, be that "" or under a relative name.

    What may have been found there is this package itself, whose folder therefore comes last.
    """
    folders = [str(folder) for folder in sys.path if os.path.isabs(str(folder))]
    return [*folders, str(Path(__file__).absolute().parents[2])]


def _cause(status: int) -> str:
    try:
        return signal.Signals(-status).name
    except ValueError:
        return f"status {status}"


def _close(process: subprocess.Popen[bytes]) -> None:
    for stream in (process.stdin, process.stdout):
        # Closing writes what was not yet written to a process that is gone.
        with contextlib.suppress(OSError):
            if stream is not None:
                stream.close()
