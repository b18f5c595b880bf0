"""Devices that lack something or fail in the middle, through the device layer up to what the user reads."""

from __future__ import annotations

import dataclasses
import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from quick import QUICK, Run, left_in

from clalign.cli import doctor
from clalign.cli.main import main
from clalign.engine import device as device_layer
from clalign.engine.device import Device
from clalign.engine.device_choice import list_devices
from clalign.errors import DeviceError, MemoryBudgetError

MIB = 2**20


def changed_devices(monkeypatch: pytest.MonkeyPatch, **changes: Any) -> None:
    """Let every device of this machine say something else about itself."""
    facts = tuple(dataclasses.replace(device, **changes) for device in list_devices())
    monkeypatch.setattr(device_layer, "list_devices", lambda: facts)


class FailingKernel:
    """A kernel that refuses to be launched."""

    function_name = "stand_in"

    def __call__(self, *_: Any) -> None:
        import pyopencl as cl

        raise cl.RuntimeError("clEnqueueNDRangeKernel failed: OUT_OF_RESOURCES")


def failing_launch(monkeypatch: pytest.MonkeyPatch, after: int) -> None:
    """Let kernels fail after so many launches."""
    plain, count = Device.launch, 0

    def launch(self: Device, kernel: Any, *arguments: Any, **options: Any) -> None:
        nonlocal count
        count += 1
        plain(self, kernel if count <= after else FailingKernel(), *arguments, **options)

    monkeypatch.setattr(Device, "launch", launch)


def failing_copy(monkeypatch: pytest.MonkeyPatch, after: int) -> None:
    """Let uploads and downloads fail after so many."""
    import pyopencl as cl

    plain, count = cl.enqueue_copy, 0

    def copy(*arguments: Any, **options: Any) -> Any:
        nonlocal count
        count += 1
        if count > after:
            raise cl.RuntimeError("clEnqueueReadBuffer failed: DEVICE_NOT_AVAILABLE")
        return plain(*arguments, **options)

    monkeypatch.setattr(cl, "enqueue_copy", copy)


def failing_buffer(monkeypatch: pytest.MonkeyPatch, after: int) -> None:
    """Let the driver run out of memory after so many buffers."""
    import pyopencl as cl

    plain, count = cl.Buffer, 0

    def buffer(*arguments: Any, **options: Any) -> Any:
        nonlocal count
        count += 1
        if count > after:
            raise cl.MemoryError("create_buffer failed: MEM_OBJECT_ALLOCATION_FAILURE")
        return plain(*arguments, **options)

    monkeypatch.setattr(cl, "Buffer", buffer)


@pytest.mark.parametrize("after", [0, 3, 20])
@pytest.mark.parametrize(
    ("fail", "message"),
    [
        (failing_launch, "failed while starting the kernel stand_in (clEnqueueNDRangeKernel failed: OUT_OF_RESOURCES)"),
        (failing_copy, "DEVICE_NOT_AVAILABLE"),
        (failing_buffer, "failed while allocating"),
    ],
)
@pytest.mark.usefixtures("opencl")
def test_a_device_that_fails_in_the_middle(
    match: Run,
    facts: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    fail: Callable[[pytest.MonkeyPatch, int], None],
    message: str,
    after: int,
) -> None:
    fail(monkeypatch, after)
    shown = match(tmp_path / "out", "--no-cache", device="")
    assert shown.status == 1
    lines = shown.err.splitlines()
    assert lines[0].startswith("error: 0:0 ")
    assert message in lines[0]
    assert lines[1:] == facts
    assert shown.out == ""
    assert left_in(tmp_path) == []


@pytest.mark.usefixtures("opencl")
def test_no_double_precision(match: Run, facts: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    changed_devices(monkeypatch, double=False)
    shown = match(tmp_path / "out", "--set", "engine.precision=double", device="")
    assert shown.status == 1
    assert "has no double precision; use single precision (engine.precision)" in shown.err.splitlines()[0]
    assert shown.err.splitlines()[1:] == facts
    assert left_in(tmp_path) == []
    # Single precision, the default, asks nothing of such a device.
    assert match(tmp_path / "out", device="").status == 0


@pytest.mark.usefixtures("opencl")
def test_a_device_of_64_mib(tmp_path: Path, match: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """What does not fit is refused before it is tried; what fits is computed."""
    changed_devices(monkeypatch, memory=64 * MIB, largest_buffer=16 * MIB)
    opened = Device()
    with pytest.raises(MemoryBudgetError, match=r"shape \(5000000,\) needs 2\d{7} bytes .* largest buffer is 16777216"):
        opened.allocate((5_000_000,), np.float32)
    kept = [opened.allocate((3_000_000,), np.float32) for _ in range(5)]
    with pytest.raises(MemoryBudgetError, match="are available"):
        opened.allocate((3_000_000,), np.float32)
    del kept
    assert opened.allocate((3_000_000,), np.float32).size == 3_000_000
    assert match(tmp_path / "out", device="").status == 0


@pytest.mark.usefixtures("opencl")
def test_a_budget_that_the_match_exceeds(match: Run, facts: list[str], tmp_path: Path) -> None:
    shown = match(tmp_path / "out", "--set", "engine.memory=30000", device="")
    assert shown.status == 1
    assert shown.err.startswith("error: ")
    assert "memory" in shown.err.splitlines()[0]
    assert shown.err.splitlines()[1:] == facts
    assert left_in(tmp_path) == []


@pytest.mark.usefixtures("opencl")
def test_every_opencl_failure_begins_with_the_facts(match: Run, tmp_path: Path) -> None:
    """The real question to the drivers, in a process of its own."""
    shown = match(tmp_path / "out", device="abacus")
    assert shown.status == 1
    lines = shown.err.splitlines()
    assert lines[0].startswith("error: no OpenCL device matches 'abacus'; there are: 0:0 ")
    assert lines[1].startswith("OpenCL: pyopencl ")
    listed = list_devices()
    for device, line in zip(listed, lines[2:], strict=False):
        assert line.startswith(f"device {device.platform}:{device.device} {device.name} ({device.kind}")
        assert "largest buffer" in line
    assert lines[2 + len(listed) :] == ["next: run 'clalign doctor', which tries the kernels on every device"]


def test_a_broken_driver_cannot_hide_the_error(match: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "probe", lambda *_: {"error": "the driver crashed the process (signal 11)"})
    lines = match(tmp_path / "out", device="abacus").err.splitlines()
    assert lines[0].startswith("error: ")
    assert "devices: the driver crashed the process (signal 11)" in lines
    assert lines[-1].startswith("next: ")


@pytest.mark.skipif(sys.platform != "linux", reason="hides drivers in the way of the loader of Linux wheels")
def test_without_any_driver_the_next_command_is_named(pair: tuple[Path, Path], tmp_path: Path) -> None:
    """Python sees a copy of pyopencl without its driver, and the system's folder of drivers is empty."""
    spec = importlib.util.find_spec("pyopencl")
    assert spec is not None
    assert spec.origin is not None
    shutil.copytree(
        Path(spec.origin).parent, tmp_path / "packages" / "pyopencl", ignore=shutil.ignore_patterns("*.icd", "libpocl*")
    )
    (tmp_path / "vendors").mkdir()
    (tmp_path / "work").mkdir()
    environment = {
        **os.environ,
        "PYTHONPATH": str(tmp_path / "packages"),
        "OCL_ICD_VENDORS": str(tmp_path / "vendors"),
    }
    for command in (["match", *map(str, pair), *QUICK], ["doctor"]):
        done = subprocess.run(
            [sys.executable, "-m", "clalign.cli.main", *command],
            capture_output=True,
            text=True,
            check=False,
            env=environment,
            cwd=tmp_path / "work",
            timeout=120,
        )
        assert done.returncode == 1
        shown = done.stderr + done.stdout
        assert "Traceback" not in shown
        assert f"no OpenCL driver is found: OCL_ICD_VENDORS is set to {tmp_path / 'vendors'}; unset it" in shown
        assert "unset OCL_ICD_VENDORS" in shown
        assert "next" in shown
    assert left_in(tmp_path / "work") == []


@pytest.mark.usefixtures("opencl")
def test_errors_of_the_device_stay_what_they_are_in_python(
    pair: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    import clalign
    from clalign.options import Options

    failing_launch(monkeypatch, 2)
    options = Options().replace(
        {"search.method": "random", "alignment.outer_iterations": 1, "spectrum.scale_invariant": 24}
    )
    with pytest.raises(DeviceError, match="OUT_OF_RESOURCES") as caught:
        clalign.match(*pair, options)
    assert type(caught.value.__cause__).__module__.startswith("pyopencl")
    assert main(["cache", "info"]) == 0
