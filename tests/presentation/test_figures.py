from __future__ import annotations

import csv
import json
import struct
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from clalign.alignment.band import band_mask, funnel_band
from clalign.benchmark import methods
from clalign.benchmark.pairs import LoadedPair
from clalign.cli.main import main
from clalign.correspondence import Correspondence
from clalign.errors import InputError, OptionError
from clalign.evaluation.errors import THRESHOLDS
from clalign.evaluation.spectral import spectral_errors
from clalign.evaluation.truth import Truth, true_maps
from clalign.maps.functional_maps import PointMaps
from clalign.options import Options
from clalign.presentation.curves import new_figure
from clalign.presentation.figures.eigenfunctions import draw_eigenfunctions, draw_pair_rotation, draw_variants
from clalign.presentation.figures.gallery import PLANS, Subject
from clalign.presentation.figures.maps import draw_error_curves, draw_matched_colours, draw_mirrored
from clalign.presentation.figures.sheet import AFTER, BEFORE, Drawing, panel_sheet, save_drawing
from clalign.presentation.figures.spectral import draw_funnel, draw_spectral_errors, running_mean
from clalign.presentation.figures.surfaces import PairView

LOW = 50


@pytest.fixture
def maps(small: Correspondence) -> PointMaps:
    """The fabricated result's maps are true."""
    return true_maps(small.source, small.target, Truth.from_index(small.target_of_source))


def saved(drawing: Drawing, folder: Path) -> tuple[list[dict[str, str]], tuple[int, int]]:
    """Save a drawing, check the three files, and return the rows of the table and the size of the picture."""
    png, svg, table = save_drawing(drawing, folder, "figure")
    header = png.read_bytes()[:24]
    assert header[:8] == b"\x89PNG\r\n\x1a\n"
    assert ElementTree.fromstring(svg.read_bytes()).tag.endswith("svg")
    with table.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert tuple(rows[0]) == drawing.columns
    return rows, struct.unpack(">II", header[16:24])


def test_panel_sheet_puts_panels_where_they_belong(tmp_path: Path) -> None:
    colours = ((250, 0, 0), (0, 250, 0)), ((0, 0, 250), (250, 0, 250))
    shades = [[np.full((120, 80, 3), colour, np.uint8) for colour in row] for row in colours]
    figure = panel_sheet(shades, columns=["a", "b"], rows=["c", "d"], notes=["e"], note_span=2, gaps_after=[0])
    save_drawing(Drawing(figure, ("x",), ((1,),)), tmp_path, "sheet")
    from matplotlib.image import imread

    picture = np.rint(imread(tmp_path / "sheet.png")[..., :3] * 255).astype(int)
    places = {colour: np.nonzero((picture == colour).all(axis=2)) for row in colours for colour in row}
    for rows, columns in places.values():
        assert len(rows) == pytest.approx(120 * 80, rel=0.05)
        assert (np.ptp(rows) + 1, np.ptp(columns) + 1) == pytest.approx((120, 80), abs=1)
    (first, second), (third, _) = colours
    assert places[first][1].max() + 5 < places[second][1].min()
    assert places[first][0].max() < places[third][0].min()


def test_saving_twice_gives_the_same_bytes_and_says_what_it_cannot_write(tmp_path: Path) -> None:
    for name in ("first", "second"):
        figure = new_figure(2, 1)
        figure.add_subplot().plot([0, 1])
        save_drawing(Drawing(figure, ("x", "y"), ((1, 0.1), ("a", None))), tmp_path / name, "same")
    for ending in ("png", "svg", "csv"):
        assert (tmp_path / f"first/same.{ending}").read_bytes() == (tmp_path / f"second/same.{ending}").read_bytes()
    assert (tmp_path / "first/same.csv").read_text(encoding="utf-8") == "x,y\n1,0.1\na,\n"
    with pytest.raises(InputError, match="cannot be written"):
        save_drawing(Drawing(new_figure(2, 1), ("x",), ()), tmp_path / "first/same.csv", "same")


def test_views_show_both_shapes_at_one_scale(small: Correspondence) -> None:
    view = PairView.of(small)
    white = np.ones((small.source.n_vertices, 3)), np.ones((small.target.n_vertices, 3))
    first, second = view.panels(*white, 100, (0.0, 0.0, 1.0))
    assert first.shape == second.shape
    heights = [np.ptp(np.nonzero((image != (0, 0, 255)).any(axis=2).any(axis=1))[0]) for image in (first, second)]
    ratio = np.ptp(view.source[:, 1]) / np.ptp(view.target[:, 1])
    assert heights[0] / heights[1] == pytest.approx(ratio, rel=0.03)


def test_opposite_functions_get_opposite_colours(small: Correspondence) -> None:
    functions = small.source_basis.functions, small.target_basis.functions
    plain = PairView.of(small).function_panels(functions, 3, 90)
    turned = PairView.of(small).function_panels((-functions[0], functions[1]), 3, 90)
    np.testing.assert_array_equal(plain[1], turned[1])
    red = [image[..., 0].astype(int) - image[..., 2] for image in (plain[0], turned[0])]
    assert (np.sign(red[0]) * np.sign(red[1]) <= 0).mean() > 0.9


def test_figure_1_has_a_panel_a_function_and_its_error(small: Correspondence, maps: PointMaps, tmp_path: Path) -> None:
    rows, size = saved(draw_eigenfunctions(small, maps, (2, 3, 12, 40), LOW), tmp_path)
    assert [row["eigenfunction"] for row in rows] == ["2", "3", "12"]
    errors = spectral_errors(small, maps)
    for row in rows:
        place = int(row["eigenfunction"]) - 1
        assert float(row["error_before"]) == pytest.approx(errors.unaligned[place], rel=1e-4)
        assert float(row["error_after"]) == pytest.approx(errors.aligned[place], rel=1e-4)
    from matplotlib.image import imread

    picture = imread(tmp_path / "figure.png")[..., :3]
    for background in (BEFORE, AFTER):
        assert np.isclose(picture, background, atol=0.01).all(axis=2).mean() > 0.05
    assert size[1] > 4 * LOW


def test_figure_2_names_the_pair_and_its_turn(small: Correspondence, maps: PointMaps, tmp_path: Path) -> None:
    rows, _ = saved(draw_pair_rotation(small, maps, 3, LOW), tmp_path)
    assert [(row["first"], row["second"]) for row in rows] == [("3", "4")] * 2
    true, found = (float(row["degrees"]) for row in rows)
    assert abs((found - true + 180) % 360 - 180) < 15
    chosen, _ = saved(draw_pair_rotation(small, maps, height=LOW), tmp_path)
    assert 2 <= int(chosen[0]["first"]) < len(small.rotation)
    with pytest.raises(OptionError, match="no pair 16, 17"):
        draw_pair_rotation(small, maps, 16)


def test_figure_3_measures_the_funnel(small: Correspondence, maps: PointMaps, tmp_path: Path) -> None:
    rows, _ = saved(draw_funnel(small, maps), tmp_path)
    mask = band_mask(funnel_band(len(small.rotation), small.options.alignment))
    assert len(rows) == len(mask)
    for row, columns in zip(rows, mask, strict=True):
        inside = np.flatnonzero(columns) + 1
        assert (int(row["first_column"]), int(row["last_column"])) == (inside[0], inside[-1])
        assert 0.3 < float(row["inside_true"]) <= 1.0 + 1e-9


def test_figure_8_and_9_compare_variants(small: Correspondence, maps: PointMaps, tmp_path: Path) -> None:
    worse = replace(small, rotation=np.eye(len(small.rotation)))
    rows, _ = saved(draw_variants({"good": small, "none": worse}, maps, 4, LOW), tmp_path)
    assert [row["variant"] for row in rows] == ["unaligned", "good", "none"]
    with pytest.raises(OptionError, match="no eigenfunction 17"):
        draw_variants({"good": small}, maps, 17)
    errors = {"good": spectral_errors(small, maps), "none": spectral_errors(worse, maps)}
    table, _ = saved(draw_spectral_errors(errors), tmp_path)
    assert len(table) == len(small.rotation)
    assert float(table[3]["good"]) == pytest.approx(float(rows[1]["error"]), rel=1e-4)
    np.testing.assert_allclose([float(row["none"]) for row in table], errors["none"].aligned, rtol=1e-4)


def test_running_mean_keeps_constants_and_sums() -> None:
    np.testing.assert_allclose(running_mean(np.full(20, 3.0), 11), 3.0)
    values = np.random.default_rng(0).normal(size=30)
    smooth = running_mean(values, 5)
    assert smooth[10] == pytest.approx(values[8:13].mean())
    assert smooth[0] == pytest.approx(values[:3].mean())


def test_figure_5_draws_both_units(tmp_path: Path) -> None:
    curve = np.linspace(0.0, 1.0, THRESHOLDS.size)
    rows, _ = saved(draw_error_curves({"sqrt_area": {"a": curve}, "diameter": {"a": curve**2}}), tmp_path)
    assert set(rows[0]) == {"threshold", "a / diameter", "a / sqrt_area"}
    assert float(rows[125]["a / diameter"]) == pytest.approx(0.25)


@dataclass(frozen=True)
class Stub:
    """A method that gives the fabricated result."""

    name: str
    result: Correspondence

    def correspondence(self, pair: LoadedPair, cache: object = None, progress: object = None) -> Correspondence:
        if self.name == "mirrored":
            return replace(self.result, target_of_source=np.roll(self.result.target_of_source, 1))
        return self.result


@pytest.fixture
def folder(small: Correspondence, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A result on disk, its truth as a file, and variants that need no match."""
    small.save(tmp_path / "result")
    truth: NDArray[np.int64] = small.target_of_source
    np.savetxt(tmp_path / "truth.txt", truth, fmt="%d")
    np.savetxt(tmp_path / "mirror.txt", np.arange(np.count_nonzero(truth >= 0)), fmt="%d")
    monkeypatch.setattr(methods, "align_method", lambda name, changes: Stub(name, small))
    return tmp_path


def test_command_draws_everything_from_a_result(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = [
        "figures",
        str(folder / "result"),
        "--truth",
        str(folder / "truth.txt"),
        "--out",
        str(folder / "out"),
        "--height",
        "50",
    ]
    assert main([*command, "--mirror", str(folder / "mirror.txt"), "--json", "--quiet"]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    written = json.loads(captured.out)["figures"]
    assert list(written) == list(PLANS)
    for names in written.values():
        assert [Path(name).suffix for name in names] == [".png", ".svg", ".csv"]
        assert all(Path(name).stat().st_size > 0 for name in names)
    with (folder / "out" / "figure-7.csv").open(encoding="utf-8") as stream:
        starts = {row["start"]: row for row in csv.DictReader(stream)}
    assert float(starts["this program"]["mean"]) == 0.0
    assert float(starts["from the mirror image"]["mean"]) > 0.05


def test_command_without_a_truth(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["figures", str(folder / "result"), "--out", str(folder / "out"), "--height", "50"]
    assert main([*command]) == 0
    captured = capsys.readouterr()
    assert "there is no figure 2, 3, 5, 7, 8, 9 without --truth" in captured.err
    assert sorted(path.name for path in (folder / "out").glob("*.png")) == ["figure-1.png", "figure-6.png"]
    assert main([*command, "--which", "1,9"]) == 2
    assert "figure 9 cannot be drawn without --truth" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--which", "4"], "--which 4: there are 1, 2, 3, 5, 6, 7, 8, 9 and 'all'"),
        (["--which", ","], "there are 1, 2, 3"),
        (["--which", "1", "--set", "seed"], "GROUP.NAME=VALUE"),
        (["--which", "1", "--set", "seed=3"], "--set changes nothing of a result that is there"),
        (["--which", "1", "--height", "3"], "--height must be at least 20"),
        (["--which", "1", "--mirror", "mirror.txt"], "--mirror is of the points of a truth"),
    ],
)
def test_command_says_what_is_wrong(
    folder: Path, capsys: pytest.CaptureFixture[str], more: list[str], message: str
) -> None:
    assert main(["figures", str(folder / "result"), "--out", str(folder / "out"), *more]) == 2
    assert message in capsys.readouterr().err


def test_variants_are_not_compared_with_a_result_of_other_options(
    folder: Path, small: Correspondence, capsys: pytest.CaptureFixture[str]
) -> None:
    other = replace(small, options=Options.preset("paper"))
    other.save(folder / "other")
    command = ["figures", str(folder / "other"), "--truth", "identity", "--out", str(folder / "out")]
    command += ["--height", "50"]
    assert main([*command, "--which", "1,9"]) == 2
    assert "figure 9 cannot be drawn of a result with options of its own" in capsys.readouterr().err
    assert main([*command, "--which", "all"]) == 0
    assert "there is no figure 5, 7, 8, 9 of a result with options of its own" in capsys.readouterr().err
    assert {path.stem for path in (folder / "out").glob("*.png")} == {f"figure-{number}" for number in (1, 2, 3, 6)}


def test_command_takes_one_result_or_two_meshes(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["figures", str(folder / "truth.txt")]) == 2
    assert "a pair is named by two meshes" in capsys.readouterr().err
    assert main(["figures", "a", "b", "c"]) == 2
    assert "not 3 paths" in capsys.readouterr().err


@pytest.mark.parametrize("more", [["--truth", "identity"], ["--mirror", "mirror.txt"]])
def test_the_bundled_pair_takes_no_other_truth(capsys: pytest.CaptureFixture[str], more: list[str]) -> None:
    assert main(["figures", "--which", "1", *more]) == 2
    assert "the bundled pair has its own truth" in capsys.readouterr().err


def test_errors_are_those_of_the_points_drawn_by_the_seed(small: Correspondence) -> None:
    pair = LoadedPair("pair", small.source, small.target, Truth.identity(643), None)
    subjects = [Subject(pair, lambda _: small, seed=seed) for seed in (0, 3)]
    points = [subject.evaluated({"a": small})["a"].points for subject in subjects]
    assert not np.array_equal(*points)


def test_draw_mirrored_and_matched_do_without_errors(small: Correspondence, tmp_path: Path) -> None:
    rows, _ = saved(draw_matched_colours({"pair": small}, {}, LOW), tmp_path)
    assert (rows[0]["pair"], rows[0]["mean"]) == ("pair", "")
    rows, _ = saved(draw_mirrored({"a": small, "b": small}, {}, LOW), tmp_path)
    assert [float(row["align"]) for row in rows] == [small.losses["align"]] * 2
