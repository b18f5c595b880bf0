"""Where the tasks run: worker processes on this machine, or a Dask scheduler that is there already."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clalign.errors import ClalignError, OptionError
from clalign.geometry.workers import environment, process_environment, processor_count
from clalign.storage.files import visible

if TYPE_CHECKING:
    from distributed import Client, Future, LocalCluster

logger = logging.getLogger(__name__)

WAIT_FOR_WORKERS = 60.0
TASKS_AHEAD = 3
"""Tasks handed to the scheduler for each worker: enough that none is idle, few enough for a million pairs."""


@dataclass(frozen=True)
class Task:
    """One call on a worker. Arguments may be futures of earlier tasks; `name` is unique in the run."""

    name: str
    function: Callable[..., Any]
    arguments: tuple[Any, ...]


@contextmanager
def open_client(scheduler: str | None, workers: int, folder: Path) -> Iterator[Client]:
    """Connect to a scheduler, or start worker processes on this machine and end them with the block.

    Local workers are spawned, not forked, with one thread for tasks each and a share of the processors for the device
    driver; BLAS gets one thread, so that the maps do not depend on the number of workers.

    Parameters
    ----------
    scheduler : address such as "tcp://host:8786", or None.
    workers : local processes.
    folder : must be seen by every worker.

    Raises
    ------
    OptionError
        Dask is not installed, or no scheduler answers, or its workers do not fit.
    """
    try:
        import dask
        import distributed
    except ImportError as error:
        raise OptionError('collections run on Dask: pip install "clalign[collection]"') from error
    patient = {"distributed.comm.timeouts.connect": "60s", "distributed.admin.tick.limit": "60s"}
    with dask.config.set(patient), _quiet():
        if scheduler is None:
            with _local_cluster(workers) as cluster, distributed.Client(cluster) as client:
                yield client
            return
        try:
            client = distributed.Client(scheduler, timeout="20s")
        except (OSError, ValueError, TimeoutError) as error:
            raise OptionError(f"--scheduler {scheduler}: no Dask scheduler answers there ({error})") from error
        with client:
            _check_workers(client, folder)
            yield client


@contextmanager
def _local_cluster(workers: int) -> Iterator[LocalCluster]:
    import dask
    import distributed

    shares = worker_environment(workers)
    settings = {"distributed.scheduler.allowed-failures": 3, "distributed.nanny.pre-spawn-environ": shares}
    with (
        # Dask leaves its variables behind in this process, and what is set here has precedence over them.
        environment(shares),
        dask.config.set(settings),
        distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            dashboard_address="127.0.0.1:0",  # any free port: two collections may run side by side
            silence_logs=logging.CRITICAL,
        ) as cluster,
    ):
        yield cluster


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep Dask's own log, which tells of every connection and of workers that we mean to lose, off the terminal."""
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client")]
    levels = [each.level for each in loggers]
    for each in loggers:
        each.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for each, level in zip(loggers, levels, strict=True):
            each.setLevel(level)


def worker_environment(workers: int) -> dict[str, str]:
    """Return the variables of a local worker; the libraries read them when they load, so they are set before."""
    # Fewer arenas keep less of what is freed; a low trim threshold, as Dask sets it, costs half the time in faults.
    memory = {"MALLOC_ARENA_MAX": "2"}
    return process_environment(max(1, processor_count() // workers)) | memory


def _check_workers(client: Client, folder: Path) -> None:
    """Refuse workers with another version, or without sight of the folder, before any work is done.

    Raises
    ------
    OptionError
        With the worker's address.
    """
    import clalign

    try:
        client.wait_for_workers(1, timeout=WAIT_FOR_WORKERS)
    except TimeoutError as error:
        raise OptionError(f"the Dask scheduler has no worker after {WAIT_FOR_WORKERS:.0f} s") from error
    for worker, (version, seen) in client.run(_facts, str(folder)).items():
        if version != clalign.__version__:
            raise OptionError(f"worker {worker} has clalign {version}, here is {clalign.__version__}")
        if not seen:
            raise OptionError(
                f"worker {worker} does not see {folder}; put --out and the meshes on a shared file system"
            )


def wait_for_workers(scheduler: str, count: int) -> None:
    """Wait until a scheduler has so many workers."""
    import distributed

    with distributed.Client(scheduler) as client:
        client.wait_for_workers(count, timeout=WAIT_FOR_WORKERS)


def _facts(folder: str) -> tuple[str, bool]:
    import clalign

    return clalign.__version__, Path(folder).is_dir()


def worker_count(client: Client) -> int:
    """Return the number of workers at the moment, at least one."""
    return max(1, len(client.nthreads()))


def outcomes(
    client: Client, tasks: Iterable[Task], kept: dict[str, Future] | None = None
) -> Iterator[tuple[Task, Any]]:
    """Run tasks, a few a worker at a time, and yield each with its value, or an exception, as they end.

    The work of a lost worker is given to another; a task that has lost three workers is given up.

    Parameters
    ----------
    tasks : taken one by one, when there is room.
    kept : gets the futures by task name, for tasks that depend on them; without it a value is let go of when yielded.
    """
    from distributed import as_completed

    source = iter(tasks)
    running: dict[str, tuple[Task, Future]] = {}
    completed = as_completed()

    def fill() -> None:
        while len(running) < TASKS_AHEAD * worker_count(client):
            task = next(source, None)
            if task is None:
                return
            # Dask's messages hold text that has an encoding, which names of files need not have.
            future = client.submit(task.function, *task.arguments, key=visible(task.name), pure=False)
            running[str(future.key)] = (task, future)
            if kept is not None:
                kept[task.name] = future
            completed.add(future)

    fill()
    while running:
        future = next(completed)
        task, _ = running.pop(str(future.key))
        try:
            value = future.result()
        except Exception as error:
            value = _lost(error)
        fill()
        yield task, value


def _lost(error: Exception) -> Exception:
    from distributed.scheduler import KilledWorker

    if isinstance(error, KilledWorker):
        return ClalignError("worker processes ended again and again while they worked on it (out of memory?)")
    return error
