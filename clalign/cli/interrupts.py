"""Ctrl-C that gets through although some libraries catch everything while they are imported."""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType
from typing import Any


class Interrupts:
    """Remembers Ctrl-C inside a ``with`` block, beside the KeyboardInterrupt that it raises as ever.

    Around its optional imports trimesh catches even KeyboardInterrupt; a program that imports it lazily would run on
    for minutes after a Ctrl-C at the wrong moment.
    """

    def __init__(self) -> None:
        self._seen = False
        self._previous: Any = None

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is threading.main_thread():
            self._previous = signal.signal(signal.SIGINT, self._note)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._previous is not None:
            signal.signal(signal.SIGINT, self._previous)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self._seen = True
        signal.default_int_handler(number, frame)

    def raise_missed(self) -> None:
        """Raise the KeyboardInterrupt that something has swallowed. To be called after imports."""
        if self._seen:
            raise KeyboardInterrupt
