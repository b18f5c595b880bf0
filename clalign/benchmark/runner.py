"""Benchmark runs: methods over the pairs of layouts, resumable, in one process or several."""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import signal
import threading
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clalign.benchmark.layouts import Layout
from clalign.benchmark.methods import Method
from clalign.benchmark.pairs import BenchmarkPair
from clalign.benchmark.records import Key, Record, append_record, failed_record, read_records, record_of
from clalign.errors import ClalignError, OptionError
from clalign.evaluation.distances import DistanceMethod
from clalign.evaluation.errors import evaluate
from clalign.geometry.workers import environment, process_environment
from clalign.storage.files import claim_kernel_folder, make_folder

logger = logging.getLogger(__name__)

Progress = Callable[[int, int, Record], None]
Curves = dict[str, NDArray[np.float64]]


@dataclass(frozen=True)
class Measurement:
    """How errors are measured: number of points (None: the default of `evaluate`), seed and distances."""

    points: int | None = None
    seed: int = 0
    distances: DistanceMethod = "heat"

    def text(self) -> str:
        """Short text for the key of a record."""
        return f"{self.points or 'default'}-{self.seed}-{self.distances}"


@dataclass(frozen=True)
class Trial:
    """One pair by one method."""

    suite: str
    pair: BenchmarkPair
    method: Method
    measurement: Measurement

    @property
    def key(self) -> Key:
        """Key of its record."""
        settings = f"{self.method.settings}/{self.measurement.text()}"
        return (self.suite, self.pair.name, self.method.name, settings)


@dataclass(frozen=True)
class Run:
    """Records of all pairs asked for, in their order, and what was missing from the data sets."""

    records: tuple[Record, ...]
    problems: tuple[str, ...]


def run(
    layouts: Sequence[Layout],
    methods: Sequence[Method],
    folder: str | Path,
    *,
    jobs: int = 1,
    measurement: Measurement | None = None,
    resume: bool = True,
    progress: Progress | None = None,
) -> Run:
    """Run every method on every pair and append one row each to ``pairs.csv`` in `folder`.

    Rows that are already there with the same settings are not computed again; failed ones are. A pair that fails
    is recorded with its reason and the rest goes on.

    Parameters
    ----------
    layouts : suites of pairs.
    methods : with different names.
    folder : for ``pairs.csv`` and ``curves.csv``.
    jobs : processes, each with one thread and its own OpenCL context; 1 works in this process.
    measurement : how errors are measured.
    resume : False computes every pair anew, for a program that changed under the same settings.
    progress : called after every pair with the number done, the number of all and the record.

    Raises
    ------
    OptionError
        `jobs` is below 1, or two methods have one name.
    ResultError
        The folder cannot be made, or its ``pairs.csv`` is of another kind.
    """
    if jobs < 1:
        raise OptionError(f"jobs must be at least 1, got {jobs}")
    names = [method.name for method in methods]
    if len(set(names)) < len(names):
        raise OptionError(f"two methods of one name among {', '.join(names)}")
    how = measurement or Measurement()
    pairs = [(layout.name, pair) for layout in layouts for pair in layout.pairs]
    trials = [Trial(suite, pair, method, how) for suite, pair in pairs for method in methods]
    folder = Path(folder)
    make_folder(folder)
    known = {record.key: record for record in read_records(folder)}
    done = {key: record for key, record in known.items() if resume and not record.failed}
    waiting = [trial for trial in trials if trial.key not in done]
    count = len(trials) - len(waiting)
    logger.info("%d pairs, %d of them already in %s", len(trials), count, folder)
    results = (measure(trial) for trial in waiting) if jobs == 1 else _in_processes(waiting, jobs)
    with _tidy_termination() if jobs > 1 else contextlib.nullcontext(), contextlib.closing(results):
        for record, curves in results:
            append_record(folder, record, curves)
            done[record.key] = record
            count += 1
            if progress is not None:
                progress(count, len(trials), record)
    problems = tuple(problem for layout in layouts for problem in layout.problems)
    return Run(tuple(done[trial.key] for trial in trials), problems)


def measure(trial: Trial) -> tuple[Record, Curves]:
    """Load, match and evaluate one pair; whatever goes wrong becomes a failed record."""
    try:
        pair = trial.pair.load()
        outcome = trial.method(pair)
        evaluation = evaluate(
            outcome.target_of_source,
            pair.truth,
            source=pair.source,
            target=pair.target,
            mirrored=pair.mirrored,
            barycentric=outcome.barycentric,
            points=trial.measurement.points,
            seed=trial.measurement.seed,
            method=trial.measurement.distances,
            name=pair.name,
        )
    except ClalignError as error:
        return failed_record(trial.key, str(error)), {}
    except Exception as error:
        logger.debug("%s, %s", trial.pair.name, trial.method.name, exc_info=True)
        return failed_record(trial.key, f"{type(error).__name__}: {error}"), {}
    curves = {"sqrt_area": evaluation.curve(), "diameter": evaluation.curve(per_diameter=True)}
    return record_of(trial.key, evaluation, outcome), curves


def _in_processes(trials: Sequence[Trial], jobs: int) -> Generator[tuple[Record, Curves]]:
    """Yield results as they come; a process that dies costs the pairs that were being worked on, not the run."""
    waiting = list(reversed(trials))
    # One thread for every library that has its own: the processes are the parallelism.
    with environment(process_environment(1)):
        while waiting:
            with _pool(min(jobs, len(waiting))) as pool:
                running: dict[Future[tuple[Record, Curves]], Trial] = {}
                broken = False
                while running or (waiting and not broken):
                    while waiting and len(running) < jobs and not broken:
                        try:
                            with _unheard_interrupts():
                                running[pool.submit(measure, waiting[-1])] = waiting[-1]
                            waiting.pop()
                        except BrokenProcessPool:
                            broken = True
                    for future in wait(running, return_when=FIRST_COMPLETED).done:
                        trial = running.pop(future)
                        try:
                            yield future.result()
                        except BrokenProcessPool:
                            broken = True
                            yield failed_record(trial.key, "the worker process ended without an answer"), {}


@contextlib.contextmanager
def _pool(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Yield a pool of processes, which are ended in the middle of their work if the block fails."""
    # Forking would copy an open OpenCL context, which hangs in the child.
    context = multiprocessing.get_context("spawn")
    others = multiprocessing.active_children()
    pool = ProcessPoolExecutor(jobs, mp_context=context, initializer=_prepare_worker)
    try:
        yield pool
    except BaseException:
        for process in multiprocessing.active_children():
            if process not in others:
                process.kill()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


class _Terminated(BaseException):
    """SIGTERM has come."""


@contextlib.contextmanager
def _tidy_termination() -> Iterator[None]:
    """Let SIGTERM leave the block as an exception does, which ends workers and removes folders, and end this process.

    The exit status is that of a process without a handler. One that there is already stays in place.
    """

    def leave(*_: object) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        raise _Terminated

    in_main = threading.current_thread() is threading.main_thread()
    if not in_main or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, leave)
    try:
        yield
    except _Terminated:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        signal.raise_signal(signal.SIGTERM)
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextlib.contextmanager
def _unheard_interrupts() -> Iterator[None]:
    """Hold Ctrl-C back while processes are started, which inherit that: to end the workers is left to this process."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _prepare_worker() -> None:
    """Silence warnings, which the rows tell of, and give the worker a folder of compiled kernels.

    The worker ends when the process that started it does, however that ends: it would wait for trials for ever.
    """
    warnings.simplefilter("ignore")
    threading.Thread(target=_end_with_parent, daemon=True).start()
    claim_kernel_folder()


def _end_with_parent() -> None:
    """End this process once its parent has ended."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
