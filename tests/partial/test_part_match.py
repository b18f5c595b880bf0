"""A part matched with its whole by `clalign.match` and by the command line."""

from __future__ import annotations

import json
import warnings
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import shapes
from numpy.typing import NDArray
from quick import device
from rules_read import every_rule, rule_classes, watch

import clalign
from clalign import Options
from clalign.benchmark.cut import KINDS
from clalign.benchmark.parts import taken
from clalign.cli.main import main
from clalign.correspondence import Correspondence
from clalign.errors import OptionError
from clalign.maps.file_maps import VertexStatus
from clalign.matching.parts import roles
from clalign.mesh.mesh import Mesh, mesh_from_arrays
from clalign.presentation.picture import pair_colours, pair_views
from clalign.rules import parts
from clalign.transfer.colours import UNMATCHED

LENGTHS = (1.4, 1.2, 1.6, 1.0, 1.8)


class CutBody(NamedTuple):
    """A part of a body in one pose, the body in another, and the vertex of its file for every vertex of the part's."""

    part: Mesh
    whole: Mesh
    truth: NDArray[np.int64]


@cache
def body() -> CutBody:
    vertices, faces = shapes.limbed_sphere(LENGTHS)
    bent, bent_faces, new_of_old = shapes.renumbered(shapes.bent(vertices, 0.15), faces, 7)
    source = mesh_from_arrays(vertices, faces, "source")
    part, of_file = taken(source, KINDS["cuts"], 0.45, np.random.default_rng(3))
    old = np.full(part.file_count, -1)
    old[of_file[of_file >= 0]] = np.flatnonzero(of_file >= 0)
    return CutBody(part, mesh_from_arrays(bent, bent_faces, "whole"), new_of_old[old])


def enlarged(mesh: Mesh, factor: float) -> Mesh:
    return mesh_from_arrays(factor * mesh.file_positions(), mesh.file_faces, mesh.name)


@cache
def found(side: str = "source") -> Correspondence:
    part, whole, _ = body()
    return quietly(part, whole) if side == "source" else quietly(whole, part)


def quietly(source: Mesh, target: Mesh, *args: Any, **named: Any) -> Correspondence:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return clalign.match(source, target, *args, **named)


def errors(matches: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return how far from the truth the part's matches lie, in sqrt(area) of the whole."""
    whole = body().whole
    places = whole.file_positions() / whole.scale
    return np.asarray(np.linalg.norm(places[matches] - places[body().truth], axis=1))


def test_a_part_lands_where_it_belongs_by_default_options() -> None:
    result = found()
    off = errors(result.target_of_source)
    assert off.mean() < 0.01
    assert np.quantile(off, 0.95) < 0.04
    assert result.part is not None
    assert (result.part.side, result.part.asked) == ("source", False)
    assert result.part.area == pytest.approx((body().part.scale / body().whole.scale) ** 2)
    assert result.part.scale == pytest.approx(1.0, abs=0.03)
    assert result.confidence > 0.3
    assert result.orientation > 0.6
    assert result.status == "not run"
    assert any("as a part of whole" in text for text in result.warnings)


def test_what_the_part_does_not_cover_has_no_match_and_the_rest_goes_back() -> None:
    result, whole = found(), body().whole
    belongs = np.zeros(whole.file_count, dtype=bool)
    belongs[body().truth] = True
    matched = result.source_of_target >= 0
    mass = np.zeros(whole.file_count)
    mass[whole.file_index] = result.target_basis.mass
    assert mass[matched & belongs].sum() / mass[matched | belongs].sum() > 0.9
    assert set(result.target_status) == {VertexStatus.MATCHED, VertexStatus.UNMATCHED}
    assert np.all(result.source_status == VertexStatus.MATCHED)
    back = result.source_of_target[body().truth]
    known = np.flatnonzero(back >= 0)
    places = body().part.file_positions() / whole.scale
    assert np.linalg.norm(places[back[known]] - places[known], axis=1).mean() < 0.02


def test_the_rotation_turns_functions_of_the_part_towards_those_of_the_whole() -> None:
    result = found()
    assert result.rotation.shape[0] < result.rotation.shape[1]
    np.testing.assert_array_equal(result.functional_map, result.rotation.T)
    low = 10
    whole_of_part = result.source.map_from_file(result.target, result.target_of_source)
    # What the part knows of a function on the whole: its best fit by the part's own functions.
    pulled = result.target_aligned[whole_of_part][:, :low]
    mine = result.source_basis.functions[:, :low]
    cosine = [float(a @ (result.source_basis.mass * b)) for a, b in zip(mine.T, pulled.T, strict=True)]
    norms = [float(np.sqrt(b @ (result.source_basis.mass * b))) for b in pulled.T]
    assert np.min(np.array(cosine) / np.array(norms)) > 0.9
    gram = mine.T @ (result.source_basis.mass[:, None] * mine)
    np.testing.assert_allclose(gram, np.eye(low), atol=1e-4)


def test_source_and_target_may_change_places() -> None:
    one, other = found(), found("target")
    assert other.part is not None
    assert other.part.side == "target"
    np.testing.assert_array_equal(one.target_of_source, other.source_of_target)
    np.testing.assert_array_equal(one.source_of_target, other.target_of_source)
    np.testing.assert_array_equal(one.functional_map, other.functional_map.T)
    assert other.distortion.shape == (body().whole.n_vertices,)
    assert np.all(other.distortion[other.target_of_source[body().whole.file_index] < 0] == 0)


def test_a_part_in_another_unit_is_found_with_its_scale_and_reads_every_rule(monkeypatch: pytest.MonkeyPatch) -> None:
    classes = rule_classes(parts)
    read = watch(monkeypatch, classes)
    part, whole, _ = body()
    result = quietly(enlarged(part, 25.4), whole)
    roles(part, part, Options())
    monkeypatch.undo()
    assert every_rule(classes) - read == set()
    assert result.part is not None
    assert result.part.scale == pytest.approx(1 / 25.4, rel=0.1)
    assert errors(result.target_of_source).mean() < 0.02
    assert any("times the scale of its file" in text for text in result.warnings)


def test_the_map_does_not_depend_on_how_the_part_lies_or_is_numbered() -> None:
    part, whole, _ = body()
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    vertices, faces, new_of_old = shapes.renumbered(part.file_positions() @ turn.T, part.file_faces, 11)
    again = quietly(mesh_from_arrays(vertices, faces, "turned"), whole)
    places = whole.file_positions() / whole.scale
    apart = np.linalg.norm(places[again.target_of_source[new_of_old]] - places[found().target_of_source], axis=1)
    assert np.mean(apart) < 0.01


def test_a_mirrored_part_is_found_where_that_is_asked_for() -> None:
    part, whole, _ = body()
    mirrored = mesh_from_arrays(part.file_positions() * [-1, 1, 1], part.file_faces[:, [0, 2, 1]], "mirrored")
    result = quietly(mirrored, whole, Options().replace({"search.orientation": "reversing"}))
    assert errors(result.target_of_source).mean() < 0.02
    assert result.orientation < -0.6


def test_saved_and_read_back_the_result_knows_its_part(tmp_path: Path) -> None:
    found().save(tmp_path / "result")
    again = Correspondence.load(tmp_path / "result")
    assert again.part == found().part
    np.testing.assert_array_equal(again.source_of_target, found().source_of_target)
    np.testing.assert_allclose(again.source_aligned, found().source_aligned, atol=1e-4)


def test_what_is_not_covered_is_grey() -> None:
    result = found()
    on_source, on_target = pair_colours(result, pair_views(result)[1])
    uncovered = result.source_of_target[result.target.file_index] < 0
    assert np.all(on_target[uncovered] == UNMATCHED)
    assert not np.any(np.all(on_target[~uncovered] == UNMATCHED, axis=1))
    assert not np.any(np.all(on_source == UNMATCHED, axis=1))


def test_wholes_are_no_parts_unless_that_is_asked_for() -> None:
    part, whole, _ = body()
    options = Options()
    assert roles(whole, whole, options) is None
    assert roles(part, whole, options.replace({"partial.part": "none"})) is None
    assert roles(part, whole, options.replace({"search.method": "random"})) is None
    asked = roles(whole, whole, options.replace({"partial.part": "target"}))
    assert asked is not None
    assert (asked.side, asked.asked) == ("target", True)


def test_a_start_is_refused_with_a_part() -> None:
    part, whole, _ = body()
    with pytest.raises(OptionError, match="cannot be given for a part"):
        clalign.match(part, whole, partial="source", start="rigid")
    with pytest.raises(OptionError, match=r"partial\.part must be one of"):
        clalign.match(part, whole, partial="half")


def test_the_command_line_matches_a_part(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    part, whole, truth = body()
    paths = [
        shapes.write_off(tmp_path / f"{mesh.name.split()[0]}.off", mesh.file_positions(), mesh.file_faces)
        for mesh in (part, whole)
    ]
    np.savetxt(tmp_path / "truth.txt", truth, fmt="%d")
    out = tmp_path / "result"
    named = ["--partial", "source", "--scale", "same", "--truth", str(tmp_path / "truth.txt"), "--alternatives", "1"]
    assert main(["match", *map(str, paths), *named, *device(), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "none: R was not optimised" in said
    facts = json.loads((out / "result.json").read_text())
    assert facts["part"]["side"] == "source"
    assert facts["part"]["scale"] == 1.0
    assert facts["part"]["asked"] is True
    assert facts["options"]["partial"] == {"part": "source", "scale": "same"}
    assert json.loads((out / "evaluation.json").read_text())["per_sqrt_area"]["mean"] < 0.015
    assert (out / "match.png").stat().st_size > 10_000
    assert (out / "report.html").stat().st_size > 100_000
