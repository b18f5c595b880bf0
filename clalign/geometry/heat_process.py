"""Farthest-point samples computed in an interpreter of its own.

The heat method's bindings hold the interpreter lock. Beside the spectra, whose threads come back to Python between
solves of a millisecond, that costs more than it gains: every one of them waits for a row. And where native code crashes
on a mesh, it is the other interpreter that ends. Started is a plain interpreter, not a process of `multiprocessing`:
that would run the user's script a second time.
"""

from __future__ import annotations

import json
import logging
import os
import pickle
import signal
import subprocess
import sys
import threading
from concurrent.futures import CancelledError
from pathlib import Path

from clalign.errors import MemoryBudgetError, MeshError
from clalign.geometry.heat import Geodesics, Surface, farthest_points
from clalign.geometry.workers import SINGLE_THREADED, processor_count

logger = logging.getLogger(__name__)

#: Samples × vertices from which on the process is worth its start: about half a second of the heat method.
WORTH_A_PROCESS = 1_000_000
#: What the interpreter runs. It finds modules where this one does, but for the folder that it is started in.
PROGRAM = """import json, sys
sys.path[:] = json.loads(sys.argv[1])
from clalign.geometry.heat import answer
answer()"""
#: Statuses above are codes of a crash on Windows; elsewhere a signal is a negative status.
LARGEST_STATUS = 255
#: Signals that native code brings upon itself, and those that come from outside, mostly for want of memory.
CRASHES = ("SIGSEGV", "SIGABRT", "SIGBUS", "SIGFPE", "SIGILL")
ENDED = ("SIGKILL", "SIGTERM")


class HeatProcess:
    """`heat.farthest_points` for one mesh, in an interpreter that `stop` ends at any moment.

    Wherever the interpreter cannot be had (a single processor, a frozen program) or fails by itself, the work is done
    here, with the same result bit for bit and the same errors.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()
        self._stopped = False

    def farthest_points(self, surface: Surface, count: int, kept: int) -> Geodesics:
        """Do what `heat.farthest_points` does.

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
        if count * len(surface.vertices) >= WORTH_A_PROCESS and processor_count() > 1 and _is_interpreter():
            found = self._asked(surface, count, kept)
        self._go_on()
        return farthest_points(surface, count, kept, self._go_on) if found is None else found

    def stop(self) -> None:
        """End the interpreter at once, and the work that is done here at its next sample. Any thread may call this."""
        with self._lock:
            self._stopped = True
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def _go_on(self) -> None:
        """Raise CancelledError after `stop`."""
        if self._stopped:
            raise CancelledError

    def _asked(self, surface: Surface, count: int, kept: int) -> Geodesics | None:
        """Return the interpreter's answer, or None where there is none."""
        with self._lock:
            self._go_on()
            try:
                process = self._process = _started()
            except OSError as error:
                logger.info("no second interpreter (%s); distances are computed in this one", error)
                return None
        answer, _ = process.communicate(pickle.dumps((surface, count, kept), pickle.HIGHEST_PROTOCOL))
        self._go_on()
        if process.returncode:
            _report(process.returncode, surface.name)
            return None
        found = _unpickled(answer)
        if isinstance(found, MeshError):
            raise found
        return found


def _unpickled(answer: bytes) -> Geodesics | MeshError | None:
    """Return what the interpreter has sent; None where that is no answer (cut short, or mixed with other output)."""
    try:
        found = pickle.loads(answer)
    # What is no pickle makes pickle raise almost anything.
    except Exception as error:
        logger.info("no answer of the second interpreter (%s); distances are computed in this one", error)
        return None
    return found if isinstance(found, Geodesics | MeshError) else None


def _report(status: int, name: str) -> None:
    """Log how the interpreter failed by itself; raise MeshError if it crashed, MemoryBudgetError if it was ended."""
    try:
        cause = signal.Signals(-status).name
    except ValueError:
        cause = f"status {status}"
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


def _is_interpreter() -> bool:
    """Tell whether this is a Python that takes a program, not one frozen or embedded into something else."""
    return not getattr(sys, "frozen", False) and "python" in Path(sys.executable or "").name.lower()


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
