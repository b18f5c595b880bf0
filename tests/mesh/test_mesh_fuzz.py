"""Damaged bytes and random arrays: only a MeshError or a valid mesh may come out."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import file_formats
import malformed
import numpy as np
import pytest
import shapes
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from clalign.errors import MeshError
from clalign.mesh import topology
from clalign.mesh.checks import diagnose
from clalign.mesh.mesh import Mesh, load_mesh, mesh_from_arrays
from clalign.mesh.repair import repair

WRITERS = {**malformed.WRITERS, **file_formats.WRITERS, "xyz": file_formats.points}
CONTENT = {name: write(shapes.bumpy_sphere(1)) for name, write in WRITERS.items()}
# More examples, new ones on every run: CLALIGN_FUZZ_EXAMPLES=1500 pytest tests/mesh/test_mesh_fuzz.py
EXAMPLES = os.environ.get("CLALIGN_FUZZ_EXAMPLES")
BOUNDED = settings(
    max_examples=int(EXAMPLES or 80),
    derandomize=EXAMPLES is None,
    database=None,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
PIECES = [
    b"nan",
    b"-1",
    b"1e999",
    b"99999999999999999999",
    b"0",
    b"\n",
    b" ",
    b"end_header\n",
    b"/",
    b"\0",
    b"list",
    b"",
]
STARTS = {
    "off": b"OFF\n",
    "obj": b"",
    "ply": b"ply\n",
    "stl": b"solid x\n",
    "vtk": b"# vtk DataFile Version 3.0\nx\nBINARY\nDATASET POLYDATA\n",
    "vtp": b"<VTKFile type='PolyData'>",
    "gii": b"<?xml version='1.0'?><GIFTI>",
    "glb": b"glTF\2\0\0\0",
    "3mf": b"PK\3\4",
    "white": b"\xff\xff\xfe x\n\n",
    "xyz": b"0 0 0\n",
    "ply.gz": b"\x1f\x8b\x08",
}
PIECES += [b"element face 7\n", b"f 1 2 3\n", b"4 0 1 2 3\n", b"\xff\xfe", b"#", b"\\\n"]


def assert_valid(mesh: Mesh) -> None:
    """What the rest of the program relies on."""
    n = mesh.n_vertices
    assert np.isfinite(mesh.vertices).all()
    assert mesh.faces.min() == 0
    assert mesh.faces.max() == n - 1
    assert mesh.file_index.max() < mesh.file_count
    on_surface = mesh.vertex_of_file >= 0
    assert on_surface[mesh.file_index].all()
    assert mesh.vertex_of_file.max() < n
    assert not on_surface[mesh.loose.file_index].any()
    np.testing.assert_array_equal(mesh.vertices[mesh.vertex_of_file[mesh.file_index]], mesh.vertices)
    assert abs(topology.face_areas(mesh.vertices, mesh.faces).sum() - 1) < 1e-9
    table = topology.edge_table(mesh.faces, n)
    assert table.face_count.max() <= 2
    np.testing.assert_array_equal(topology.fan_counts(mesh.faces, table, n), 1)
    one, other = topology.paired_half_edges(table)
    assert (table.forward[one] != table.forward[other]).all()
    assert topology.connected_components(mesh.faces, n)[0] == 1
    assert np.isfinite(mesh.scale)
    assert np.isfinite(mesh.offset).all()


def load_bytes(content: bytes, suffix: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"fuzzed.{suffix}"
        path.write_bytes(content)
        mesh, message = attempt(lambda: load_mesh(path))
    if mesh is None:
        assert message.startswith(f"{path}: ")
        assert "\n" not in message
    else:
        assert_valid(mesh)


Result = TypeVar("Result")


def attempt(action: Callable[[], Result]) -> tuple[Result | None, str]:
    """The result of an action, or the message of its MeshError; anything else that it raises fails the test."""
    try:
        return action(), ""
    except MeshError as error:
        return None, str(error)


@pytest.mark.parametrize("name", sorted(CONTENT))
@given(data=st.data())
@BOUNDED
def test_mutated_files(name: str, data: st.DataObject) -> None:
    content = CONTENT[name]
    # Half of the damage goes to the first 400 bytes, where the headers are.
    place = st.integers(0, 400) | st.integers(0, len(content))
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(place)
        length = data.draw(st.integers(0, 6) | st.integers(0, len(content)))
        piece = data.draw(st.sampled_from(PIECES) | st.binary(max_size=8))
        content = content[:start] + piece + content[start + length :]
    load_bytes(content, name.split()[-1])


@pytest.mark.parametrize("suffix", sorted(STARTS))
@given(content=st.binary(max_size=300) | st.text(alphabet="OFplyvf 0123-.e/\n#", max_size=300).map(str.encode))
@BOUNDED
def test_random_bytes(suffix: str, content: bytes) -> None:
    load_bytes(STARTS[suffix] + content, suffix)


@given(data=st.data())
@BOUNDED
def test_random_arrays(data: st.DataObject) -> None:
    vertices, faces = shapes.bumpy_sphere(1)
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    for _ in range(data.draw(st.integers(0, 3))):
        value = data.draw(st.floats(allow_nan=True, allow_infinity=True))
        vertices[rng.integers(0, len(vertices), data.draw(st.integers(1, 30))), rng.integers(0, 3)] = value
    for _ in range(data.draw(st.integers(0, 3))):
        count = data.draw(st.integers(1, 30))
        limit = data.draw(st.sampled_from([len(vertices), len(vertices) + 1]))
        extra = rng.integers(0, limit, size=(count, 3))
        faces = np.concatenate([faces[: len(faces) - data.draw(st.integers(0, 10))], extra])
    mesh, message = attempt(lambda: mesh_from_arrays(vertices, faces))
    if mesh is None:
        assert message.startswith("mesh: ")
    else:
        assert_valid(mesh)
    merge = data.draw(st.booleans())
    repaired, message = attempt(lambda: repair(vertices, faces, merge=merge))
    if repaired is None:
        assert "cannot be repaired" in message
    else:
        assert not diagnose(repaired.vertices, repaired.faces, strict=True).refused
        np.testing.assert_array_equal(repaired.vertices, vertices[repaired.file_index])
