"""Asks OpenCL in a process of its own, so that a driver that crashes cannot take ``clalign doctor`` with it.

``python -m clalign.cli.probe`` prints the devices as JSON; with a device number such as ``0:1`` it runs the kernels
there and prints how well they agree with numpy.
"""

from __future__ import annotations

import dataclasses
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

from clalign.errors import ClalignError
from clalign.options import Options

PROBE_SECONDS = 180.0


def probe(*arguments: str) -> dict[str, Any]:
    """Run this module in a child process; a failure of any kind becomes the key ``error``."""
    command = [sys.executable, "-m", "clalign.cli.probe", *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=PROBE_SECONDS, check=False)
    except subprocess.TimeoutExpired:
        return {"error": f"the driver did not answer within {PROBE_SECONDS:.0f} s"}
    if done.returncode < 0:
        return {"error": f"the driver crashed the process (signal {-done.returncode})"}
    try:
        answer: dict[str, Any] = json.loads(done.stdout)
    except ValueError:
        last = (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]
        return {"error": f"the driver ended the process: {last}"}
    return answer


def _answer(arguments: list[str]) -> dict[str, Any]:

    try:
        return _checks(arguments[0], arguments[1]) if arguments else _devices()
    except ClalignError as error:
        return {"error": str(error), "libraries": _libraries()}


def _devices() -> dict[str, Any]:
    from clalign.engine.device_choice import list_devices

    return {"devices": [dataclasses.asdict(facts) for facts in list_devices()], "libraries": _libraries()}


def _checks(specification: str, precision: str) -> dict[str, Any]:
    from clalign.engine import open_backend
    from clalign.engine.self_test import self_test

    options = Options().replace({"engine.device": specification, "engine.precision": precision})
    checks = self_test(open_backend(options.engine))
    return {"checks": [{**dataclasses.asdict(check), "agrees": check.agrees} for check in checks]}


def _libraries() -> list[str]:
    """Return the OpenCL loader and the drivers that this process has mapped, where the system tells (Linux)."""
    maps = Path("/proc/self/maps")
    if not maps.is_file():
        return []
    found = re.findall(r"/\S*/lib(?:OpenCL|pocl|nvidia-opencl|amdocl|igdrcl|intelocl)\S*", maps.read_text())
    return sorted(set(found))


if __name__ == "__main__":
    print(json.dumps(_answer(sys.argv[1:])))
