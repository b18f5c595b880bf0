"""Writes a match for other programs.

Text maps, coloured PLY and textured OBJ use the vertex numbers of the mesh files; the faces of PLY and OBJ are those of
the surface that was matched and of the loose pieces that were carried along. The eigenfunctions exist only for vertices
on that surface, so NumPy, MATLAB, pyFM and geomfum exports number vertices as the arrays in the same file do (the two
numberings agree where a file is one clean surface).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from clalign.correspondence import Correspondence
from clalign.errors import InputError
from clalign.geometry.operators import stiffness
from clalign.mesh.front import Up, front_view
from clalign.mesh.mesh import Mesh
from clalign.mesh.writing import save_mesh
from clalign.presentation.picture import pair_colours
from clalign.presentation.raster import write_png
from clalign.storage.files import visible
from clalign.transfer.colours import position_colours
from clalign.transfer.outputs import keep_originals
from clalign.transfer.surface_map import surface_map
from clalign.transfer.texture import Texture, write_textured_obj

ArraysOf = Callable[[Correspondence], dict[str, NDArray[Any]]]

FILES: dict[str, tuple[str, ...]] = {
    "ply": ("source.ply", "target.ply"),
    "obj": ("source.obj", "target.obj", "texture.mtl", "texture.png"),
    "vts": ("source.vts", "target.vts"),
    "map": ("source_target.map", "target_source.map"),
    "numpy": ("match.npz",),
    "matlab": ("match.mat",),
    "pyfm": ("pyfm.npz",),
    "geomfum": ("geomfum.npz",),
    "report": ("report.html",),
    "picture": ("match.png",),
}
"""The files of every format."""

_TEXTURE_SIZE = 512
_TEXTURE_SQUARES = 24
_MATERIAL = "newmtl checkers\nKa 1 1 1\nKd 1 1 1\nKs 0 0 0\nmap_Kd texture.png\n"


def export_ply(correspondence: Correspondence, folder: str | Path, *, up: Up | None = None) -> list[Path]:
    """Write ``source.ply`` and ``target.ply``, coloured alike where they match. Returns the files."""
    meshes = (correspondence.source, correspondence.target)
    paths = [_ready(folder) / name for name in FILES["ply"]]
    keep_originals(correspondence, paths)
    colours = _file_colours(correspondence, up)
    for path, mesh, rows in zip(paths, meshes, colours, strict=True):
        save_mesh(path, mesh.file_positions(), mesh.all_file_faces, rows)
    return paths


def _file_colours(correspondence: Correspondence, up: Up | None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the colours of the vertices of both files, (file_count, 3); grey where there is no match.

    Loose vertices of the target are coloured like the surface near them, those of the source like their matches.
    """
    source, target = correspondence.source, correspondence.target
    on_source, on_target = pair_colours(correspondence, front_view(target.vertices, up))
    target_rows, source_rows = target.to_file(on_target, 0.5), source.to_file(on_source, 0.5)
    if len(target.loose.vertices):
        target_rows[target.loose.file_index] = on_target[cKDTree(target.vertices).query(target.loose.vertices)[1]]
    return _with_loose(correspondence, source_rows, target_rows), target_rows


def _with_loose(
    correspondence: Correspondence, on_source: NDArray[np.float64], on_target: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return rows of the source's file, those of loose vertices set to the target's rows at their matches."""
    loose = correspondence.source.loose.file_index
    match = correspondence.target_of_source[loose]
    on_source[loose[match >= 0]] = on_target[match[match >= 0]]
    return on_source


def export_obj(correspondence: Correspondence, folder: str | Path, *, up: Up | None = None) -> list[Path]:
    """Write both shapes as OBJ with one checkered texture, laid on the target from the front and carried to the source.

    Writes ``source.obj``, ``target.obj``, ``texture.mtl`` and ``texture.png`` and returns these files.
    """
    folder, target = _ready(folder), correspondence.target
    keep_originals(correspondence, [folder / name for name in FILES["obj"]])
    view = front_view(target.vertices, up)[:2].T
    seen = target.vertices @ view
    low, span = seen.min(axis=0), np.ptp(seen, axis=0).max()
    in_place = (target.file_positions() - target.offset) / target.scale
    on_target = 0.02 + 0.96 * (in_place @ view - low) / span
    pulled = surface_map(correspondence).pull(target.from_file(on_target))
    on_source = _with_loose(correspondence, correspondence.source.to_file(pulled, 0.0), on_target)
    materials = ("mtllib texture.mtl", "usemtl checkers")
    for side, mesh, rows in (("source", correspondence.source, on_source), ("target", target, on_target)):
        texture = Texture(rows, mesh.all_file_faces, mesh.all_file_faces, materials)
        write_textured_obj(folder / f"{side}.obj", mesh.file_positions(), texture)
    (folder / "texture.mtl").write_text(_MATERIAL, encoding="ascii")
    write_png(folder / "texture.png", _checkers())
    return [folder / name for name in FILES["obj"]]


def export_vts(correspondence: Correspondence, folder: str | Path) -> list[Path]:
    """Write ``source.vts`` and ``target.vts``: line i of both is one point, as vertices counted from 1.

    Source vertices without a match have no line.
    """
    matched = np.flatnonzero(correspondence.target_of_source >= 0)
    return _save_numbers(folder, {"source.vts": matched, "target.vts": correspondence.target_of_source[matched]})


def export_map(correspondence: Correspondence, folder: str | Path) -> list[Path]:
    """Write ``source_target.map`` and ``target_source.map``.

    Line i holds the vertex, counted from 1, of the second shape for vertex i of the first; 0 where there is none.
    """
    maps = {"source_target.map": correspondence.target_of_source, "target_source.map": correspondence.source_of_target}
    return _save_numbers(folder, maps)


def surface_arrays(correspondence: Correspondence) -> dict[str, NDArray[Any]]:
    """Return meshes, bases and maps in one numbering, that of the vertices on the surface, counted from 0.

    Returns
    -------
    dict with, for each side s in source, target: ``s_vertices`` (n, 3) and ``s_faces`` (m, 3) scaled to unit area,
    ``s_file_index`` (n,), ``s_mass`` (n,), ``s_eigenvalues`` (k,), ``s_functions`` (n, k) of the Laplace–Beltrami
    operator, ``s_si_eigenvalues``, ``s_si_functions`` and ``s_si_mass`` of the scale-invariant one; and
    ``functional_map`` (k_target, k_source), ``rotation`` (d, d), ``target_of_source`` (n_source,),
    ``source_of_target`` (n_target,), ``distortion`` (n_source,).
    """
    arrays: dict[str, NDArray[Any]] = {}
    for side in ("source", "target"):
        mesh: Mesh = getattr(correspondence, side)
        basis, invariant = getattr(correspondence, f"{side}_basis"), getattr(correspondence, f"{side}_scale_invariant")
        own = {
            "vertices": mesh.vertices,
            "faces": mesh.faces,
            "file_index": mesh.file_index,
            "mass": basis.mass,
            "eigenvalues": basis.eigenvalues,
            "functions": basis.functions,
            "si_eigenvalues": invariant.eigenvalues,
            "si_functions": invariant.functions,
            "si_mass": invariant.mass,
        }
        arrays |= {f"{side}_{name}": values for name, values in own.items()}
    source, target = correspondence.source, correspondence.target
    return arrays | {
        "functional_map": correspondence.functional_map,
        "rotation": correspondence.rotation,
        "target_of_source": source.map_from_file(target, correspondence.target_of_source),
        "source_of_target": target.map_from_file(source, correspondence.source_of_target),
        "distortion": correspondence.distortion,
    }


def export_matlab(correspondence: Correspondence, folder: str | Path) -> list[Path]:
    """Write ``match.mat`` for MATLAB: the arrays of `surface_arrays` with vertices counted from 1.

    S1 is the source and S2 the target, each with X, T, evals, evecs, A and file_index; C12 (k2, k1) takes coefficients
    of functions on S1 to S2, T12 (n1,) and T21 (n2,) hold the vertex on the other shape (0: none), R is the rotation.
    """
    import scipy.io

    arrays = surface_arrays(correspondence)
    shapes = {
        name: {
            "X": arrays[f"{side}_vertices"],
            "T": arrays[f"{side}_faces"].astype(np.float64) + 1,
            "evals": arrays[f"{side}_eigenvalues"][:, None],
            "evecs": arrays[f"{side}_functions"],
            "A": arrays[f"{side}_mass"][:, None],
            "si_evals": arrays[f"{side}_si_eigenvalues"][:, None],
            "si_evecs": arrays[f"{side}_si_functions"],
            "file_index": arrays[f"{side}_file_index"][:, None].astype(np.float64) + 1,
            "name": visible(getattr(correspondence, side).name),
        }
        for name, side in (("S1", "source"), ("S2", "target"))
    }
    path = _ready(folder) / "match.mat"
    maps = {
        "C12": correspondence.functional_map,
        "R": correspondence.rotation,
        # MATLAB indexes with doubles.
        "T12": arrays["target_of_source"][:, None].astype(np.float64) + 1,
        "T21": arrays["source_of_target"][:, None].astype(np.float64) + 1,
    }
    scipy.io.savemat(path, {**shapes, **maps}, do_compression=True)
    return [path]


def pyfm_arrays(correspondence: Correspondence) -> dict[str, NDArray[Any]]:
    """Return the match in the names of pyFM, mesh 1 being the source and mesh 2 the target.

    Returns
    -------
    dict with ``FM_12`` (k2, k1), which takes functions on 1 to functions on 2, ``p2p_21`` (n2,), the vertex of mesh 1
    of each vertex of mesh 2, ``p2p_12`` (n1,), and ``evals1``, ``evects1`` (n1, k1), ``A1`` (n1,), the same for 2.
    """
    arrays = surface_arrays(correspondence)
    rows, columns = correspondence.functional_map.shape
    named = {
        "FM_12": arrays["functional_map"],
        "p2p_21": arrays["source_of_target"],
        "p2p_12": arrays["target_of_source"],
    }
    for number, side, count in (("1", "source", columns), ("2", "target", rows)):
        named[f"evals{number}"] = arrays[f"{side}_eigenvalues"][:count]
        named[f"evects{number}"] = arrays[f"{side}_functions"][:, :count]
        named[f"A{number}"] = arrays[f"{side}_mass"]
    return named


def to_pyfm(correspondence: Correspondence) -> tuple[Any, Any, NDArray[np.float64]]:
    """Return the match as pyFM objects: mesh 1 (the source) and mesh 2 with their spectra set, and FM_12.

    Raises
    ------
    InputError
        pyFM is not installed.
    """
    try:
        from pyFM.mesh import TriMesh
    except ImportError as error:
        raise InputError("pyFM is not installed; install it with: pip install pyfmaps") from error
    arrays = pyfm_arrays(correspondence)
    meshes = []
    for number, mesh in (("1", correspondence.source), ("2", correspondence.target)):
        made = TriMesh(mesh.vertices, mesh.faces)
        made.W, made.A = _matrices(mesh, arrays[f"A{number}"])
        made.eigenvalues, made.eigenvectors = arrays[f"evals{number}"], arrays[f"evects{number}"]
        meshes.append(made)
    return meshes[0], meshes[1], arrays["FM_12"]


def geomfum_arrays(correspondence: Correspondence) -> dict[str, NDArray[Any]]:
    """Return the match in the names of geomfum, shape a being the source and shape b the target.

    Returns
    -------
    dict with ``fmap_matrix`` (spectrum_size_b, spectrum_size_a), ``p2p`` (n_vertices_b,), the vertex of a of each
    vertex of b, and ``basis_a_vals``, ``basis_a_vecs``, ``mass_a``, the same for b.
    """
    arrays = pyfm_arrays(correspondence)
    named = {"fmap_matrix": arrays["FM_12"], "p2p": arrays["p2p_21"]}
    for letter, number in (("a", "1"), ("b", "2")):
        named[f"basis_{letter}_vals"] = arrays[f"evals{number}"]
        named[f"basis_{letter}_vecs"] = arrays[f"evects{number}"]
        named[f"mass_{letter}"] = arrays[f"A{number}"]
    return named


def to_geomfum(correspondence: Correspondence) -> tuple[Any, Any, NDArray[np.float64]]:
    """Return the match as geomfum objects: shape a (the source) and shape b with their bases set, and fmap_matrix.

    Raises
    ------
    InputError
        geomfum is not installed.
    """
    try:
        from geomfum.basis import LaplaceEigenBasis
        from geomfum.operator import Laplacian
        from geomfum.shape import TriangleMesh
    except ImportError as error:
        raise InputError("geomfum is not installed; install it with: pip install geomfum") from error
    arrays = geomfum_arrays(correspondence)
    made = []
    for letter, mesh in (("a", correspondence.source), ("b", correspondence.target)):
        shape = TriangleMesh(mesh.vertices, mesh.faces)
        weights, mass = _matrices(mesh, arrays[f"mass_{letter}"])
        shape.laplacian = Laplacian(shape=shape, stiffness_matrix=weights, mass_matrix=mass)
        shape.set_basis(LaplaceEigenBasis(shape, arrays[f"basis_{letter}_vals"], arrays[f"basis_{letter}_vecs"]))
        made.append(shape)
    return made[0], made[1], arrays["fmap_matrix"]


def _matrices(mesh: Mesh, mass: NDArray[np.float64]) -> tuple[Any, Any]:
    """Return W and A of a mesh as the sparse matrices that other libraries hold."""
    import scipy.sparse

    return stiffness(mesh.vertices, mesh.faces).tocsc(), scipy.sparse.diags(mass, format="csc")


def _checkers() -> NDArray[np.uint8]:
    place = (np.arange(_TEXTURE_SIZE) + 0.5) / _TEXTURE_SIZE
    across, height = np.meshgrid(place, 1.0 - place)
    points = np.stack([across, height, np.full_like(across, 0.5)], axis=-1).reshape(-1, 3)
    colours = position_colours(points, np.eye(3)).reshape(_TEXTURE_SIZE, _TEXTURE_SIZE, 3)
    dark = (np.floor(across * _TEXTURE_SQUARES) + np.floor(height * _TEXTURE_SQUARES)) % 2 == 0
    return np.rint(255 * np.where(dark[..., None], 0.62 * colours, colours)).astype(np.uint8)


def _ready(folder: str | Path) -> Path:
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _save_numbers(folder: str | Path, files: dict[str, NDArray[np.int64]]) -> list[Path]:
    """Write one vertex a line, counted from 1."""
    for name, vertices in files.items():
        np.savetxt(_ready(folder) / name, vertices + 1, fmt="%d")
    return [Path(folder) / name for name in files]


def _export_arrays(name: str, arrays_of: ArraysOf, correspondence: Correspondence, folder: str | Path) -> list[Path]:
    arrays: dict[str, Any] = arrays_of(correspondence)
    np.savez_compressed(_ready(folder) / name, **arrays)
    return [Path(folder) / name]


FORMATS: dict[str, Callable[[Correspondence, str | Path], list[Path]]] = {
    "ply": export_ply,
    "obj": export_obj,
    "vts": export_vts,
    "map": export_map,
    "numpy": partial(_export_arrays, "match.npz", surface_arrays),
    "matlab": export_matlab,
    "pyfm": partial(_export_arrays, "pyfm.npz", pyfm_arrays),
    "geomfum": partial(_export_arrays, "geomfum.npz", geomfum_arrays),
}
"""The functions that write a match into a folder, by the name of the format."""
