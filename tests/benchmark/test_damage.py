"""Damaged meshes: the truth is right, and what was damaged is read as the surface that it was."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapes

from clalign.benchmark.damage import DAMAGES, Damaged
from clalign.benchmark.damaged import ALL_DAMAGES, damaged
from clalign.errors import OptionError
from clalign.mesh.mesh import Mesh, mesh_from_arrays
from clalign.mesh.topology import boundary_edges, edge_loops, face_areas

MOVES = ("pinched", "coarse", "sampled")
"""Damages after which a vertex is where another one was."""


@pytest.fixture(scope="module")
def sound() -> Mesh:
    vertices, faces = shapes.bumpy_sphere(4)
    return mesh_from_arrays(vertices * [1.0, 0.08, 1.0], faces, "disc")


@pytest.fixture(params=list(DAMAGES))
def case(request: pytest.FixtureRequest, sound: Mesh) -> tuple[str, Damaged]:
    rng = np.random.default_rng(1)
    return request.param, DAMAGES[request.param](sound.file_vertices(), sound.file_faces, rng)


def test_every_vertex_is_where_the_truth_says(case: tuple[str, Damaged], sound: Mesh) -> None:
    name, found = case
    there = found.new_of_old >= 0
    assert there.mean() > 0.98
    gap = np.linalg.norm(found.vertices[found.new_of_old[there]] - sound.file_vertices()[there], axis=1)
    assert gap.max() <= (0.4 if name in MOVES else 0.0)
    assert np.mean(gap > 0) < 0.02 or name in ("coarse", "sampled")


def test_the_surface_is_found_again(case: tuple[str, Damaged], sound: Mesh) -> None:
    name, found = case
    mesh = mesh_from_arrays(found.vertices, found.faces, name)
    area = face_areas(mesh.file_vertices(), mesh.faces).sum()
    share = area / face_areas(sound.file_vertices(), sound.faces).sum()
    assert share == pytest.approx(1.0, abs=0.06 if name in ("coarse", "points", "sampled") else 0.03)
    edges = boundary_edges(mesh.faces, mesh.n_vertices)
    if name == "holes":
        assert 1 <= edge_loops(edges)[0] <= 10
    elif name not in (*MOVES, "points"):
        assert not len(edges)
        assert mesh.n_vertices - mesh.n_faces // 2 == 2
    expected = {"unwelded": sound.n_vertices, "fins": sound.n_vertices, "shells": sound.n_vertices}
    assert mesh.n_vertices == expected.get(name, mesh.n_vertices)
    if name != "pinched":
        matched = found.new_of_old[found.new_of_old >= 0]
        assert (mesh.vertex_of_file[matched] >= 0).all()


def test_lists_take_turns_under_every_damage(tmp_path: Path) -> None:
    for name in ("a", "b", "c"):
        shapes.write_off(tmp_path / f"{name}.off", *shapes.bumpy_sphere(2))
    (tmp_path / "pairs_one.txt").write_text("a b\na c\n")
    (tmp_path / "pairs_two.txt").write_text("b c\n")
    layouts = damaged(tmp_path)
    assert [layout.name.split("/")[1] for layout in layouts] == list(ALL_DAMAGES)
    assert sorted(pair.name for pair in layouts[0].pairs) == ["a b", "a c", "b c"]
    assert layouts[0].pairs[0].name.split()[0] != layouts[0].pairs[1].name.split()[0]
    with pytest.raises(OptionError, match="unknown damage 'dents'"):
        damaged(tmp_path, ["dents"])


def test_the_truth_follows_the_damage_and_the_shuffle(tmp_path: Path) -> None:
    vertices, faces = shapes.bumpy_sphere(3)
    for name in ("a", "b"):
        shapes.write_off(tmp_path / f"{name}.off", vertices, faces)
    (tmp_path / "pairs.txt").write_text("a b\n")
    for layout in damaged(tmp_path, ["holes", "unwelded"]):
        pair = layout.pairs[0].load()
        places = pair.target.file_positions()[pair.truth.target_points]
        np.testing.assert_allclose(places, vertices[pair.truth.source_points], atol=1e-9)
