"""Prepared shapes of a few hundred vertices, and alignment problems bound to a backend."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from prepared import MIDDLE, SMALL, Bound, PreparedPair, bound, prepared_pair, tiny_pair
from shapes import Pair

from clalign.engine import Backend, open_backend


@pytest.fixture(scope="session")
def small() -> PreparedPair:
    """162 vertices each, 16 LBO functions, 20 descriptors."""
    return prepared_pair(tiny_pair(), SMALL)


@pytest.fixture(scope="session")
def middle(bumpy_pair: Pair) -> PreparedPair:
    """642 vertices each, 60 LBO functions, 60 descriptors."""
    return prepared_pair(bumpy_pair, MIDDLE)


@pytest.fixture(scope="session")
def kernels() -> Backend:
    return open_backend()


@pytest.fixture(scope="session")
def bind_small(small: PreparedPair) -> Callable[..., Bound]:
    """``bind_small(changes, backend=None)``: the small pair bound with some options changed."""

    def make(changes: dict[str, Any] | None = None, backend: Backend | None = None) -> Bound:
        return bound(small, SMALL.replace(changes or {}), backend)

    return make
