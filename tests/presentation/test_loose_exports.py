"""Exports and the page of a match of files with seams, pinched vertices and loose pieces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from assembled import File, assembled, matched
from numpy.typing import NDArray

from clalign.correspondence import Correspondence
from clalign.evaluation.truth import read_pair_truth
from clalign.mesh.reading import read_mesh_file
from clalign.presentation import exports
from clalign.presentation.picture import match_image
from clalign.presentation.report import write_report
from clalign.presentation.report.payload import build_payload

SOURCE, TARGET = assembled(), assembled(0.3, seed=4)


@pytest.fixture(scope="module")
def result() -> Correspondence:
    return matched(SOURCE, TARGET)


def _has_all_pieces(faces: NDArray[np.integer], file: File) -> None:
    """The body's faces, and those of both balls with the corners that they have in the file."""
    balls = np.isin(file.faces, [*file.carried, file.shared]).all(axis=1)
    assert len(faces) == 320 + balls.sum()
    written = {tuple(sorted(face)) for face in faces.tolist()}
    assert written >= {tuple(sorted(face)) for face in file.faces[balls].tolist()}


def test_coloured_files_have_every_vertex_at_its_place_in_the_colour_of_its_match(
    result: Correspondence, tmp_path: Path
) -> None:
    source, target = (trimesh.load(path, process=False) for path in exports.export_ply(result, tmp_path))
    for file, written in ((SOURCE, source), (TARGET, target)):
        placed = np.setdiff1d(np.arange(len(file.vertices)), file.left_out)
        np.testing.assert_allclose(written.vertices[placed], file.vertices[placed], atol=1e-9)
        _has_all_pieces(written.faces, file)
    has = result.target_of_source >= 0
    colours = source.visual.vertex_colors, target.visual.vertex_colors
    np.testing.assert_array_equal(colours[0][has], colours[1][result.target_of_source[has]])
    np.testing.assert_array_equal(*colours[0][SOURCE.seam].transpose(1, 0, 2))
    # The loose ball has the colours of the body around it, not the grey of what has no match.
    assert (np.ptp(colours[1][TARGET.carried][:, :3].astype(int), axis=1) > 10).all()


def test_textured_files_keep_the_numbers(result: Correspondence, tmp_path: Path) -> None:
    for path, file in zip(exports.export_obj(result, tmp_path)[:2], (SOURCE, TARGET), strict=True):
        written = read_mesh_file(path)
        placed = np.setdiff1d(np.arange(len(file.vertices)), file.left_out)
        np.testing.assert_allclose(written.vertices[placed], file.vertices[placed], atol=1e-9)
        _has_all_pieces(written.faces, file)


def test_index_files_have_the_carried_vertices_too(result: Correspondence, tmp_path: Path) -> None:
    truth = read_pair_truth(*exports.export_vts(result, tmp_path))
    assert truth.count == len(SOURCE.vertices) - len(SOURCE.left_out)
    np.testing.assert_array_equal(result.target_of_source[truth.source_points], truth.target_points)
    forward, backward = (np.loadtxt(path, dtype=int) for path in exports.export_map(result, tmp_path))
    np.testing.assert_array_equal(forward - 1, result.target_of_source)
    np.testing.assert_array_equal(backward - 1, result.source_of_target)


def test_arrays_are_those_of_the_surface(result: Correspondence) -> None:
    arrays = exports.surface_arrays(result)
    assert arrays["target_of_source"].shape == arrays["source_mass"].shape == (162,)
    assert arrays["target_of_source"].min() >= 0
    numbers = arrays["target_file_index"][arrays["target_of_source"]]
    np.testing.assert_array_equal(numbers, result.target_of_source[arrays["source_file_index"]])


def test_the_page_shows_the_surface_and_says_what_was_put_right(result: Correspondence, tmp_path: Path) -> None:
    facts, arrays = build_payload(result)
    np.testing.assert_array_equal(arrays["source-numbers"], result.source.file_index)
    assert arrays["map-0-target-of-source"].min() >= 0
    assert facts["source"]["vertices"] == 162
    assert any("carried along" in note for note in facts["source"]["notes"])
    write_report(result, tmp_path / "report.html")
    assert "carried along with it" in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert match_image(result, height=100).shape[0] == 100
