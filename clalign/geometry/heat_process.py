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

from clalign.errors import MeshError

from .heat import FarthestPoints, Surface, farthest_points
from .heat_server import REFUSED, REQUEST, packed, receive, send, unpacked
from .workers import processor_count

logger = logging.getLogger(__name__)

#: Samples × vertices from which on the process is worth its start: about half a second of the heat method.
WORTH_A_PROCESS = 1_000_000
#: What the interpreter runs. It finds modules where this one does, and not in the folder that it is started in.
PROGRAM = """import json, sys
sys.path[:] = json.loads(sys.argv[1])
from clalign.geometry.heat_server import main
main()"""
#: Statuses above are codes of a crash on Windows; elsewhere a crash is a negative status.
LARGEST_STATUS = 255


class HeatProcess:
    """One interpreter for `farthest_points`, started when first needed and ended when the ``with`` block is left.

    Wherever the interpreter cannot be had (a single processor, a frozen program) or fails, the work is done here, with
    the same result bit for bit and the same errors.
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
        CancelledError
            `stop` was called.
        """
        found = None
        if count * len(surface.vertices) >= WORTH_A_PROCESS and processor_count() > 1:
            found = self._asked(surface, np.array([central, count, kept]))
        if self._stopped:
            raise CancelledError
        return farthest_points(surface, central, count, kept) if found is None else found

    def stop(self) -> None:
        """End the interpreter at once. Any thread may call this."""
        with self._lock:
            self._stopped = True
            process = self._process
        if process is not None:
            process.kill()
            process.wait()
            _close(process)

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
        if not 0 <= status <= LARGEST_STATUS:
            raise MeshError(
                f"{name}: geodesic distances cannot be computed (the heat method was ended by {_cause(status)}); look "
                "for degenerate faces, or remesh"
            )
        logger.info("the second interpreter ended with status %d; distances are computed in this one", status)


def _is_interpreter(executable: str | None) -> bool:
    """Tell whether this is a Python that takes a program, not one frozen or embedded into something else."""
    return bool(executable) and not getattr(sys, "frozen", False) and "python" in Path(executable or "").name.lower()


def _started() -> subprocess.Popen[bytes]:
    single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    path = json.dumps([str(folder) for folder in sys.path])
    return subprocess.Popen(
        [sys.executable, "-P", "-W", "ignore", "-c", PROGRAM, path],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=os.environ | single,
        # A Ctrl-C is for this process, which ends that one: so no traceback of two processes, whoever comes first.
        start_new_session=True,
        creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
    )


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
