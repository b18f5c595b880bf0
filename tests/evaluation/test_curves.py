from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from clalign.errors import InputError
from clalign.evaluation.errors import THRESHOLDS, error_curve
from clalign.presentation.curves import plot_error_curves, save_error_curves

CURVES = {"ours": error_curve(np.linspace(0, 0.05, 100)), "pyFM": error_curve(np.linspace(0, 0.2, 100))}


@pytest.mark.parametrize(("suffix", "start"), [(".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")])
def test_the_ending_chooses_the_format(tmp_path: Path, suffix: str, start: bytes) -> None:
    path = tmp_path / f"curve{suffix}"
    save_error_curves(CURVES, path, unit="diameter")
    assert path.read_bytes().startswith(start)


def test_labels_and_areas_are_in_the_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import matplotlib

    monkeypatch.setitem(matplotlib.rcParams, "svg.fonttype", "none")
    path = tmp_path / "curve.svg"
    save_error_curves(CURVES, path)
    text = path.read_text(encoding="utf-8")
    assert "ours (0.900)" in text
    assert "geodesic error / √area" in text


def test_what_cannot_be_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="no curve"):
        save_error_curves({}, tmp_path / "curve.png")
    with pytest.raises(InputError, match=f"expected \\({THRESHOLDS.size},\\)"):
        save_error_curves({"a": np.ones(3)}, tmp_path / "curve.png")
    with pytest.raises(InputError, match=r"curve\.xyz"):
        save_error_curves(CURVES, tmp_path / "curve.xyz")
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(InputError, match="need matplotlib"):
        save_error_curves(CURVES, tmp_path / "curve.png")


def test_many_curves_can_be_told_apart() -> None:
    rng = np.random.default_rng(0)
    figure = Figure(layout="constrained")
    axes = figure.add_subplot()
    plot_error_curves(axes, {f"method {number}": rng.random(THRESHOLDS.size) for number in range(14)}, "diameter")
    drawn = {(line.get_color(), line.get_linestyle()) for line in axes.lines}
    assert len(drawn) == 14
    figure.draw_without_rendering()
    legend = axes.get_legend()
    assert legend is not None
    assert legend.get_window_extent().y1 < axes.bbox.y0
