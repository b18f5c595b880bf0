"""Choosing a device, budgets, programs that fail, and what is not allowed to happen inside a call."""

from __future__ import annotations

import dataclasses
import subprocess
import sys

import numpy as np
import pytest

from clalign.engine import device as device_module
from clalign.engine import device_class, open_backend
from clalign.engine.device import Device, check_budget, require_precision
from clalign.engine.device_choice import DeviceFacts, choose_device, list_devices, wanted_device
from clalign.engine.kernels import Kernels
from clalign.engine.reference import Reference
from clalign.errors import DeviceError, MemoryBudgetError
from clalign.options import EngineOptions

CPU = DeviceFacts(
    0,
    0,
    "pthread-Some CPU",
    "Portable",
    "OpenCL 3.0",
    "3.0",
    "cpu",
    2,
    1 << 32,
    1 << 30,
    1 << 19,
    4096,
    False,
    True,
    32,
)
GPU = dataclasses.replace(
    CPU, platform=1, device=0, name="Radiant 9", platform_name="Vendor", kind="gpu", own_local_memory=True, double=False
)
SECOND = dataclasses.replace(GPU, device=1, name="Radiant 10")


@pytest.mark.parametrize(
    ("specification", "expected"),
    [
        ("", GPU),
        ("cpu", CPU),
        ("GPU", GPU),
        ("1:1", SECOND),
        ("0", CPU),
        ("radiant 10", SECOND),
        ("portable", CPU),
    ],
)
def test_a_specification_names_one_device(specification, expected):
    assert choose_device(specification, (CPU, GPU, SECOND)) == expected


def test_without_a_gpu_the_cpu_is_taken():
    accelerator = dataclasses.replace(CPU, kind="accelerator", device=1)
    assert choose_device("", (accelerator, CPU)) == CPU
    assert choose_device("", (accelerator,)) == accelerator


@pytest.mark.parametrize("specification", ["accelerator", "2:0", "0:7", "geforce"])
def test_a_missing_device_lists_what_there_is(specification):
    with pytest.raises(DeviceError) as caught:
        choose_device(specification, (CPU, GPU))
    assert repr(specification) in str(caught.value)
    assert "0:0 pthread-Some CPU (cpu, Portable); 1:0 Radiant 9 (gpu, Vendor)" in str(caught.value)


def test_no_device_at_all_says_what_to_install():
    with pytest.raises(DeviceError, match=r'pip install "clalign\[pocl\]"'):
        choose_device("", ())


def test_a_loader_without_drivers_says_what_to_install(monkeypatch):
    import pyopencl as cl

    def no_platforms() -> list[object]:
        raise cl.LogicError("clGetPlatformIDs failed: PLATFORM_NOT_FOUND_KHR")

    monkeypatch.setattr(cl, "get_platforms", no_platforms)
    with pytest.raises(DeviceError, match=r'no OpenCL driver is installed .*pip install "clalign\[pocl\]"'):
        list_devices()
    monkeypatch.setattr(cl, "get_platforms", list)
    with pytest.raises(DeviceError, match="no device"):
        list_devices()


def test_a_missing_loader_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyopencl", None)
    with pytest.raises(DeviceError, match=r'OpenCL cannot be loaded .*pip install "clalign\[pocl\]"'):
        list_devices()


def test_the_option_goes_before_the_environment(monkeypatch):
    monkeypatch.setenv("CLALIGN_DEVICE", " gpu ")
    assert wanted_device("cpu") == "cpu"
    assert wanted_device("") == "gpu"
    monkeypatch.delenv("CLALIGN_DEVICE")
    assert wanted_device("") == ""


@pytest.mark.usefixtures("opencl")
def test_the_environment_reaches_the_device(monkeypatch):
    monkeypatch.setenv("CLALIGN_DEVICE", "no such device")
    with pytest.raises(DeviceError, match="no such device"):
        open_backend(EngineOptions())
    assert isinstance(open_backend(EngineOptions(backend="reference")), Reference)


def test_double_precision_is_refused_where_it_is_missing():
    with pytest.raises(DeviceError, match=r"Radiant 9 .* has no double precision"):
        require_precision(GPU, "double")
    require_precision(GPU, "single")
    require_precision(CPU, "double")


@pytest.mark.parametrize(
    ("facts", "expected"),
    [
        (CPU, device_class.CPU),
        (dataclasses.replace(CPU, vector=16), device_class.CPU),
        (dataclasses.replace(CPU, vector=64), device_class.CPU_LONG_VECTORS),
        (GPU, device_class.GPU),
        (dataclasses.replace(GPU, vector=64), device_class.GPU),
        (dataclasses.replace(GPU, kind="accelerator"), device_class.GPU),
        (dataclasses.replace(CPU, kind="accelerator"), device_class.CPU),
        (dataclasses.replace(GPU, largest_group=128), device_class.CPU),
        (dataclasses.replace(GPU, local_memory=1 << 14), device_class.CPU),
    ],
)
def test_a_device_belongs_to_a_class(facts, expected):
    assert device_class.device_class(facts) == expected


def test_a_class_can_be_asked_for():
    assert device_class.device_class(GPU, 8) == device_class.GPU_DOUBLE
    assert device_class.device_class(GPU, 4, "cpu") == device_class.CPU
    assert device_class.device_class(CPU, 4, "gpu").large == device_class.GPU.large


@pytest.mark.parametrize(("needed", "left"), [((1 << 30) + 1, 1 << 32), (1000, 999)])
def test_too_large_an_array_is_refused_with_its_numbers(needed, left):
    with pytest.raises(MemoryBudgetError) as caught:
        check_budget(needed, (10, 25), left, CPU)
    for text in ("(10, 25)", f"{needed} bytes", f"{left} bytes", f"{1 << 30} bytes"):
        assert text in str(caught.value)
    check_budget(1000, (10, 25), 1000, CPU)


@pytest.mark.usefixtures("opencl")
def test_a_budget_counts_what_is_in_use_and_what_is_given_back():
    limited = Kernels(Device(memory=1 << 20))
    kept = limited.zeros(200_000)
    with pytest.raises(MemoryBudgetError, match="available"):
        limited.zeros(100_000)
    in_use = limited.device.allocated
    del kept
    assert limited.device.allocated == in_use - 800_000 - device_module.SLACK
    assert limited.device.most >= in_use
    limited.zeros(100_000)


def test_unknown_programs_and_functions_are_errors(kernels: Kernels):
    with pytest.raises(DeviceError, match="unknown kernel program 'produce'"):
        kernels.device.kernel("produce", "product")
    with pytest.raises(DeviceError, match=r"no kernel 'produce' in product\.cl; there are product, pack_panels"):
        kernels.device.kernel("product", "produce")


@pytest.mark.parametrize(
    ("program", "function", "define"),
    [
        ("nearest", "nearest", "CHECK_STEPS"),
        ("elementwise", "transpose", "TB"),
    ],
)
def test_a_missing_define_is_a_build_error_that_names_it(kernels: Kernels, capfd, program, function, define):
    with pytest.raises(DeviceError, match=rf"{program}\.cl do not build") as caught:
        kernels.device.kernel(program, function, UNKNOWN=0)
    assert f"{define} must be given" in str(caught.value) + capfd.readouterr().err


def test_kernels_are_built_once(kernels: Kernels, monkeypatch):
    first = kernels.device.kernel("reduce", "finish_rows")
    monkeypatch.setattr(kernels.device, "_build", lambda *_: pytest.fail("built again"))
    assert kernels.device.kernel("reduce", "finish_rows") is first


@pytest.mark.parametrize("kernels", ["cpu", "gpu"], indirect=True)
def test_with_out_given_nothing_is_allocated_built_or_waited_for(kernels: Kernels, rng, monkeypatch):
    c, psi = kernels.array(rng.normal(size=(200, 12))), kernels.array(rng.normal(size=(150, 12)))
    w, u, dz = kernels.array(rng.random(150)), kernels.array(rng.normal(size=(150, 9))), kernels.zeros((200, 9))
    packed, pair, dc = kernels.zeros((78, 9)), (kernels.zeros((200, 9)), kernels.zeros(200)), kernels.zeros((200, 12))
    found = (kernels.zeros(200, np.int32), kernels.zeros(200))

    def sequence() -> None:
        kernels.packed_moments(psi, w, u, out=packed)
        kernels.soft_map(c, packed, out=pair)
        kernels.soft_map_gradient(c, packed, None, *pair, dz, out=dc)
        kernels.nearest(c, psi, out=found)

    sequence()
    for name in ("_build", "allocate", "finish", "download"):
        monkeypatch.setattr(kernels.device, name, lambda *_, **__: pytest.fail("not allowed here"))
    sequence()


def test_facts_for_reports(kernels: Kernels):
    facts = kernels.describe()
    assert facts["precision"] == "float32"
    assert facts["device"] in kernels.name
    assert int(facts["budget"]) >= int(facts["allocated"]) > 0


def test_importing_the_engine_opens_nothing():
    code = "import sys, clalign.engine, clalign.engine.device; sys.exit('pyopencl' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
