"""Formats of other fields, against the libraries of those fields: same positions, same faces, same numbers."""

from __future__ import annotations

import gzip
import json
import sys
from pathlib import Path

import file_formats
import malformed
import nibabel.freesurfer
import numpy as np
import pytest
import shapes
import trimesh

from clalign.errors import MeshError
from clalign.mesh.mesh import load_mesh
from clalign.mesh.reading import is_mesh_name, mesh_stem, read_mesh_file

VTK_FILES = Path(__file__).parent / "vtk_files"
POINTS = [[0, 0, 0], [1, 0, 0], [1, 1, 0.25], [0, 1, 0], [0.5, 0.5, 1], [2, 0.5, -1]]
PYRAMID = [[0, 3, 2], [0, 2, 1], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4], [1, 5, 2], [2, 5, 4]]
"""A quadrangle, four triangles and a strip of two, as VTK wrote them."""
CELLS = [[0, 1, 4], [0, 3, 2], [0, 2, 1], [0, 1, 2], [0, 2, 3], [0, 1, 2], [0, 2, 3], [1, 5, 2], [2, 5, 4]]
"""A triangle, a quadrangle, a pixel, a polygon and a strip; a tetrahedron and a line are there, too."""


def in_single_precision() -> malformed.Arrays:
    vertices, faces = shapes.bumpy_sphere(2)
    return vertices.astype(np.float32).astype(np.float64), faces


@pytest.mark.parametrize("name", sorted(file_formats.WRITERS))
def test_numbering_of_files_by_other_libraries(tmp_path: Path, name: str) -> None:
    vertices, faces = in_single_precision()
    path = tmp_path / f"mesh.{name.split()[-1]}"
    path.write_bytes(file_formats.WRITERS[name]((vertices, faces)))
    raw = read_mesh_file(path)
    np.testing.assert_array_equal(raw.vertices, vertices)
    np.testing.assert_array_equal(raw.faces, faces)
    assert raw.notes == ()
    assert load_mesh(path).n_vertices == 162


@pytest.mark.parametrize("encoding", ["GIFTI_ENCODING_ASCII", "GIFTI_ENCODING_B64BIN", "GIFTI_ENCODING_B64GZ"])
def test_gifti_in_every_encoding(tmp_path: Path, encoding: str) -> None:
    vertices, faces = in_single_precision()
    path = tmp_path / "lh.midthickness.surf.gii.gz"
    path.write_bytes(gzip.compress(file_formats.gifti((vertices, faces), encoding)))
    raw = read_mesh_file(path)
    np.testing.assert_allclose(raw.vertices, vertices, rtol=1e-5)
    np.testing.assert_array_equal(raw.faces, faces)
    assert load_mesh(path).name == "lh.midthickness.surf"


@pytest.mark.parametrize("name", ["lh.pial", "rh.white", "lh.inflated", "surface", "lh.pial.gz"])
def test_freesurfer_surfaces_are_known_by_their_first_bytes(tmp_path: Path, name: str) -> None:
    vertices, faces = in_single_precision()
    content = file_formats.freesurfer((vertices, faces))
    path = tmp_path / name
    path.write_bytes(gzip.compress(content) if name.endswith(".gz") else content)
    raw = read_mesh_file(path)
    np.testing.assert_array_equal(raw.vertices, vertices)
    np.testing.assert_array_equal(raw.faces, faces)
    assert load_mesh(path).name == name
    nibabel.freesurfer.write_morph_data(tmp_path / "lh.curv", np.zeros(162))
    with pytest.raises(MeshError, match=r"lh.curv: is a FreeSurfer file of values or of quadrangles"):
        read_mesh_file(tmp_path / "lh.curv")


def test_a_gifti_file_of_values_is_no_surface(tmp_path: Path) -> None:
    array = nibabel.gifti.GiftiDataArray(np.zeros(9, dtype=np.float32), intent="NIFTI_INTENT_SHAPE")
    (tmp_path / "lh.thickness.shape.gii").write_bytes(nibabel.gifti.GiftiImage(darrays=[array]).to_bytes())
    with pytest.raises(MeshError, match=r"0 lists of points .* give the .surf.gii"):
        read_mesh_file(tmp_path / "lh.thickness.shape.gii")


def test_a_missing_package_is_one_line_that_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.gii"
    path.write_bytes(file_formats.gifti(in_single_precision()))
    monkeypatch.setitem(sys.modules, "nibabel.gifti", None)
    with pytest.raises(MeshError) as caught:
        read_mesh_file(path)
    assert str(caught.value) == (
        f'{path}: GIFTI files are read with nibabel, which is not installed; pip install "clalign[formats]"'
    )


@pytest.mark.parametrize("path", sorted(VTK_FILES.iterdir()), ids=lambda path: path.name)
def test_files_written_by_vtk(path: Path) -> None:
    if "lz4" in path.name:
        with pytest.raises(MeshError, match="vtkLZ4DataCompressor, which is not read; save it with zlib"):
            read_mesh_file(path)
        return
    raw = read_mesh_file(path)
    np.testing.assert_array_equal(raw.vertices, POINTS)
    if path.name.startswith("grid"):
        assert sorted(raw.faces.tolist()) == sorted(CELLS)
        assert raw.notes == ("1 cell that is no triangle or polygon was left out",)
    else:
        assert raw.faces.tolist() == PYRAMID
        assert raw.notes == ()


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize("compression", [None, "zlib", "lzma"])
def test_meshio_grids(tmp_path: Path, binary: bool, compression: str | None) -> None:
    vertices, faces = shapes.bumpy_sphere(1)
    (tmp_path / "a.vtu").write_bytes(file_formats.vtu((vertices, faces), binary=binary, compression=compression))
    (tmp_path / "a.vtk").write_bytes(file_formats.vtk_grid((vertices, faces), binary=binary))
    for name in ("a.vtu", "a.vtk"):
        raw = read_mesh_file(tmp_path / name)
        np.testing.assert_allclose(raw.vertices, vertices, rtol=1e-10)
        np.testing.assert_array_equal(raw.faces, faces)


def test_solid_and_structured_data_of_vtk_are_no_surfaces(tmp_path: Path) -> None:
    path = tmp_path / "a.vtk"
    head = "# vtk DataFile Version 3.0\nx\nASCII\nDATASET "
    path.write_text(
        f"{head}UNSTRUCTURED_GRID\nPOINTS 4 float\n0 0 0 1 0 0 0 1 0 0 0 1\nCELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n10\n"
    )
    with pytest.raises(MeshError, match="holds solid or curved cells and no triangles; extract its surface"):
        read_mesh_file(path)
    path.write_text(f"{head}STRUCTURED_POINTS\nDIMENSIONS 2 2 2\n")
    with pytest.raises(MeshError, match="'STRUCTURED_POINTS', which is no surface mesh; save its surface as PolyData"):
        read_mesh_file(path)


def scene() -> tuple[trimesh.Scene, list[tuple[str, np.ndarray, np.ndarray]]]:
    """A scene of two meshes, one of which is shown twice, and where each part should lie."""
    turn = trimesh.transformations.euler_matrix(0.3, 0.4, 0.5)
    turn[:3, 3] = [1, 2, 3]
    large = np.diag([2.0, 2.0, 2.0, 1.0])
    body, head = (trimesh.Trimesh(*shapes.bumpy_sphere(n), process=False) for n in (2, 1))
    built = trimesh.Scene()
    built.add_geometry(body, geom_name="body", transform=turn)
    built.add_geometry(head, geom_name="head", parent_node_name="world", transform=large @ turn)
    moved = [("body", body.copy().apply_transform(turn)), ("head", head.copy().apply_transform(large @ turn))]
    return built, [(name, mesh.vertices, mesh.faces) for name, mesh in moved]


@pytest.mark.parametrize("kind", ["glb", "gltf", "3mf"])
def test_a_scene_is_read_part_by_part_in_its_place(tmp_path: Path, kind: str) -> None:
    built, parts = scene()
    path = tmp_path / f"scene.{kind}"
    if kind == "gltf":
        for name, content in built.export(file_type="gltf").items():
            (path if name == "model.gltf" else tmp_path / name).write_bytes(content)
    else:
        built.export(path)
    raw = read_mesh_file(path)
    np.testing.assert_allclose(raw.vertices, np.concatenate([vertices for _, vertices, _ in parts]), atol=2e-6)
    np.testing.assert_array_equal(raw.faces, np.concatenate([parts[0][2], parts[1][2] + len(parts[0][1])]))
    assert raw.notes == (
        "the file has 2 meshes; their vertices are numbered one after the other: 'body' (162 vertices), "
        "'head' (42 vertices)",
    )


def test_compressed_gltf_is_refused_by_the_name_of_its_compression(tmp_path: Path) -> None:
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps({"asset": {"version": "2.0"}, "extensionsRequired": ["KHR_draco_mesh_compression"]}))
    with pytest.raises(MeshError, match=r"is compressed \(KHR_draco_mesh_compression\), which is not read"):
        read_mesh_file(path)


def test_a_3mf_of_a_slicer_keeps_objects_in_further_models(tmp_path: Path) -> None:
    """The production extension: an item names an object in another model of the archive."""
    import zipfile

    core = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
    production = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
    mesh = (
        f'<model xmlns="{core}"><resources><object id="1" name="tetra"><mesh><vertices>'
        '<vertex x="0" y="0" z="0"/><vertex x="1" y="0" z="0"/><vertex x="0" y="1" z="0"/><vertex x="0" y="0" z="1"/>'
        '</vertices><triangles><triangle v1="0" v2="2" v3="1"/><triangle v1="0" v2="1" v3="3"/></triangles></mesh>'
        "</object></resources></model>"
    )
    root = (
        f'<model xmlns="{core}" xmlns:p="{production}"><resources><object id="2"><components>'
        '<component p:path="/3D/Objects/a.model" objectid="1" transform="0 1 0 -1 0 0 0 0 1 10 0 0"/></components>'
        '</object></resources><build><item objectid="2" transform="2 0 0 0 2 0 0 0 2 0 0 5"/></build></model>'
    )
    with zipfile.ZipFile(tmp_path / "a.3mf", "w") as archive:
        archive.writestr("3D/3dmodel.model", root)
        archive.writestr("3D/Objects/a.model", mesh)
    raw = read_mesh_file(tmp_path / "a.3mf")
    # A row vector is multiplied from the left: x becomes y, y becomes -x; then moved, then doubled and lifted.
    assert raw.vertices.tolist() == [[20, 0, 5], [20, 2, 5], [18, 0, 5], [20, 0, 7]]
    assert raw.faces.tolist() == [[0, 2, 1], [0, 1, 3]]
    looped = root.replace('p:path="/3D/Objects/a.model" objectid="1"', 'objectid="2"')
    with zipfile.ZipFile(tmp_path / "b.3mf", "w") as archive:
        archive.writestr("3D/3dmodel.model", looped)
    with pytest.raises(MeshError, match="objects that are made of themselves"):
        read_mesh_file(tmp_path / "b.3mf")


@pytest.mark.parametrize("name", sorted({**malformed.WRITERS, **file_formats.WRITERS} - {"ply.gz": 0}.keys()))
def test_gzipped_files_are_what_is_packed_in_them(tmp_path: Path, name: str) -> None:
    content = {**malformed.WRITERS, **file_formats.WRITERS}[name](shapes.bumpy_sphere(1))
    plain, packed = tmp_path / f"a.{name.split()[-1]}", tmp_path / f"b.{name.split()[-1].upper()}.GZ"
    plain.write_bytes(content)
    packed.write_bytes(gzip.compress(content))
    np.testing.assert_array_equal(read_mesh_file(packed).vertices, read_mesh_file(plain).vertices)
    np.testing.assert_array_equal(read_mesh_file(packed).faces, read_mesh_file(plain).faces)
    packed.write_bytes(gzip.compress(content)[:-9])
    with pytest.raises(MeshError, match=r"GZ: is no whole gzip file \(.*\); copy or pack it again"):
        read_mesh_file(packed)


def test_names_of_meshes() -> None:
    for name in ("a.ply", "A.OFF.gz", "b/c.surf.gii", "x.vtp"):
        assert is_mesh_name(name)
    for name in ("pairs.txt", "a.xyz", "lh.pial", "a.gz", "ply"):
        assert not is_mesh_name(name)
    assert [mesh_stem(name) for name in ("a.ply", "a.PLY.gz", "a.surf.gii", "lh.pial", "a")] == [
        "a", "a", "a.surf", "lh.pial", "a",
    ]  # fmt: skip


def test_the_home_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    path = shapes.write_off(tmp_path / "a.off", *shapes.bumpy_sphere(1))
    assert load_mesh("~/a.off").path == str(path)
