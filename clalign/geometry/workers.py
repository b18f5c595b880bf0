"""How many threads the preparation of shapes uses."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

from threadpoolctl import threadpool_limits

#: Environment variable with the most threads to use, for several processes that share a machine.
THREADS_VARIABLE = "CLALIGN_THREADS"
#: Variables that keep OpenMP and the BLAS libraries to one thread; they read them when they load.
SINGLE_THREADED = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)

_lock = threading.Lock()
_users = 0
_limits: threadpool_limits | None = None


def processor_count() -> int:
    """Return the number of processors that this process may run on, at most ``CLALIGN_THREADS`` if that is set."""
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    wanted = os.environ.get(THREADS_VARIABLE, "")
    return min(available, int(wanted)) if wanted.isdecimal() and int(wanted) > 0 else available


@contextlib.contextmanager
def thread_pool(count: int) -> Iterator[ThreadPoolExecutor]:
    """Yield a pool of threads; if the block fails, what was not begun is dropped and what was is not waited for here.

    The interpreter does wait at its exit for threads that still run. So that a program ends soon after Ctrl-C, whoever
    gives a thread long work also has a way to stop it, as the workers of `lanczos` and `HeatProcess` do.
    """
    pool = ThreadPoolExecutor(count)
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()


@contextlib.contextmanager
def single_threaded_blas() -> Iterator[None]:
    """Keep matrix products to the calling thread while the block runs.

    The limit belongs to the whole process. Blocks may run in several threads at once: the first to enter sets the
    limit, and the last to leave restores what was before it.
    """
    global _users, _limits
    with _lock:
        if _users == 0:
            _limits = threadpool_limits(1, user_api="blas")
        _users += 1
    try:
        yield
    finally:
        with _lock:
            _users -= 1
            if _users == 0 and _limits is not None:
                _limits.restore_original_limits()
                _limits = None


def process_environment(threads: int) -> dict[str, str]:
    """Return the variables of a process beside others: `threads` for shapes and an OpenCL device, one for BLAS."""
    own = ("POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT", THREADS_VARIABLE)
    return SINGLE_THREADED | dict.fromkeys(own, str(threads))


@contextlib.contextmanager
def environment(values: dict[str, str]) -> Iterator[None]:
    """Set variables for the processes started meanwhile; the libraries read them when they load."""
    before = {name: os.environ[name] for name in values if name in os.environ}
    os.environ.update(values)
    try:
        yield
    finally:
        for name in values:
            os.environ.pop(name, None)
        os.environ.update(before)
