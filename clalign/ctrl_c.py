"""Ctrl-C that stays a KeyboardInterrupt wherever it falls."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


def is_interrupt(error: BaseException | None) -> bool:
    """Return whether an exception is Ctrl-C, or one that a C function made of it.

    A signal handler may run inside a C function that does not look for exceptions (numpy's dispatcher of ``__array_
    function__`` is one). Python then reports a SystemError, "returned a result with an exception set", with the
    KeyboardInterrupt as its cause.
    """
    while isinstance(error, SystemError):
        error = error.__cause__
    return isinstance(error, KeyboardInterrupt)


@contextmanager
def plain_interrupts() -> Iterator[None]:
    """Raise Ctrl-C inside as KeyboardInterrupt, whatever a C function made of it; as a decorator, too."""
    try:
        yield
    except SystemError as error:
        if is_interrupt(error):
            raise KeyboardInterrupt from error
        raise
