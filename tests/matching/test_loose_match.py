"""A match of files with seams, pinched vertices and loose pieces gives every vertex its match, also from the disk."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from assembled import assembled, is_closed, truth
from collections_small import OPTIONS
from malformed import WRITERS

import clalign
from clalign.correspondence import ARRAYS_FILE, Correspondence
from clalign.errors import MeshError
from clalign.maps.file_maps import VertexStatus
from clalign.mesh.mesh import Mesh, as_mesh

SOURCE, TARGET = assembled(), assembled(0.3, seed=4)


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Correspondence:
    folder = tmp_path_factory.mktemp("assembled")
    for name, file in (("a", SOURCE), ("b", TARGET)):
        (folder / f"{name}.off").write_bytes(WRITERS["off"]((file.vertices, file.faces)))
    return clalign.match(folder / "a.off", folder / "b.off", OPTIONS)


def test_every_part_of_the_files_is_read_as_it_was_meant(result: Correspondence) -> None:
    for file, mesh in ((SOURCE, result.source), (TARGET, result.target)):
        assert (mesh.n_vertices, mesh.n_faces, mesh.file_count) == (162, 320, len(file.vertices))
        assert is_closed(mesh)
        np.testing.assert_array_equal(*mesh.vertex_of_file[file.seam].T)
        np.testing.assert_array_equal(np.sort(mesh.loose.file_index), np.sort(file.carried))
        np.testing.assert_array_equal(mesh.vertex_of_file[file.left_out], -1)
        assert mesh.vertex_of_file[file.shared] >= 0
        placed = np.setdiff1d(np.arange(mesh.file_count), file.left_out)
        np.testing.assert_allclose(mesh.file_positions()[placed], file.vertices[placed], atol=1e-12)


@pytest.mark.parametrize("direction", ["forward", "backward"])
def test_every_vertex_is_matched_with_its_own_place(result: Correspondence, direction: str) -> None:
    here, there, found, status = SOURCE, TARGET, result.target_of_source, result.source_status
    if direction == "backward":
        here, there, found, status = TARGET, SOURCE, result.source_of_target, result.target_status
    index = truth(here, there)
    np.testing.assert_array_equal(found[here.left_out], -1)
    np.testing.assert_array_equal(status[here.left_out], VertexStatus.UNMATCHED)
    np.testing.assert_array_equal(status[here.carried], VertexStatus.CARRIED)
    on_body = np.setdiff1d(np.arange(len(here.vertices)), [*here.left_out, *here.carried])
    np.testing.assert_array_equal(status[on_body], VertexStatus.MATCHED)
    np.testing.assert_array_equal(*found[here.seam].T)
    away = np.linalg.norm(there.vertices[found] - there.vertices[index], axis=1)
    assert away[on_body].mean() < 0.1
    # Both balls are smaller than the errors on the body, and yet each vertex stays within its ball and on its side.
    for ball, other, radius in ((here.loose, there.loose, 0.15), (here.touching, there.touching, 0.2)):
        assert np.isin(found[ball], other).all()
        assert away[ball].mean() < radius / 2


def assert_same_reading(one: Mesh, other: Mesh) -> None:
    np.testing.assert_array_equal(one.file_index, other.file_index)
    np.testing.assert_array_equal(one.vertex_of_file, other.vertex_of_file)
    for name in ("file_index", "vertices", "piece"):
        np.testing.assert_array_equal(getattr(one.loose, name), getattr(other.loose, name), err_msg=name)
    assert one.notes == other.notes


def test_a_saved_result_keeps_what_was_joined_parted_and_carried(result: Correspondence, tmp_path: Path) -> None:
    result.save(tmp_path / "result")
    loaded = Correspondence.load(tmp_path / "result")
    assert_same_reading(loaded.source, result.source)
    assert_same_reading(loaded.target, result.target)
    np.testing.assert_array_equal(loaded.source_status, result.source_status)
    np.testing.assert_array_equal(loaded.target_status, result.target_status)
    facts = json.loads((tmp_path / "result" / "result.json").read_text(encoding="utf-8"))
    assert facts["source"]["carried_vertices"] == len(SOURCE.carried)
    assert facts["source"]["file_vertices"] == len(SOURCE.vertices)
    assert any("carried along" in note for note in facts["source"]["notes"])


def test_results_from_before_vertices_were_carried_load(true_correspondence: Correspondence, tmp_path: Path) -> None:
    """They have no array of the vertex of every file's vertex, and nothing loose."""
    true_correspondence.save(tmp_path / "result")
    path = tmp_path / "result" / ARRAYS_FILE
    with np.load(path) as stored:
        arrays = {name: stored[name] for name in stored.files}
    former = {name: rows for name, rows in arrays.items() if ".loose." not in name and "vertex_of_file" not in name}
    assert len(former) == len(arrays) - 10
    np.savez(path, **former)
    loaded = Correspondence.load(tmp_path / "result")
    assert_same_reading(loaded.source, true_correspondence.source)
    np.testing.assert_array_equal(loaded.source_status, VertexStatus.MATCHED)


def test_strict_options_refuse_what_would_be_put_right() -> None:
    strict = OPTIONS.replace({"surface.strict": True})
    with pytest.raises(MeshError, match="source: the mesh has 3 separate pieces"):
        clalign.match((SOURCE.vertices, SOURCE.faces), (TARGET.vertices, TARGET.faces), strict)
    read = as_mesh((SOURCE.vertices, SOURCE.faces))
    # A mesh that is loaded already is taken as it is.
    assert clalign.match(read, as_mesh((TARGET.vertices, TARGET.faces)), strict).source is read
