"""Surfaces of the cortex: FreeSurfer's (lh.pial, rh.white, lh.inflated, …) and GIFTI (.surf.gii).

Positions are those that the file lists, without the transformation to scanner space that it may name beside them: it is
rigid or affine for the whole surface, and numbers of vertices do not depend on it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clalign.mesh.reading.common import NO_FACES, FileMesh, FormatError, damage_in_a_sentence, doubles, missing_package

FREESURFER_MAGIC = b"\xff\xff\xfe"
OTHER_MAGICS = (b"\xff\xff\xff", b"\xff\xff\xfd")


def read_freesurfer(content: bytes, folder: Path) -> FileMesh:
    """Read FreeSurfer's triangle file: two lines of text, two counts, positions and faces, all big-endian."""
    if content.startswith(OTHER_MAGICS):
        raise FormatError(
            "is a FreeSurfer file of values or of quadrangles, not of triangles; give the surface, such as lh.white, "
            "or convert it with FreeSurfer's mris_convert"
        )
    if not content.startswith(FREESURFER_MAGIC):
        raise FormatError("is no FreeSurfer surface; export it again")
    at = content.find(b"\n\n") + 2
    counts = np.frombuffer(content, ">i4", 2, at).tolist() if 2 <= at <= len(content) - 8 else [-1]
    if min(counts) < 0:
        raise FormatError("is a FreeSurfer surface without counts of vertices and faces; it is damaged; copy it again")
    n_vertices, n_faces = counts
    start, end = at + 8, at + 8 + 12 * n_vertices + 12 * n_faces
    if len(content) < end:
        raise FormatError(
            f"its header promises {n_vertices} vertices and {n_faces} faces, more than the file can hold; "
            "the file is truncated; copy it again"
        )
    vertices = doubles(np.frombuffer(content, ">f4", 3 * n_vertices, start)).reshape(-1, 3)
    faces = np.frombuffer(content, ">i4", 3 * n_faces, start + 12 * n_vertices).reshape(-1, 3).astype(np.int64)
    return FileMesh(vertices, faces)


def read_gifti(content: bytes, folder: Path) -> FileMesh:
    """Read the points and triangles of a GIFTI surface."""
    try:
        from nibabel.gifti import GiftiImage
    except ImportError as error:
        raise missing_package("nibabel", "GIFTI files") from error
    with damage_in_a_sentence():
        image = GiftiImage.from_bytes(content)
        points = image.get_arrays_from_intent("NIFTI_INTENT_POINTSET")
        triangles = image.get_arrays_from_intent("NIFTI_INTENT_TRIANGLE")
        if len(points) != 1 or len(triangles) > 1:
            raise FormatError(
                f"holds {len(points)} lists of points and {len(triangles)} of triangles where one of each is needed; "
                "files of values (.func.gii, .shape.gii, .label.gii) are no surfaces: give the .surf.gii"
            )
        vertices = np.asarray(points[0].data, dtype=np.float64).reshape(-1, 3)
        faces = np.asarray(triangles[0].data).reshape(-1, 3).astype(np.int64) if triangles else NO_FACES
    return FileMesh(vertices, faces)
