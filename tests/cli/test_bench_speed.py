"""``clalign bench kernels``, ``pair`` and ``scale`` at sizes that take a moment."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from quick import QUICK

from clalign.benchmark import losses
from clalign.benchmark.pair import ScaleTime
from clalign.cli.bench.speed import parsed_sizes
from clalign.cli.main import main
from clalign.errors import OptionError
from clalign.presentation.curves import save_scale_plot

CHANGES = [*QUICK[3:], "--device", "reference"]


@pytest.mark.usefixtures("opencl")
def test_kernels_states_the_device_and_fills_a_section(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(losses, "QUICK_SIZES", (100, 200))
    monkeypatch.setattr(losses, "QUICK_DENSE_SIZE", 200)
    page = tmp_path / "README.md"
    page.write_text("before\n<!-- table:kernels -->\nold\n<!-- /table:kernels -->\nafter\n", encoding="utf-8")
    arguments = ["bench", "kernels", "--quick", "--parts", "losses", "--repeat", "1", "--update", str(page)]
    assert main([*arguments, "--json", "--out", str(tmp_path / "kernels.json")]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document == json.loads((tmp_path / "kernels.json").read_text(encoding="utf-8"))
    assert document["device"]["device"]
    assert document["losses"]["vertices"] == [100, 200]
    assert document["losses"]["ratio"] > 0
    text = page.read_text(encoding="utf-8")
    assert "old" not in text
    assert "| value and gradient, n = 200, k = 120, d = 352, N = 100 |" in text
    assert text.startswith("before\n")
    assert text.endswith("after\n")


def test_pair_times_first_cold_and_warm(
    bumpy_files: tuple[Path, Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    source, target, _ = bumpy_files
    assert main(["bench", "pair", str(source), str(target), "--repeat", "1", "--json", *CHANGES]) == 0
    shown = capsys.readouterr()
    document = json.loads(shown.out)
    runs = {run["label"]: run for run in document["runs"]}
    assert list(runs) == ["first use", "cold cache", "warm cache"]
    assert document["vertices"] == [642, 642]
    assert document["options"]["engine"]["backend"] == "reference"
    assert runs["warm cache"]["stages"]["prepare"] < runs["cold cache"]["stages"]["prepare"]
    assert "warm cache: " in shown.err


def test_scale_draws_what_it_timed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plot = tmp_path / "scale.png"
    assert main(["bench", "scale", "--sizes", "300,150", "--plot", str(plot), *CHANGES]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert [line.split(" | ")[0] for line in lines if line.startswith("| ")][-3:] == ["| 150", "| 300", "| fit"]


@pytest.mark.parametrize("text", ["", "1000,", "2e5", "50", "-3"])
def test_sizes_that_are_none(text: str) -> None:
    with pytest.raises(OptionError, match="--sizes"):
        parsed_sizes(text)


def test_sizes_come_ascending_and_once() -> None:
    assert parsed_sizes("5000, 300,5000") == [300, 5000]


@pytest.mark.parametrize(
    "arguments", [["kernels", "--parts", "kernel"], ["kernels", "--repeat", "0"], ["pair", "a.ply"]]
)
def test_what_cannot_be_measured_is_usage(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", *arguments]) == 2
    assert capsys.readouterr().err.startswith("error: ")


def test_nothing_to_draw(tmp_path: Path) -> None:
    from clalign.errors import InputError

    nothing: list[ScaleTime] = []
    with pytest.raises(InputError, match="no time"):
        save_scale_plot(nothing, tmp_path / "a.png")
