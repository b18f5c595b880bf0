"""Ctrl-C gets through even where a library swallows it."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading

import pytest
from skips import posix

from clalign.cli.match import missed_interrupts


def test_swallowed_interrupt_is_raised_again() -> None:
    before = signal.getsignal(signal.SIGINT)
    with missed_interrupts() as raise_missed:
        raise_missed()
        with contextlib.suppress(BaseException):
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            raise_missed()
    assert signal.getsignal(signal.SIGINT) is before


def test_interrupt_raises_at_once_as_ever() -> None:
    with missed_interrupts(), pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_other_threads_may_use_it_without_effect() -> None:
    before = signal.getsignal(signal.SIGINT)
    failures: list[BaseException] = []

    def work() -> None:
        try:
            with missed_interrupts() as raise_missed:
                raise_missed()
        except BaseException as error:
            failures.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert failures == []
    assert signal.getsignal(signal.SIGINT) is before


@posix
def test_an_interrupted_program_whose_reader_has_gone_ends_as_ever() -> None:
    """Ctrl-C ends every program of a pipe, the reader first, when there is still something to be written to it."""
    interrupted = """
from clalign.cli import main
def command():
    print("a line that is still in the buffer")
    return main.EXIT_INTERRUPTED
main.main = command
main.program()
"""
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "wb") as closed:
        done = subprocess.run(
            [sys.executable, "-c", interrupted],
            stdout=closed,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            timeout=100,
            env={**os.environ, "PYTHONUNBUFFERED": ""},
        )
    assert (done.returncode, done.stderr) == (130, "")
