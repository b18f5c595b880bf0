from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import shapes
import trimesh

from clalign.correspondence import Correspondence
from clalign.evaluation.truth import read_pair_truth
from clalign.mesh.mesh import load_mesh, mesh_from_arrays
from clalign.presentation import exports
from clalign.transfer.texture import read_texture


@pytest.fixture(scope="module")
def whole(fabricated: object) -> Correspondence:
    """A match whose maps follow from its functional map, so that other libraries must find the same."""
    vertices, faces = shapes.bumpy_sphere(3)
    target, target_faces, target_of_old = shapes.renumbered(vertices, faces, 3)
    meshes = mesh_from_arrays(vertices, faces, "one"), mesh_from_arrays(target, target_faces, "two")
    return fabricated(*meshes, target_of_old, np.argsort(target_of_old), basis=30)  # type: ignore[operator]


def test_coloured_ply_matches_in_colour_and_keeps_the_numbers(small: Correspondence, tmp_path: Path) -> None:
    source, target = (trimesh.load(path, process=False) for path in exports.export_ply(small, tmp_path))
    assert len(source.vertices) == len(target.vertices) == 643
    assert np.allclose(source.vertices[1:], small.source.file_vertices())
    assert np.array_equal(source.visual.vertex_colors[1:], target.visual.vertex_colors[small.target_of_source[1:]])
    assert len(np.unique(target.visual.vertex_colors, axis=0)) > 300


def test_textured_obj_agrees_on_matching_points(small: Correspondence, tmp_path: Path) -> None:
    files = exports.export_obj(small, tmp_path)
    assert all(path.stat().st_size > 40 for path in files)
    places = {}
    for side, path in zip(("source", "target"), files[:2], strict=True):
        texture = read_texture(path)
        places[side] = np.zeros((643, 2))
        places[side][texture.faces.ravel()] = texture.coordinates[texture.corners.ravel()]
    assert np.allclose(places["source"][1:], places["target"][small.target_of_source[1:]], atol=1e-6)
    assert np.abs(places["target"] - 0.5).max() <= 0.5
    assert "map_Kd texture.png" in files[2].read_text(encoding="ascii")
    again = load_mesh(files[0])
    assert np.allclose(again.file_vertices(), small.source.file_vertices())


def test_vts_and_map_count_from_one(small: Correspondence, tmp_path: Path) -> None:
    source, target = exports.export_vts(small, tmp_path)
    truth = read_pair_truth(source, target, source_count=643, target_count=643)
    assert np.array_equal(small.target_of_source[truth.source_points], truth.target_points)
    assert truth.count == 642
    forward, backward = (np.loadtxt(path, dtype=int) for path in exports.export_map(small, tmp_path))
    assert np.array_equal(forward - 1, small.target_of_source)
    assert np.array_equal(backward - 1, small.source_of_target)


def test_numpy_archive_is_consistent_in_itself(small: Correspondence, tmp_path: Path) -> None:
    (path,) = exports.FORMATS["numpy"](small, tmp_path)
    with np.load(path) as arrays:
        pulled = arrays["source_functions"][arrays["source_of_target"]]
        found = arrays["target_functions"].T @ (arrays["target_mass"][:, None] * pulled)
        assert np.allclose(found, arrays["functional_map"])
        assert np.array_equal(
            arrays["target_file_index"][arrays["target_of_source"]],
            small.target_of_source[arrays["source_file_index"]],
        )


def test_matlab_file_counts_from_one(small: Correspondence, tmp_path: Path) -> None:
    (path,) = exports.export_matlab(small, tmp_path)
    content = scipy.io.loadmat(path, squeeze_me=True, struct_as_record=False)
    one, two = content["S1"], content["S2"]
    assert one.T.min() == 1
    assert one.T.max() == 642
    pulled = one.evecs[content["T21"].astype(int) - 1]
    assert np.allclose(two.evecs.T @ (two.A[:, None] * pulled), content["C12"])
    assert np.allclose(one.X, small.source.vertices)
    assert one.name == "first"


def test_pyfm_finds_the_same_maps(whole: Correspondence, tmp_path: Path) -> None:
    from pyFM import spectral

    (path,) = exports.FORMATS["pyfm"](whole, tmp_path)
    with np.load(path) as arrays:
        back = spectral.FM_to_p2p(arrays["FM_12"], arrays["evects1"], arrays["evects2"])
        assert np.array_equal(np.asarray(back).ravel(), whole.source_of_target)
        again = spectral.p2p_to_FM(arrays["p2p_21"], arrays["evects1"], arrays["evects2"], A2=arrays["A2"])
    assert np.allclose(again, whole.functional_map, atol=1e-12)
    mesh1, mesh2, found = exports.to_pyfm(whole)
    assert np.array_equal(np.ravel(spectral.mesh_FM_to_p2p(found, mesh1, mesh2)), whole.source_of_target)
    assert np.allclose(spectral.mesh_p2p_to_FM(whole.source_of_target, mesh1, mesh2, dims=30), found)


def test_geomfum_finds_the_same_maps(whole: Correspondence, tmp_path: Path) -> None:
    with warnings.catch_warnings():
        # What the library warns of while it is imported is its own affair.
        warnings.simplefilter("ignore")
        convert = pytest.importorskip(
            "geomfum.convert", exc_type=ImportError, reason="geomfum brings PyTorch, several gigabytes"
        )
        shape_a, shape_b, fmap = exports.to_geomfum(whole)
        back = convert.P2pFromFmConverter()(fmap, shape_a.basis, shape_b.basis)
        again = convert.FmFromP2pConverter(pseudo_inverse=True)(whole.source_of_target, shape_a.basis, shape_b.basis)
    assert np.array_equal(np.asarray(back).ravel(), whole.source_of_target)
    assert np.allclose(np.asarray(again), whole.functional_map, atol=1e-9)
    (path,) = exports.FORMATS["geomfum"](whole, tmp_path)
    with np.load(path) as arrays:
        assert np.array_equal(arrays["fmap_matrix"], fmap)
        assert np.array_equal(arrays["p2p"], whole.source_of_target)


def test_every_format_of_the_command_exists() -> None:
    from clalign.cli import saved

    assert set(saved.FORMATS) == {*exports.FORMATS, "report", "picture"}
