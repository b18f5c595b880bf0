"""Predicted memory and time against what matches really take, and matches that are refused as they will not fit."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from clalign import resources
from clalign.benchmark.calibration import SIZES, measured
from clalign.benchmark.generated import generated_pair
from clalign.errors import MemoryBudgetError
from clalign.options import Options
from clalign.presets import PRESETS
from clalign.resources import available_memory, calibration, forecast, require_memory

GIB, MIB = 2**30, 2**20
CPU = {"device": "pthread", "kind": "cpu", "memory": 10 * GIB, "largest_buffer": 4 * GIB}
GPU = {**CPU, "device": "card", "kind": "gpu"}
WITHIN = 1.5

STORED = calibration()["measured"]


def near(predicted: float, found: float) -> bool:
    return found / WITHIN < predicted < found * WITHIN


@pytest.mark.usefixtures("opencl")
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the measure is an upper bound")
@pytest.mark.parametrize(
    ("vertices", "changes"),
    [
        (642, PRESETS["fast"]),
        (642, PRESETS["fast"] | {"engine.backend": "reference"}),
        (2500, PRESETS["fast"]),
    ],
)
def test_memory_of_a_real_match_is_predicted_within_a_factor_of_one_and_a_half(
    vertices: int, changes: dict[str, Any]
) -> None:
    problem = generated_pair(vertices, seed=5)
    found = measured("generated", (problem.source, problem.target), changes, None)
    predicted = forecast(vertices, vertices, Options().replace(changes))
    assert near(predicted.memory, found.memory), (predicted.memory / MIB, found.memory / MIB)
    # Of smaller meshes it is mostly the scratch memory of the search, whatever their size.
    if found.device_memory and vertices > 1000:
        assert near(predicted.device_memory, found.device_memory)


@pytest.mark.parametrize("one", STORED, ids=lambda one: f"{one['name']} {one['vertices'][0]} {one['changes']}")
def test_what_the_calibration_measured_is_predicted(one: dict[str, Any]) -> None:
    """The coefficients were fitted to these numbers, but for the bundled pair, by whatever `terms` was then."""
    options = Options().replace(one["changes"])
    predicted = forecast(*one["vertices"], options, processors=1)
    assert near(predicted.memory, one["memory"])
    # Times of numpy in place of a device are not predicted.
    if one["device_memory"]:
        assert near(predicted.device_memory, one["device_memory"])
        assert near(sum(predicted.stages[stage] for stage in one["work"]), sum(one["work"].values()))


def test_the_calibration_covers_sizes_from_small_to_large_and_a_pair_that_it_was_not_fitted_to() -> None:
    default = [(one["name"], one["vertices"]) for one in STORED if not one["changes"]]
    assert default == [*(("generated", [size, size]) for size in SIZES), ("bundled", [6890, 6890])]
    assert calibration()["machine"]["processor"]
    assert 0 < calibration()["parallel"] <= 1


@pytest.mark.parametrize("size", [300, 5000, 200_000])
def test_more_of_anything_needs_more(size: int) -> None:
    base = forecast(size, size, Options(), processors=2)
    for counts, changes in (
        ((2 * size, size), {}),
        ((size, 2 * size), {}),
        ((size, size), {"spectrum.scale_invariant": 700}),
        ((size, size), {"spectrum.refinement": 900}),
        ((size, size), {"geodesics.factor_samples": 200}),
        ((size, size), {"engine.precision": "double"}),
        ((size, size), {"search.alternatives": 2}),
    ):
        other = forecast(*counts, Options().replace(changes), processors=2)
        assert other.memory >= base.memory
        assert other.device_memory >= base.device_memory
        assert other.largest_buffer >= base.largest_buffer
        assert other.seconds >= base.seconds
    large = forecast(2 * size, 2 * size, Options(), processors=2)
    assert large.memory > base.memory
    assert large.device_memory > base.device_memory
    assert large.seconds > base.seconds
    assert forecast(size, size, Options(), processors=8).seconds < base.seconds


@pytest.mark.parametrize(
    ("less", "more", "what"),
    [
        ({}, {"engine.precision": "double"}, "memory"),
        ({}, {"engine.backend": "reference"}, "memory"),
        ({"spectrum.scale_invariant": 200}, {}, "memory"),
        ({}, {"spectrum.refinement": 400}, "memory"),
        ({"spectrum.scale_invariant": 200}, {}, "device_memory"),
        ({}, {"alignment.samples": 0}, "device_memory"),
        ({"search.method": "random"}, {}, "seconds"),
        ({"readout.refine": "none"}, {}, "seconds"),
        ({}, {"spectrum.metric": "auto"}, "seconds"),
        ({}, {"search.alternatives": 3}, "seconds"),
        ({"alignment.outer_iterations": 0}, {}, "seconds"),
        (PRESETS["fast"], {}, "seconds"),
        ({}, PRESETS["paper"], "seconds"),
    ],
)
def test_options_that_change_much_change_the_forecast(less: dict[str, Any], more: dict[str, Any], what: str) -> None:
    few, many = (forecast(20_000, 25_000, Options().replace(changes), processors=2) for changes in (less, more))
    assert getattr(many, what) > 1.01 * getattr(few, what)


def test_a_device_with_memory_of_its_own_leaves_the_machine_more() -> None:
    shared, apart = (forecast(25_000, 25_000, Options(), shared=value) for value in (True, False))
    assert apart.memory < shared.memory
    assert apart.device_memory == shared.device_memory > apart.largest_buffer


def test_small_meshes_have_fewer_functions_than_asked_for() -> None:
    assert forecast(300, 300, Options()) == forecast(300, 300, Options().replace({"spectrum.scale_invariant": 700}))


def test_what_fits_is_let_through_with_its_forecast() -> None:
    for device in (None, CPU, GPU):
        predicted = require_memory(2562, 2562, Options(), device)
        assert 0 < predicted.memory < 2 * GIB


@pytest.mark.parametrize(
    ("changes", "device", "words"),
    [
        ({"engine.memory": 100 * MIB}, CPU, "engine.memory allows 100 MiB"),
        ({}, {**GPU, "memory": 64 * MIB}, r"needs about \d+ MiB on the device, card has 64 MiB"),
        ({}, {**GPU, "largest_buffer": MIB}, r"needs about 14 MiB in one buffer, card has 1 MiB"),
    ],
)
def test_what_does_not_fit_is_refused_with_numbers_and_a_way_out(
    changes: dict[str, int], device: dict[str, object], words: str
) -> None:
    with pytest.raises(MemoryBudgetError, match=words) as caught:
        require_memory(10_242, 10_242, Options().replace(changes), device)
    message = str(caught.value)
    assert message.startswith("a match of 10,242 with 10,242 vertices needs about ")
    assert "--preset fast" in message
    assert "\n" not in message


def test_a_small_machine_is_asked_for_what_it_has_free(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resources, "available_memory", lambda: 300 * MIB)
    with pytest.raises(MemoryBudgetError, match="this machine has free 300 MiB"):
        require_memory(10_242, 10_242, Options())
    # Who gives a limit knows better, and a machine that tells nothing is trusted.
    assert require_memory(10_242, 10_242, Options().replace({"engine.memory": 8 * GIB}))
    monkeypatch.setattr(resources, "available_memory", lambda: None)
    assert require_memory(10_242, 10_242, Options())


def test_memory_of_this_machine_and_of_a_container(tmp_path: Path) -> None:
    free = available_memory()
    assert free is None or 50 * MIB < free < 2**50
    for name, content in (("memory.max", "1000\n"), ("memory.current", "700\n"), ("memory.stat", "inactive_file 50\n")):
        (tmp_path / name).write_text(content)
    assert resources._group_memory(tmp_path) == 350
    (tmp_path / "memory.max").write_text("max\n")
    assert resources._group_memory(tmp_path) is None
    assert resources._group_memory(tmp_path / "none") is None
