"""One mesh in the formats that other fields use, written by their own libraries or as their papers describe them."""

from __future__ import annotations

import gzip
import io
import struct
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import malformed
import numpy as np
from malformed import Arrays


def glb(arrays: Arrays) -> bytes:
    """Binary glTF by trimesh; positions become float32."""
    import trimesh

    return bytes(trimesh.Trimesh(*arrays, process=False).export(file_type="glb"))


def threemf(arrays: Arrays) -> bytes:
    """3MF by trimesh."""
    import trimesh

    return bytes(trimesh.Trimesh(*arrays, process=False).export(file_type="3mf"))


def gifti(arrays: Arrays, encoding: str = "GIFTI_ENCODING_B64GZ") -> bytes:
    """GIFTI by nibabel; positions become float32."""
    from nibabel.gifti import GiftiDataArray, GiftiImage

    vertices, faces = arrays
    points = GiftiDataArray(vertices.astype(np.float32), intent="NIFTI_INTENT_POINTSET", encoding=encoding)
    triangles = GiftiDataArray(faces.astype(np.int32), intent="NIFTI_INTENT_TRIANGLE", encoding=encoding)
    return bytes(GiftiImage(darrays=[points, triangles]).to_bytes())


def freesurfer(arrays: Arrays) -> bytes:
    """FreeSurfer surface by nibabel; positions become float32."""
    import nibabel.freesurfer

    with tempfile.TemporaryDirectory() as folder:
        nibabel.freesurfer.write_geometry(f"{folder}/lh.pial", *arrays, create_stamp="created by a test")
        return Path(folder, "lh.pial").read_bytes()


def vtu(arrays: Arrays, **options: object) -> bytes:
    """VTK's unstructured grid in XML by meshio."""
    return _by_meshio(arrays, "vtu", options)


def vtk_grid(arrays: Arrays, **options: object) -> bytes:
    """VTK's legacy unstructured grid by meshio."""
    return _by_meshio(arrays, "vtk", options)


def _by_meshio(arrays: Arrays, kind: str, options: dict[str, object]) -> bytes:
    with warnings.catch_warnings():
        # meshio asks for more than this file format needs.
        warnings.simplefilter("ignore")
        import meshio

        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, f"mesh.{kind}")
            meshio.Mesh(arrays[0], [("triangle", arrays[1])]).write(path, **options)
            return path.read_bytes()


def vtk_polydata(arrays: Arrays) -> bytes:
    """VTK's legacy PolyData as text."""
    vertices, faces = arrays
    lines = ["# vtk DataFile Version 3.0", "a mesh", "ASCII", "DATASET POLYDATA", f"POINTS {len(vertices)} double"]
    lines += [f"{x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += [f"POLYGONS {len(faces)} {4 * len(faces)}", *(f"3 {a} {b} {c}" for a, b, c in faces.tolist())]
    return ("\n".join(lines) + "\n").encode()


def vtp(arrays: Arrays) -> bytes:
    """VTK's PolyData in XML with the numbers appended raw."""
    vertices, faces = arrays
    tables = [vertices.astype("<f8"), faces.astype("<i8"), 3 * np.arange(1, len(faces) + 1).astype("<i8")]
    blocks = [struct.pack("<Q", table.nbytes) + table.tobytes() for table in tables]
    starts = np.cumsum([0] + [len(block) for block in blocks]).tolist()
    array = "<DataArray type='{}' Name='{}' NumberOfComponents='{}' format='appended' offset='{}'/>".format
    text = (
        "<?xml version='1.0'?><VTKFile type='PolyData' version='1.0' byte_order='LittleEndian' header_type='UInt64'>"
        f"<PolyData><Piece NumberOfPoints='{len(vertices)}' NumberOfPolys='{len(faces)}'><Points>"
        f"{array('Float64', 'Points', 3, starts[0])}</Points><Polys>{array('Int64', 'connectivity', 1, starts[1])}"
        f"{array('Int64', 'offsets', 1, starts[2])}</Polys></Piece></PolyData><AppendedData encoding='raw'>_"
    )
    return text.encode() + b"".join(blocks) + b"</AppendedData></VTKFile>"


def points(arrays: Arrays) -> bytes:
    """Positions alone."""
    stream = io.BytesIO()
    np.savetxt(stream, arrays[0], fmt="%.17g")
    return stream.getvalue()


WRITERS: dict[str, Callable[[Arrays], bytes]] = {
    "glb": glb,
    "3mf": threemf,
    "gii": gifti,
    "pial": freesurfer,
    "vtk": vtk_polydata,
    "binary grid.vtk": vtk_grid,
    "vtp": vtp,
    "vtu": vtu,
    "ply.gz": lambda arrays: gzip.compress(malformed.WRITERS["binary ply"](arrays), mtime=0),
}
"""Bytes of a mesh in every further format with faces; the last word, or what follows its point, is the suffix."""
