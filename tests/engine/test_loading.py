"""OpenCL where the home takes no files, in forked processes, and where the environment leads the loader astray."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from skips import posix

from clalign.cli import doctor
from clalign.engine import loading
from clalign.engine.device import Device
from clalign.engine.device_choice import list_devices
from clalign.errors import DeviceError

WORK = """
import logging, os, sys
import numpy as np
logging.basicConfig(level=logging.INFO)
from clalign.engine.device import Device
from clalign.geometry.cache import ShapeCache
device = Device()
print(device.upload(np.ones(3, np.float32)).get().sum())
cache = ShapeCache()
for number in range(6):
    cache.put(f"basis-{number:032d}", {"a": np.ones(3)})
import pyopencl
print(os.environ["POCL_CACHE_DIR"], pyopencl._PYOPENCL_NO_CACHE)
"""


def environment(**changes: str) -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if name not in ("POCL_CACHE_DIR", "CLALIGN_CACHE")}
    return {**{name: value for name, value in kept.items() if not name.startswith("XDG_")}, **changes}


def without_home(tmp_path: Path, code: str, **changes: str) -> subprocess.CompletedProcess[str]:
    """Run code where the home is a file, below which not even the superuser makes a folder."""
    home = tmp_path / "home"
    home.write_text("")
    command = [sys.executable, "-W", "error::UserWarning", "-c", code]
    return subprocess.run(
        command, capture_output=True, text=True, env=environment(HOME=str(home), **changes), timeout=300
    )


@posix
@pytest.mark.usefixtures("opencl")
def test_a_home_that_takes_no_files_is_told_once_and_does_no_harm(tmp_path: Path) -> None:
    done = without_home(tmp_path, WORK)
    assert done.returncode == 0, done.stderr
    values, (folder, no_cache) = done.stdout.splitlines()[0], done.stdout.splitlines()[1].split()
    assert values == "3.0"
    assert no_cache == "True"
    assert Path(folder).name.startswith("clalign-kernels-")
    assert not Path(folder).exists()
    assert done.stderr.count("takes no files; kernels are compiled anew") == 1
    assert done.stderr.count("cannot be written") == 1


@posix
@pytest.mark.usefixtures("opencl")
def test_what_the_user_has_set_is_left_alone(tmp_path: Path) -> None:
    done = without_home(tmp_path, WORK, POCL_CACHE_DIR=str(tmp_path / "mine"))
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[1] == f"{tmp_path / 'mine'} True"


@pytest.mark.parametrize("named", [True, False])
def test_pocl_without_a_device_names_its_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, named: bool) -> None:
    if named:
        monkeypatch.setenv("POCL_CACHE_DIR", str(tmp_path))
    else:
        monkeypatch.delenv("POCL_CACHE_DIR", raising=False)
        monkeypatch.setenv("HOME", str(tmp_path))
        monkeypatch.setenv("USERPROFILE", str(tmp_path))
    said = str(loading.no_device(["Portable Computing Language"]))
    assert said.startswith("PoCL is loaded but has no device")
    assert f"{tmp_path if named else tmp_path / '.cache' / 'pocl'}, takes no files: set POCL_CACHE_DIR" in said
    assert "pip install" not in said
    assert "pip install" in str(loading.no_device(["NVIDIA CUDA"]))
    findings = {"packages": {"pyopencl": "1"}, "kernels": {"error": None}, "works": False, "devices": [], "error": said}
    assert doctor.advice(findings, "Linux") == ["export POCL_CACHE_DIR=/a/folder/that/takes/files"]


def test_a_named_folder_that_takes_no_files_is_the_reason_of_a_failed_build(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("POCL_CACHE_DIR", str(blocked / "kernels"))
    said = loading.cache_problem("Portable Computing Language")
    assert f"POCL_CACHE_DIR is set to {blocked / 'kernels'}, which takes no files" in said
    assert loading.cache_problem("NVIDIA CUDA") == ""
    monkeypatch.setenv("POCL_CACHE_DIR", str(tmp_path / "new" / "kernels"))
    assert loading.cache_problem("Portable Computing Language") == ""


@pytest.mark.usefixtures("opencl")
def test_a_variable_that_leads_the_loader_astray_is_named(tmp_path: Path) -> None:
    code = "from clalign.cli.main import main; raise SystemExit(main(['doctor']))"
    nowhere = str(tmp_path / "nowhere")
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env={**os.environ, "OCL_ICD_VENDORS": nowhere},
        timeout=300,
    )
    assert done.returncode == 1
    assert f"no OpenCL driver is found: OCL_ICD_VENDORS is set to {nowhere}; unset it" in done.stdout
    assert done.stdout.rstrip().endswith("next\n  unset OCL_ICD_VENDORS")
    assert "driver files\n  none" in done.stdout


def opened_in_a_fork(_: int) -> str:
    try:
        Device()
    except DeviceError as error:
        return str(error)
    return "opened"


def used_in_a_fork(_: int) -> list[str]:
    said = []
    for use in (
        lambda: KEPT[0].upload(np.ones(3)),
        lambda: KEPT[0].finish(),
        lambda: KEPT[0].launch(None, 1),
        lambda: KEPT[0].kernel("gram", "none", KB=8),
    ):
        try:
            use()
            said.append("worked")
        except DeviceError as error:
            said.append(str(error))
    return said


KEPT: list[Device] = []


@posix
@pytest.mark.usefixtures("opencl")
def test_a_fork_after_use_is_an_error_and_no_hang() -> None:
    """Listing the devices is use: the driver starts its threads then."""
    assert list_devices()
    KEPT[:] = [Device()]
    with multiprocessing.get_context("fork").Pool(1) as pool:
        message = pool.map_async(opened_in_a_fork, [0]).get(60)[0]
        others = pool.map_async(used_in_a_fork, [0]).get(60)[0]
    KEPT.clear()
    assert "OpenCL was opened before this process was forked" in message
    assert 'start workers with spawn: multiprocessing.get_context("spawn")' in message
    assert others == [message] * 4


@posix
@pytest.mark.usefixtures("opencl")
def test_a_fork_before_use_works() -> None:
    code = (
        "import multiprocessing\n"
        "from clalign.engine.device import Device\n"
        "def work(_):\n"
        "    import numpy as np\n"
        "    return float(Device().upload(np.ones(3)).get().sum())\n"
        "with multiprocessing.get_context('fork').Pool(1) as pool:\n"
        "    print(pool.map_async(work, [0]).get(60))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.stdout == "[3.0]\n", done.stderr
