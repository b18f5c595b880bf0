"""Scenes of several meshes: glTF and GLB through trimesh, and 3MF. Every mesh is moved to its place in the scene."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from clalign.mesh.reading.common import NO_FACES, FileMesh, FormatError, Part, damage_in_a_sentence, joined

COMPRESSIONS = {"KHR_draco_mesh_compression", "EXT_meshopt_compression"}
MAX_DEPTH = 32
"""Objects of a 3MF within objects, at most; a file that names itself would not end."""


def read_glb(content: bytes, folder: Path) -> FileMesh:
    """Read a binary glTF."""
    if not content.startswith(b"glTF"):
        raise FormatError(
            "does not begin with glTF, so it is no GLB file; is the suffix right? Otherwise export it again"
        )
    with damage_in_a_sentence():
        document = json.loads(content[20 : 20 + int.from_bytes(content[12:16], "little")])
        return _gltf(content, document, folder, "glb")


def read_gltf(content: bytes, folder: Path) -> FileMesh:
    """Read a glTF of text, whose numbers mostly lie in another file beside it."""
    with damage_in_a_sentence():
        return _gltf(content, json.loads(content), folder, "gltf")


def _gltf(content: bytes, document: dict[str, Any], folder: Path, kind: str) -> FileMesh:
    """Concatenate the meshes as they come in the file, each as often as the scene shows it; lines are left out."""
    import trimesh
    from trimesh.resolvers import FilePathResolver

    # Without the extension the positions would be read as zeros.
    compressed = COMPRESSIONS & set(document.get("extensionsRequired", []))
    if compressed:
        raise FormatError(f"is compressed ({', '.join(sorted(compressed))}), which is not read; export it uncompressed")
    resolver = FilePathResolver(str(folder))
    scene = trimesh.load_scene(
        io.BytesIO(content), file_type=kind, resolver=resolver, process=False, skip_materials=True
    )
    # trimesh walks the nodes from the last to the first.
    order = {name: number for number, name in enumerate(scene.geometry)}
    shown = [scene.graph[node] for node in reversed(scene.graph.nodes_geometry)]
    parts = []
    for transform, name in sorted(shown, key=lambda pair: order[pair[1]]):
        geometry = scene.geometry[name]
        if isinstance(geometry, (trimesh.Trimesh, trimesh.PointCloud)):
            faces = np.asarray(getattr(geometry, "faces", NO_FACES), dtype=np.int64)
            parts.append(Part(str(name), _moved(np.asarray(geometry.vertices), np.asarray(transform)), faces))
    if not parts:
        raise FormatError("holds no mesh; export it with its triangles")
    return joined(parts, "meshes")


def _moved(vertices: NDArray[np.number], transform: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) positions under a (4, 4) transform; where it changes nothing, every digit stays."""
    points = vertices.astype(np.float64).reshape(-1, 3)
    if np.array_equal(transform, np.eye(4)):
        return points
    return points @ transform[:3, :3].T + transform[:3, 3]


def read_3mf(content: bytes, folder: Path) -> FileMesh:
    """Concatenate the objects of the build, each moved to its place."""
    with damage_in_a_sentence():
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            models = {
                f"/{name}": ElementTree.fromstring(archive.read(name))
                for name in archive.namelist()
                if name.lower().endswith(".model")
            }
        objects = {
            (path, item.get("id")): item for path, root in models.items() for item in root.iterfind(".//{*}object")
        }
        parts: list[Part] = []
        for path, root in models.items():
            for item in root.iterfind("{*}build/{*}item"):
                parts += _object_parts(objects, _key(item, path), _transform(item), MAX_DEPTH)
    if not parts:
        raise FormatError("holds no mesh; export it with its triangles")
    return joined(parts, "meshes")


Objects = dict[tuple[str, str | None], ElementTree.Element]


def _object_parts(
    objects: Objects, key: tuple[str, str | None], transform: NDArray[np.float64], depth: int
) -> list[Part]:
    """Return the meshes of one object and of those that it is made of."""
    if depth == 0:
        raise FormatError("has objects that are made of themselves; export it again")
    item = objects[key]
    parts = []
    mesh = item.find("{*}mesh")
    if mesh is not None:
        corners = [[v.attrib[axis] for axis in "xyz"] for v in mesh.iterfind("{*}vertices/{*}vertex")]
        numbers = [[t.attrib[f"v{i}"] for i in (1, 2, 3)] for t in mesh.iterfind("{*}triangles/{*}triangle")]
        vertices = np.array(corners, dtype=np.float64).reshape(-1, 3)
        faces = np.array(numbers).astype(np.int64).reshape(-1, 3)
        parts.append(Part(item.get("name") or f"object {key[1]}", _moved(vertices, transform), faces))
    for component in item.iterfind("{*}components/{*}component"):
        parts += _object_parts(objects, _key(component, key[0]), transform @ _transform(component), depth - 1)
    return parts


def _key(item: ElementTree.Element, path: str) -> tuple[str, str | None]:
    """Return the object that an item names; slicers keep objects in further models of the archive."""
    other = next((value for name, value in item.attrib.items() if name.endswith("}path")), path)
    return other, item.get("objectid")


def _transform(item: ElementTree.Element) -> NDArray[np.float64]:
    """(4, 4) transform of an item, which lists the columns of rotation and shift as rows."""
    matrix = np.eye(4)
    words = item.get("transform", "").split()
    if words:
        matrix[:3] = np.array(words, dtype=np.float64).reshape(4, 3).T
    return matrix
