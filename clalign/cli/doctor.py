"""``clalign doctor``: what OpenCL finds here, whether the kernels compute correctly, and what to do if not.

OpenCL is asked in a process of its own, so that a driver that crashes cannot take this one with it: ``python -m
clalign.cli.doctor`` prints the devices as JSON; with a device number such as ``0:1``, a precision and a class of
kernels it runs those there and prints how well they agree with numpy.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib.metadata
import importlib.util
import json
import math
import os
import platform
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

from clalign.cli.terminal import Terminal, table
from clalign.errors import ClalignError, DeviceError
from clalign.options import Options
from clalign.storage.files import KERNEL_VARIABLE, size_text

PACKAGES = ("numpy", "scipy", "trimesh", "pyopencl", "nlopt", "potpourri3d")
VARIABLES = (
    "CLALIGN_DEVICE",
    "CLALIGN_CACHE",
    "OCL_ICD_VENDORS",
    "OCL_ICD_FILENAMES",
    "OPENCL_VENDOR_PATH",
    KERNEL_VARIABLE,
    "POCL_MAX_PTHREAD_COUNT",
    "OMP_NUM_THREADS",
)
SYSTEM_VENDORS = Path("/etc/OpenCL/vendors")
PROBE_SECONDS = 180.0


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``doctor`` to the program."""
    parser = subparsers.add_parser(
        "doctor",
        help="examine OpenCL on this machine",
        description="List the OpenCL loader, drivers and devices, run kernels on each device and compare them with "
        "numpy, and name the next command when something is missing. Exit status 0: a device works; 1: none does.",
    )
    parser.add_argument("--json", action="store_true", help="print the findings as one JSON document")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Examine, print, and return 0 if matching works on some device."""
    findings = examine()
    terminal = Terminal(as_json=args.json)
    for line in report(findings):
        terminal.say(line)
    terminal.document(findings)
    return 0 if findings["works"] else 1


def examine() -> dict[str, Any]:
    """Return every fact of this machine that decides whether OpenCL works, as plain values."""
    found = probe()
    devices = found.get("devices", [])
    for device in devices:
        number, other = f"{device['platform']}:{device['device']}", "cpu" if device["class"] == "gpu" else "gpu"
        runs = {"single": ("single", "auto"), "double": ("double", "auto"), f"class {other}": ("single", other)}
        if not device["double"]:
            del runs["double"]
        device["checks"] = {name: probe(number, *arguments) for name, arguments in runs.items()}
    findings: dict[str, Any] = {
        "system": {
            "machine": f"{platform.system()} {platform.release()}, {platform.machine()}, {os.cpu_count()} cores",
            "python": f"{platform.python_version()} in {sys.prefix}",
        },
        "packages": {name: _version(name) for name in ("clalign", *PACKAGES)},
        "variables": {name: os.environ[name] for name in VARIABLES if name in os.environ},
        "vendor_files": vendor_files(),
        "libraries": found.get("libraries", []),
        "kernels": _kernels(),
        "error": found.get("error"),
        "devices": devices,
    }
    findings["works"] = any(
        passed(answer)
        for device in devices
        for name, answer in device["checks"].items()
        if not name.startswith("class")
    )
    findings["advice"] = advice(findings, platform.system())
    return findings


def brief(message: str = "") -> list[str]:
    """Return the facts that belong to every failure of OpenCL: loader, drivers, devices, and the next command.

    No kernel is run for them; the question goes to a process of its own, so that a broken driver cannot end this one.

    Parameters
    ----------
    message : of the failure; it is not repeated.
    """
    found = probe()
    devices = found.get("devices", [])
    pyopencl = _version("pyopencl")
    libraries = ", ".join(Path(path).name for path in found.get("libraries", [])) or "no loader or driver is in use"
    drivers = ", ".join(f"{Path(file).name} -> {library}" for file, library in vendor_files().items()) or "none"
    lines = [f"OpenCL: pyopencl {pyopencl or 'is missing'}; {libraries}; driver files: {drivers}"]
    lines += [_device_line(device) for device in devices]
    if found.get("error", message) != message:
        lines.append(f"devices: {found['error']}")
    if devices:
        return [*lines, "next: run 'clalign doctor', which tries the kernels on every device"]
    findings: dict[str, Any] = {
        "packages": {"pyopencl": pyopencl},
        "kernels": _kernels(),
        "works": False,
        "devices": [],
        "error": found.get("error"),
    }
    return [*lines, f"next: {advice(findings, platform.system())[0]}; then 'clalign doctor'"]


def _device_line(device: dict[str, Any]) -> str:
    return (
        f"device {device['platform']}:{device['device']} {device['name']} ({device['kind']}, "
        f"{device['platform_name']}, driver {device['driver']}): {_memory(device)}, "
        f"{'double' if device['double'] else 'no double'} precision"
    )


def _memory(device: dict[str, Any]) -> str:
    return f"{size_text(device['memory'])}, largest buffer {size_text(device['largest_buffer'])}"


def passed(answer: dict[str, Any]) -> bool:
    """Return whether a device's kernels ran and agreed."""
    return "error" not in answer and all(check["agrees"] for check in answer["checks"])


def vendor_files() -> dict[str, str]:
    """Return the driver files that OpenCL loaders read, each with the library that it names."""
    named = os.environ.get("OCL_ICD_VENDORS")
    folders = [Path(named or SYSTEM_VENDORS)]
    wheel = None if named else importlib.util.find_spec("pyopencl")
    if wheel is not None and wheel.origin is not None:
        folders.append(Path(wheel.origin).parent / ".libs")
    files = [folder] if (folder := folders[0]).suffix == ".icd" and folder.is_file() else []
    files += [file for folder in folders if folder.is_dir() for file in sorted(folder.glob("*.icd"))]
    return {str(file): file.read_text(encoding="utf-8", errors="replace").strip() for file in files}


def advice(findings: dict[str, Any], system: str) -> list[str]:
    """Return the next commands, most useful first; none when everything works.

    Parameters
    ----------
    findings : as from `examine`.
    system : "Linux", "Darwin" or "Windows".
    """
    if findings["packages"]["pyopencl"] is None:
        return ["pip install pyopencl"]
    if findings["kernels"]["error"] is not None:
        return ["pip install --force-reinstall --no-deps clalign"]
    if findings["works"]:
        return []
    if not findings["devices"]:
        said = re.search(r"(?:(\w+) is set to .*; unset it|set (\w+) to a folder)", findings.get("error") or "")
        if said:
            return [f"unset {said[1]}" if said[1] else f"export {said[2]}=/a/folder/that/takes/files"]
        if "Linux" in system:
            return ['pip install "clalign[pocl]"', "or, on Debian and Ubuntu: apt install pocl-opencl-icd"]
        if system == "Darwin":
            return ["conda install -c conda-forge pocl pyopencl", "clalign match A B --device reference  # no OpenCL"]
        return [
            "pip install intel-opencl-rt  # a CPU driver, or install the graphics card's driver",
            "clalign match A B --device reference  # no OpenCL",
        ]
    commands = ["clalign match A B --device reference  # computes with numpy meanwhile"]
    for device in findings["devices"]:
        others = [name for name, answer in device["checks"].items() if name.startswith("class") and passed(answer)]
        commands[:0] = [
            f"clalign match A B --set engine.device_{name.replace(' ', '=')}  # they do compute" for name in others
        ]
    if any("Portable Computing Language" in device["platform_name"] for device in findings["devices"]):
        commands.insert(0, "rm -r ~/.cache/pocl  # a damaged kernel cache of PoCL looks like a failing driver")
    return commands


def report(findings: dict[str, Any]) -> list[str]:
    """Return the findings as lines for a person."""
    versions = ", ".join(f"{name} {version or 'missing'}" for name, version in findings["packages"].items())
    lines = ["system", *table(list(findings["system"].items())), "packages", f"  {versions}"]
    if findings["variables"]:
        lines += ["environment", *table(list(findings["variables"].items()))]
    lines += ["OpenCL loader and drivers in use", *(f"  {path}" for path in findings["libraries"])]
    if not findings["libraries"]:
        lines.append("  none seen")
    lines.append("driver files")
    lines += [f"  {file} -> {library}" for file, library in findings["vendor_files"].items()] or ["  none"]
    kernels = findings["kernels"]
    lines += ["kernels", f"  {kernels['error'] or '{count} files in {folder}'.format(**kernels)}"]
    lines.append("devices")
    if findings["error"]:
        lines.append(f"  {findings['error']}")
    for device in findings["devices"]:
        lines += _device_lines(device)
    if findings["works"]:
        lines.append("OpenCL works here.")
    if findings["advice"]:
        lines += ["next", *(f"  {command}" for command in findings["advice"])]
    return lines


def _device_lines(device: dict[str, Any]) -> list[str]:
    rows = [
        ("platform", f"{device['platform_name']}, {device['version']}"),
        ("driver", device["driver"]),
        ("units", str(device["units"])),
        ("class", f"kernels of {device['class'].upper()}s"),
        ("memory", _memory(device)),
        ("double precision", "yes" if device["double"] else "no"),
    ]
    rows += [(f"kernels, {precision}", _check_line(answer)) for precision, answer in device["checks"].items()]
    return [
        f"  {device['platform']}:{device['device']} {device['name']} ({device['kind']})",
        *table(rows, indent="      "),
    ]


def _check_line(answer: dict[str, Any]) -> str:
    if "error" in answer:
        return f"FAILED: {answer['error']}"
    checks = answer["checks"]
    seconds = sum(check["seconds"] for check in checks)
    wrong = [
        f"{check['function']} " + ("gives no number" if check["error"] is None else f"is off by {check['error']:.1e}")
        for check in checks
        if not check["agrees"]
    ]
    if wrong:
        return "WRONG: " + ", ".join(wrong)
    worst = max(check["error"] for check in checks)
    return f"{len(checks)} agree with numpy to {worst:.0e}, built and run in {seconds:.1f} s"


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _kernels() -> dict[str, Any]:
    from clalign.engine.programs import kernel_folder

    try:
        folder = kernel_folder()
    except DeviceError as error:
        return {"folder": None, "count": 0, "error": str(error)}
    return {"folder": str(folder), "count": len(list(folder.glob("*.cl"))), "error": None}


def probe(*arguments: str) -> dict[str, Any]:
    """Run this module in a child process; a failure of any kind becomes the key ``error``."""
    command = [sys.executable, "-m", "clalign.cli.doctor", *arguments]
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
    """Return the checks of a device by number, precision and class, or without arguments all devices."""
    try:
        from clalign.engine import open_backend
        from clalign.engine.device_choice import list_devices
        from clalign.engine.device_class import class_name
        from clalign.engine.self_test import self_test

        if not arguments:
            devices = [{**dataclasses.asdict(facts), "class": class_name(facts)} for facts in list_devices()]
            return {"devices": devices, "libraries": _libraries()}
        names = ("engine.device", "engine.precision", "engine.device_class")
        options = Options().replace(dict(zip(names, arguments, strict=True)))
        checks = self_test(open_backend(options.engine))
        # JSON has no word for what is not a number.
        errors = [check.error if math.isfinite(check.error) else None for check in checks]
        facts = [{**dataclasses.asdict(check), "agrees": check.agrees} for check in checks]
        return {"checks": [fact | {"error": error} for fact, error in zip(facts, errors, strict=True)]}
    except ClalignError as error:
        return {"error": str(error), "libraries": _libraries()}


def _libraries() -> list[str]:
    """Return the OpenCL loader and the drivers that this process has mapped, where the system tells (Linux)."""
    maps = Path("/proc/self/maps")
    if not maps.is_file():
        return []
    found = re.findall(r"/\S*/lib(?:OpenCL|pocl|nvidia-opencl|amdocl|igdrcl|intelocl)\S*", maps.read_text())
    return sorted(set(found))


if __name__ == "__main__":
    print(json.dumps(_answer(sys.argv[1:])))
