"""An evaluation of the objective stays on a GPU: how many kernels it queues, and where the host waits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clalign.benchmark.losses import ProblemSize, synthetic_problem
from clalign.engine.device import Device
from clalign.engine.kernels import Kernels

MOST_LAUNCHES = 47


@pytest.mark.usefixtures("opencl")
def test_an_evaluation_on_a_gpu_waits_once(monkeypatch: pytest.MonkeyPatch) -> None:
    results = []
    for kind in ("cpu", "gpu"):
        kernels = Kernels(Device(kind=kind))  # type: ignore[arg-type]
        objective, fixed, x = synthetic_problem(kernels, 90, ProblemSize(12, 24, 6))
        results.append(objective.value_and_gradient(x, fixed))
    # The gradient is built of cancelling terms, so the classes agree to fewer digits than each of their kernels.
    np.testing.assert_allclose(results[1].total, results[0].total, rtol=1e-4)
    largest = np.abs(results[0].gradient).max()
    np.testing.assert_allclose(results[1].gradient, results[0].gradient, atol=1e-3 * largest)

    waits: list[str] = []

    def counting(name: str) -> Any:
        plain = getattr(Device, name)
        return lambda *arguments: (waits.append(name), plain(*arguments))[1]

    for name in ("download", "finish"):
        monkeypatch.setattr(Device, name, counting(name))
    before = kernels.device.launches
    objective.value_and_gradient(x, fixed)
    assert waits == ["download"]
    assert kernels.device.launches - before <= MOST_LAUNCHES
