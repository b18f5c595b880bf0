"""Ctrl-C as it arrives when the signal falls into a C function that does not expect exceptions."""

from __future__ import annotations


def masked_interrupt() -> SystemError:
    """Return what Python makes of a KeyboardInterrupt that a C function returns a result beside."""
    error = SystemError("<built-in function> returned a result with an exception set")
    error.__cause__ = error.__context__ = KeyboardInterrupt()
    return error
