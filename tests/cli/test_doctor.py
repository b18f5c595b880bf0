"""``clalign doctor`` tells a working device from every way in which OpenCL can be missing or wrong."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from skips import posix

from clalign.cli import doctor
from clalign.cli.main import main

DEVICE: dict[str, Any] = {
    "platform": 0,
    "device": 0,
    "name": "pthread",
    "platform_name": "Portable Computing Language",
    "version": "OpenCL 3.0",
    "driver": "3.0",
    "kind": "cpu",
    "units": 2,
    "memory": 2**31,
    "largest_buffer": 2**30,
    "local_memory": 2**19,
    "class": "cpu",
    "double": False,
}
GOOD = {"function": "product", "error": 1e-7, "tolerance": 1e-4, "seconds": 0.5, "agrees": True}
NO_NUMBER = {"function": "total", "error": None, "tolerance": 1e-4, "seconds": 0.5, "agrees": False}
BAD = {"function": "nearest", "error": 0.5, "tolerance": 1e-4, "seconds": 0.5, "agrees": False}


def answering(monkeypatch: pytest.MonkeyPatch, devices: dict[str, Any], checks: dict[str, Any]) -> None:
    monkeypatch.setattr(
        doctor, "probe", lambda *arguments: dict(checks) if arguments else json.loads(json.dumps(devices))
    )


@pytest.mark.usefixtures("opencl")
def test_this_machine_works() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "clalign.cli.main", "doctor", "--json"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    findings = json.loads(done.stdout)
    assert findings["works"]
    assert findings["advice"] == []
    assert findings["kernels"]["count"] == len(list((Path(__file__).parents[2] / "kernels").glob("*.cl")))
    for device in findings["devices"]:
        assert device["checks"].keys() >= {"single", "class gpu" if device["class"] == "cpu" else "class cpu"}
        for answer in device["checks"].values():
            assert all(check["agrees"] for check in answer["checks"])
    report = "\n".join(doctor.report(findings))
    for device in findings["devices"]:
        assert f"{device['platform']}:{device['device']} {device['name']}" in report
    assert "OpenCL works here." in report


def test_no_driver_names_the_install_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    answering(monkeypatch, {"error": "no OpenCL driver is installed"}, {})
    assert main(["doctor"]) == 1
    shown = capsys.readouterr().out
    assert "no OpenCL driver is installed" in shown
    assert "next\n  " in shown
    assert doctor.advice(doctor.examine(), "Linux")[0] == 'pip install "clalign[pocl]"'
    for system in ("Darwin", "Windows"):
        assert doctor.advice(doctor.examine(), system)


@pytest.mark.parametrize(
    ("checks", "message"),
    [
        ({"checks": [GOOD, BAD]}, "WRONG: nearest is off by 5.0e-01"),
        ({"checks": [NO_NUMBER]}, "WRONG: total gives no number"),
        ({"error": "the driver crashed the process (signal 11)"}, "FAILED: the driver crashed"),
    ],
)
def test_wrong_and_crashing_drivers_are_reported(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], checks: dict[str, Any], message: str
) -> None:
    answering(monkeypatch, {"devices": [DEVICE], "libraries": []}, checks)
    assert main(["doctor"]) == 1
    shown = capsys.readouterr().out
    assert message in shown
    assert "rm -r ~/.cache/pocl" in shown


@posix
def test_probe_survives_a_crash_and_a_hang(monkeypatch: pytest.MonkeyPatch) -> None:
    def child(code: str) -> None:
        monkeypatch.setattr(sys, "executable", str(fake(code)))

    folder = Path(os.environ["POCL_CACHE_DIR"]).parent

    def fake(code: str) -> Path:
        script = folder / "fake-python"
        script.write_text(f"#!/bin/sh\n{code}\n")
        script.chmod(0o755)
        return script

    child("kill -SEGV $$")
    assert "signal 11" in doctor.probe()["error"]
    child("echo broken >&2; exit 3")
    assert "broken" in doctor.probe()["error"]
    monkeypatch.setattr(doctor, "PROBE_SECONDS", 0.2)
    child("exec sleep 5")
    assert "did not answer" in doctor.probe()["error"]


def test_vendor_files_are_read_from_where_the_loader_looks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.icd").write_text("libmine.so\n")
    monkeypatch.setenv("OCL_ICD_VENDORS", str(tmp_path))
    assert doctor.vendor_files()[str(tmp_path / "mine.icd")] == "libmine.so"
    monkeypatch.setenv("OCL_ICD_VENDORS", str(tmp_path / "mine.icd"))
    assert doctor.vendor_files()[str(tmp_path / "mine.icd")] == "libmine.so"
