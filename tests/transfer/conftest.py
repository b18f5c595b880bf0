"""A result put together from a known map."""

from __future__ import annotations

import fabricated
import pytest

from clalign.correspondence import Correspondence


@pytest.fixture(scope="session")
def small() -> Correspondence:
    return fabricated.small()
