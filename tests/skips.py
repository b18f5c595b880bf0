"""With CLALIGN_NO_SKIPS=1 a skipped test fails, unless the machine itself and no missing package is the reason.

`.ci/run` sets the variable, so that a test cannot fall silent because what it needs was forgotten.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Generator
from typing import Literal, TypeVar

import pytest

Report = TypeVar("Report", pytest.TestReport, pytest.CollectReport)

VARIABLE = "CLALIGN_NO_SKIPS"

ALLOWED = (
    "the superuser may read everything",
    "file systems cannot be mounted here",
    "has no double precision",
    "the driver here does not take the number of units from the environment",
    "geomfum brings PyTorch",
)
"""Parts of the reasons that stay: rights, hardware, its driver, and one package of several gigabytes."""


posix = pytest.mark.skipif(os.name != "posix", reason="signals, pipes and rights as POSIX has them")


@functools.cache
def backend() -> Literal["opencl", "reference"]:
    """Return which backend tests take that hold for either: numpy where there is no OpenCL device."""
    # Not before the caches of the drivers have their folders.
    from clalign.engine.device_choice import list_devices
    from clalign.errors import DeviceError

    try:
        list_devices()
    except DeviceError:
        return "reference"
    return "opencl"


def _judged(report: Report) -> Report:
    if report.skipped and os.environ.get(VARIABLE) == "1" and not hasattr(report, "wasxfail"):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longreprtext
        if not any(part in reason for part in ALLOWED):
            report.outcome = "failed"
            report.longrepr = f"{reason}\n{VARIABLE}=1: nothing may be skipped for this reason"
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Judge what a test or its set-up came to."""
    return _judged((yield))


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Judge a module that skips all it holds."""
    return _judged((yield))
