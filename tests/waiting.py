"""Waiting for another process or thread, not for ever."""

from __future__ import annotations

import time
from collections.abc import Callable


def wait_until(is_so: Callable[[], bool], seconds: float = 120.0) -> None:
    """Wait until something is so; fail when it still is not after `seconds`."""
    limit = time.monotonic() + seconds
    while not is_so():
        assert time.monotonic() < limit
        time.sleep(0.01)
