"""Which OpenCL device to use: facts about every device, and a choice that never asks on the terminal.

The choice is a function of facts and text, so that it is tested without the devices. A specification is

- empty: the first GPU, else the first CPU, else the first device of any kind;
- ``cpu``, ``gpu`` or ``accelerator``: the first device of that kind;
- ``0:1``: platform 0, device 1, as ``clalign doctor`` numbers them; ``1``: the first device of platform 1;
- anything else: part of a device's or its platform's name, upper or lower case.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from clalign.engine.loading import INSTALL_HINT, load, no_device, no_driver
from clalign.errors import DeviceError

DEVICE_VARIABLE = "CLALIGN_DEVICE"
KINDS = ("gpu", "cpu", "accelerator")


@dataclass(frozen=True)
class DeviceFacts:
    """What a device says about itself. Sizes in bytes.

    platform, device : numbers in the order of the OpenCL loader.
    kind : "gpu", "cpu", "accelerator" or "other".
    units : compute units.
    largest_buffer : size of the largest single buffer.
    largest_group : work-items of the largest work-group.
    own_local_memory : whether local memory is memory of its own, and no part of the global one.
    double : whether it has double precision.
    vector : bytes of a vector register, as far as it has any.
    """

    platform: int
    device: int
    name: str
    platform_name: str
    version: str
    driver: str
    kind: str
    units: int
    memory: int
    largest_buffer: int
    local_memory: int
    largest_group: int
    own_local_memory: bool
    double: bool
    vector: int

    @property
    def label(self) -> str:
        """One line for lists and messages."""
        return f"{self.platform}:{self.device} {self.name} ({self.kind}, {self.platform_name})"


def list_devices() -> tuple[DeviceFacts, ...]:
    """Ask the OpenCL loader for every device.

    Raises
    ------
    DeviceError
        There is no loader, no driver is registered with it, or this process was forked after OpenCL had been used.
    """
    cl = load()
    facts, names = [], []
    try:
        for number, platform in enumerate(cl.get_platforms()):
            names.append(platform.name)
            for index, device in enumerate(_devices_of(cl, platform)):
                facts.append(_facts(cl, number, index, platform, device))
    except cl.Error as error:
        raise no_driver(error) from error
    if not facts:
        raise no_device(names)
    return tuple(facts)


def _devices_of(cl: Any, platform: Any) -> list[Any]:
    try:
        return list(platform.get_devices())
    except cl.Error:
        # A platform without devices (a driver whose hardware is absent) must not hide the other platforms.
        return []


def _facts(cl: Any, number: int, index: int, platform: Any, device: Any) -> DeviceFacts:
    kinds = [kind for kind in KINDS if device.type & getattr(cl.device_type, kind.upper())]
    return DeviceFacts(
        platform=number,
        device=index,
        name=device.name.strip(),
        platform_name=platform.name.strip(),
        version=device.version.strip(),
        driver=device.driver_version.strip(),
        kind=[*kinds, "other"][0],
        units=int(device.max_compute_units),
        memory=int(device.global_mem_size),
        largest_buffer=int(device.max_mem_alloc_size),
        local_memory=int(device.local_mem_size),
        largest_group=int(device.max_work_group_size),
        own_local_memory=bool(device.local_mem_type == cl.device_local_mem_type.LOCAL),
        double=bool(device.double_fp_config),
        vector=4 * int(device.native_vector_width_float),
    )


def wanted_device(option: str) -> str:
    """Return the specification in force: the option, else ``CLALIGN_DEVICE``, else empty."""
    return option.strip() or os.environ.get(DEVICE_VARIABLE, "").strip()


def choose_device(specification: str, facts: Sequence[DeviceFacts]) -> DeviceFacts:
    """Return the device that a specification names (see the module's head).

    Raises
    ------
    DeviceError
        No such device; the message lists what there is.
    """
    if not facts:
        raise DeviceError(f"there is no OpenCL device. For a CPU driver: {INSTALL_HINT}")
    wanted = specification.strip().lower()
    if not wanted:
        ranked = sorted(facts, key=lambda f: KINDS.index(f.kind) if f.kind in KINDS else len(KINDS))
        return ranked[0]
    numbers = re.fullmatch(r"(\d+)(?::(\d+))?", wanted)
    if numbers:
        pair = (int(numbers[1]), int(numbers[2] or 0))
        found = [f for f in facts if (f.platform, f.device) == pair]
    elif wanted in KINDS:
        found = [f for f in facts if f.kind == wanted]
    else:
        found = [f for f in facts if wanted in f.name.lower() or wanted in f.platform_name.lower()]
    if not found:
        listing = "; ".join(f.label for f in facts)
        raise DeviceError(f"no OpenCL device matches {specification!r}; there are: {listing}")
    return found[0]
