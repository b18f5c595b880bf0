"""Measurements of speed: fits, tables, the dense evaluation that ours is compared with, and matches in processes."""

from __future__ import annotations

import json

import numpy as np
import pytest

from clalign.benchmark import losses
from clalign.benchmark.generated import generated_pair
from clalign.benchmark.kernels import KernelRate, kernel_table, measure_spectra, spectra_table
from clalign.benchmark.pair import (
    START,
    PairTime,
    ScaleTime,
    pair_table,
    scale_table,
    stage_exponents,
    timed_process,
)
from clalign.benchmark.pair_process import Request
from clalign.benchmark.performance import (
    bytes_text,
    exponent_text,
    fitted_exponent,
    seconds_text,
    this_machine,
)
from clalign.benchmark.table import markdown_table
from clalign.engine import Reference
from clalign.errors import ClalignError
from clalign.mesh.writing import save_mesh
from clalign.options import Options

QUICK = {
    "search.method": "random",
    "alignment.outer_iterations": 1,
    "alignment.iterations": 3,
    "spectrum.scale_invariant": 24,
    "spectrum.basis": 16,
    "spectrum.refinement": 16,
    "geodesics.search_samples": 60,
    "readout.steps": 0,
}


@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.5])
def test_the_exponent_of_a_power(exponent: float) -> None:
    sizes = [10.0, 50.0, 3000.0]
    assert fitted_exponent(sizes, [7 * size**exponent for size in sizes]) == pytest.approx(exponent, abs=1e-9)


def test_no_exponent_of_one_size_or_no_time() -> None:
    assert fitted_exponent([10.0, 10.0], [1.0, 2.0]) is None
    assert fitted_exponent([10.0, 20.0], [0.0, 2.0]) is None
    assert exponent_text(None) == "–"


@pytest.mark.parametrize(
    ("seconds", "text"), [(2e-6, "2 µs"), (0.0123, "12.3 ms"), (1.0, "1 s"), (123.4, "123 s"), (4321.0, "4321 s")]
)
def test_durations_have_a_unit(seconds: float, text: str) -> None:
    assert seconds_text(seconds) == text


def test_bytes_and_tables() -> None:
    assert [bytes_text(size) for size in (None, 5_000_000, 2_340_000_000)] == ["–", "5 MiB", "2.2 GiB"]
    assert markdown_table(["a", "b"], [["x", "1"]]) == "| a | b |\n|---|--:|\n| x | 1 |"


def test_the_machine_names_what_computes() -> None:
    machine = this_machine()
    assert machine.processors >= 1
    assert machine.versions["numpy"] == np.__version__
    assert f"numpy {np.__version__}" in str(machine)


@pytest.fixture
def dense_case(rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """C, bases, masses and distances of 13 and 11 vertices with 5 functions, the target's orthonormal in its mass."""
    mass = rng.uniform(0.5, 1.5, 11)
    mass /= mass.sum()
    basis_y = np.linalg.qr(rng.standard_normal((11, 5)))[0] / np.sqrt(mass)[:, None]
    distances = [rng.uniform(0, 1, (count, count)) for count in (13, 11)]
    return (
        rng.standard_normal((5, 5)),
        rng.standard_normal((13, 5)),
        basis_y,
        mass,
        *(values + values.T for values in distances),
    )


def test_the_dense_evaluation_has_the_gradient_of_its_value(dense_case, rng) -> None:
    functional, *rest = dense_case
    _, gradient = losses.dense_evaluation(functional, *rest)
    direction, step = rng.standard_normal((5, 5)), 1e-6
    values = [losses.dense_evaluation(functional + sign * step * direction, *rest)[0] for sign in (1, -1)]
    assert np.vdot(gradient, direction) == pytest.approx((values[0] - values[1]) / (2 * step), rel=1e-6)


def test_the_dense_evaluation_is_what_the_engine_computes(dense_case) -> None:
    """With factors of full rank the engine's value and gradient are those of the stored matrices."""
    functional, basis_x, basis_y, mass, distances_x, distances_y = dense_case
    value, gradient = losses.dense_evaluation(*dense_case)
    backend = Reference()
    carried = basis_x @ functional.T
    packed = backend.packed_moments(basis_y, mass, np.eye(11))
    z, s = backend.soft_map(carried, packed, None)
    weights, left = np.full(13, 1 / 13), np.eye(13) * np.sqrt(13)
    ours, dz = backend.distortion(z, distances_y, left, distances_x / 13, weights)
    assert float(ours) == pytest.approx(value, rel=1e-10)
    dc = backend.soft_map_gradient(carried, packed, None, z, s, dz)
    assert np.allclose(dc.T @ basis_x, gradient, rtol=1e-9, atol=1e-12)


def test_losses_are_timed_at_every_size() -> None:
    size = losses.ProblemSize(basis=8, scale_invariant=12, rank=5)
    times = losses.measure_losses(Reference(np.float32), (60, 240), 240, size, repeats=2)
    assert times.vertices == (60, 240)
    assert min(times.seconds) > 0
    assert times.ratio == times.dense_seconds / times.seconds[1]
    assert times.dense_operations == 6 * 240**3 + 4 * 240**2 * 8
    table = losses.loss_table(times)
    assert table.count("\n") == 1 + 2 + 1 + 1 + 1
    assert "k = 8, d = 12, N = 10" in table


def test_spectra_are_compared_at_the_same_counts() -> None:
    times = measure_spectra(generated_pair(700).source, basis=10, scale_invariant=20, repeats=1)
    assert (times.vertices, times.basis, times.scale_invariant) == (700, 10, 20)
    assert times.ratio == times.scipy_seconds / times.seconds > 0
    assert "10 + 20 eigenpairs, n = 700" in spectra_table(times)


def test_kernels_stand_over_the_ceiling_of_their_unit() -> None:
    rates = [
        KernelRate("copy", "1", "GB/s", 1.0, 20.0, "numpy copy", 2.0, 10.0),
        KernelRate("product", "2", "GFLOP/s", 1.0, 100.0, "numpy", 1.0, 100.0),
        KernelRate("soft_map", "3", "GFLOP/s", 1.0, 80.0, "numpy", 0.5, 160.0),
    ]
    last = kernel_table(rates).splitlines()[-1]
    assert last == "| soft_map | 3 | 1 s | 80.0 GFLOP/s | numpy | 160.0 | 0.50 | 0.80 |"


def some_time(label: str, seconds: float, prepare: float) -> PairTime:
    return PairTime(label, seconds, {START: seconds - prepare, "prepare": prepare}, 2 * seconds, 10**9, "a device")


def test_the_pair_table_sets_runs_beside_each_other() -> None:
    table = pair_table([some_time("cold cache", 4.0, 3.0), some_time("pyFM", 10.0, 1.0)])
    assert table.splitlines()[0] == "| stage | cold cache | pyFM |"
    assert "| **total** | **4 s** | **10 s** |" in table
    assert "| processor time | 8 s | 20 s |" in table
    assert "| pyFM's time over it | 2.50× | 1.00× |" in table
    short = pair_table([some_time("cold cache", 4.0, 3.0)], stages=False)
    assert [line.split(" | ")[0][2:] for line in short.splitlines()[2:]] == [
        "**total**",
        "processor time",
        "peak memory",
    ]


def test_the_scale_table_fits_every_stage() -> None:
    times = [ScaleTime(n, some_time("", 1e-3 * n, 1e-9 * n**2), 0.01) for n in (1000, 2000, 4000)]
    exponents = stage_exponents(times)
    assert exponents["prepare"] == pytest.approx(2.0)
    assert exponents["total"] == pytest.approx(1.0)
    assert exponents["work"] == pytest.approx(1.0)
    lines = scale_table(times).splitlines()
    assert lines[2].startswith("| 1,000 | ")
    assert lines[-1].startswith("| fit | ")
    assert "n^2.00" in lines[-1]


def test_a_process_gives_times_memory_and_a_map(tmp_path) -> None:
    pair = generated_pair(300)
    files = [str(tmp_path / name) for name in ("a.ply", "b.ply")]
    for file, mesh in zip(files, (pair.source, pair.target), strict=True):
        save_mesh(file, mesh.vertices, mesh.faces)
    options = Options().replace({**QUICK, "engine.backend": "reference"}).as_dict()
    request = Request(*files, "clalign", options, map=str(tmp_path / "map.npy"))
    found = timed_process(request, "reference", {})
    assert sum(found.stages.values()) == pytest.approx(found.seconds)
    assert found.stages[START] > 0
    assert found.work > 0.1
    assert {"read", "prepare", "alignment"} <= set(found.stages)
    assert found.peak is None or 5e7 < found.peak < 2e9
    assert found.device.startswith("numpy")
    assert np.load(tmp_path / "map.npy").shape == (300,)
    json.dumps(found.stages)


def test_a_failed_process_says_why(tmp_path) -> None:
    request = Request(str(tmp_path / "none.ply"), str(tmp_path / "none.ply"), "clalign", Options().as_dict())
    with pytest.raises(ClalignError, match=r"cold cache: .*none\.ply"):
        timed_process(request, "cold cache", {})
