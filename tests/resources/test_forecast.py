"""Predicted memory against what a process really takes, and matches that are refused because they will not fit."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from clalign.resources.forecast import available_memory, forecast, require_memory, sizes

from clalign.errors import MemoryBudgetError
from clalign.options import Options
from clalign.resources import forecast as forecasts

GIB, MIB = 2**30, 2**20
CPU = {"device": "pthread", "kind": "cpu", "memory": 10 * GIB, "largest_buffer": 4 * GIB}
GPU = {**CPU, "device": "card", "kind": "gpu"}

MEASURE = """
import sys, warnings
sys.path.insert(0, sys.argv[1])
warnings.simplefilter("ignore")
import shapes, clalign
from clalign.benchmark.memory import PeakMemory
from clalign.options import Options
vertices, faces = shapes.bumpy_sphere(4)
options = Options.preset("fast").replace({"search.method": "random", "engine.backend": "reference"})
with PeakMemory() as memory:
    clalign.match((vertices, faces), (shapes.bent(vertices, 0.3), faces), options)
print(memory.peak)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the measure is an upper bound")
def test_memory_of_a_real_match_is_predicted_within_a_factor_of_two() -> None:
    command = [sys.executable, "-c", MEASURE, str(Path(__file__).parents[1])]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=200)
    options = Options.preset("fast").replace({"engine.backend": "reference"})
    predicted = forecast(2562, 2562, options).match_memory
    assert 0.5 < predicted / int(done.stdout) < 2.0


def test_sizes_of_small_and_of_large_meshes() -> None:
    small = sizes(162, 300, Options())
    assert (small.descriptors, small.functions, small.basis, small.losses) == (54, 54, 54, 162)
    large = sizes(50_000, 50_000, Options())
    assert (large.descriptors, large.functions, large.basis) == (352, 200, 120)
    assert (large.samples, large.rows, large.rank) == (400, 100, 50)
    assert sizes(5000, 5000, Options.preset("paper")).losses == 5000


def test_a_soft_map_onto_few_vertices_is_predicted_to_cost_less() -> None:
    """It is streamed, but for the cycle term; a pass over the packed pairs does not depend on the vertices."""

    def evaluation(vertices: int, cycle: bool) -> float:
        options = Options().replace({"alignment.cycle": cycle, "readout.steps": 0})
        return forecast(2000, vertices, options, processors=1).stages["alignment"]

    assert evaluation(500, False) < 0.7 * evaluation(500, True)
    assert evaluation(5000, False) == evaluation(5000, True)


def test_more_of_anything_needs_more() -> None:
    base = forecast(5000, 5000, Options(), processors=2)
    for counts, changes in (
        ((10_000, 5000), {}),
        ((5000, 10_000), {}),
        ((5000, 5000), {"spectrum.descriptors": 700}),
        ((5000, 5000), {"spectrum.refinement": 900}),
        ((5000, 5000), {"engine.precision": "double"}),
    ):
        other = forecast(*counts, Options().replace(changes), processors=2)
        assert other.match_memory > base.match_memory
        assert other.memory >= base.memory
        assert other.seconds >= base.seconds
    assert forecast(5000, 5000, Options(), processors=8).seconds < base.seconds


def test_helpers_of_large_meshes_count_where_they_are_started() -> None:
    """One more processor: one more interpreter, each with rows and factors of its mesh."""
    size = sizes(50_000, 50_000, Options())
    rows = 4 * size.samples * 50_000
    one, two, many = (forecast(50_000, 50_000, Options(), processors=number).host for number in (1, 2, 16))
    assert two["preparation"] - one["preparation"] > rows + forecasts.HELPER_BYTES
    assert many == two
    assert all(two[stage] == one[stage] for stage in one if stage != "preparation")
    # Too small a mesh is sampled here; then a second processor only means that both are at work at once.
    small = [forecast(600, 600, Options(), processors=number).match_memory for number in (1, 2)]
    assert 0 <= small[1] - small[0] < forecasts.HELPER_BYTES / 2


@pytest.mark.parametrize("alternatives", [1, 3])
def test_growing_takes_its_time_for_every_map(alternatives: int) -> None:
    def up_sampling(changes: dict[str, object], count: int = 5000) -> float:
        return forecast(count, count, Options().replace(changes), processors=1).stages["refinement"]

    base = up_sampling({})
    assert up_sampling({"search.alternatives": alternatives}) == pytest.approx((1 + alternatives) * base)
    assert up_sampling({}, 10_000) > 1.5 * base
    assert 0 < up_sampling({"readout.refine": "upsample"}) < base
    assert up_sampling({"readout.refine": "upsample"}) < up_sampling({"readout.refine": "wavelet"})
    assert up_sampling({"readout.refine": "none"}) == up_sampling({"search.method": "random"}) == 0


def test_choosing_the_metric_takes_more_spectra() -> None:
    fixed, chosen = (forecast(5000, 6000, Options().replace({"spectrum.metric": name})) for name in ("power", "auto"))
    assert fixed.stages["metric"] == 0 < chosen.stages["metric"]
    assert {**chosen.stages, "metric": 0.0} == fixed.stages


def test_growing_holds_all_functions_on_the_device() -> None:
    size = sizes(5000, 6000, Options())
    held = forecast(5000, 6000, Options()).device["refinement"]
    assert held > 4 * size.both * (size.functions + size.descriptors)
    assert "refinement" not in forecast(5000, 6000, Options().replace({"readout.refine": "none"})).device


def test_what_fits_is_let_through_with_its_forecast() -> None:
    for device in (None, CPU, GPU):
        predicted = require_memory(2562, 2562, Options(), device)
        assert 0 < predicted.match_memory < 2 * GIB


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
    monkeypatch.setattr(forecasts, "available_memory", lambda: 300 * MIB)
    with pytest.raises(MemoryBudgetError, match="this machine has free 300 MiB"):
        require_memory(10_242, 10_242, Options())
    # Who gives a limit knows better, and a machine that tells nothing is trusted.
    assert require_memory(10_242, 10_242, Options().replace({"engine.memory": 8 * GIB}))
    monkeypatch.setattr(forecasts, "available_memory", lambda: None)
    assert require_memory(10_242, 10_242, Options())


def test_memory_of_this_machine_and_of_a_container(tmp_path: Path) -> None:
    free = available_memory()
    assert free is None or 50 * MIB < free < 2**50
    for name, content in (("memory.max", "1000\n"), ("memory.current", "700\n"), ("memory.stat", "inactive_file 50\n")):
        (tmp_path / name).write_text(content)
    assert forecasts._group_memory(tmp_path) == 350
    (tmp_path / "memory.max").write_text("max\n")
    assert forecasts._group_memory(tmp_path) is None
    assert forecasts._group_memory(tmp_path / "none") is None
