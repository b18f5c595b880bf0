"""Which shapes and pairs a collection has."""

from __future__ import annotations

import gzip
import os
import sys
from pathlib import Path

import numpy as np
import pytest
import shapes

from clalign.collection.members import (
    BLOCK,
    all_pairs,
    listed_pairs,
    read_members,
    spectrum_distances,
    star_pairs,
    tree_pairs,
)
from clalign.errors import ResultError


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    vertices, faces = shapes.icosphere(0)
    for name in ("pose10", "pose2", "pose1"):
        shapes.write_off(tmp_path / f"{name}.off", vertices, faces)
    (tmp_path / "notes.txt").write_text("not a mesh\n")
    return tmp_path


def test_folder_has_its_meshes_in_natural_order(folder: Path) -> None:
    members = read_members(folder)
    assert [member.name for member in members] == ["pose1", "pose2", "pose10"]
    assert len({member.digest for member in members}) == 1
    assert all(Path(member.path).is_absolute() for member in members)


def test_digest_changes_with_the_content(folder: Path) -> None:
    before = read_members(folder)[0].digest
    with (folder / "pose1.off").open("a") as stream:
        stream.write("# a comment\n")
    assert read_members(folder)[0].digest != before


def test_list_names_files_beside_it_and_keeps_those_that_are_missing(folder: Path) -> None:
    listing = folder / "list.txt"
    listing.write_text("pose2.off  # the second\n\npose1.off\nabsent.off\n")
    members = read_members(listing)
    assert [member.name for member in members] == ["pose2", "pose1", "absent"]
    assert members[2].digest == ""


def test_equal_stems_get_the_folder_into_their_names(folder: Path) -> None:
    (folder / "more").mkdir()
    other = shapes.write_off(folder / "more" / "pose1.off", *shapes.icosphere(0))
    members = read_members([folder / "pose1.off", other, folder / "pose2.off"])
    assert [member.name for member in members] == [f"{folder.name}-pose1.off", "more-pose1.off", "pose2"]
    with pytest.raises(ResultError, match="is there twice"):
        read_members([other, other])


def test_every_format_has_members_by_its_name_without_suffix(tmp_path: Path) -> None:
    folder = tmp_path / "shapes"
    folder.mkdir()
    off = shapes.write_off(folder / "a.off", *shapes.icosphere(0)).read_bytes()
    (folder / "b.OFF.gz").write_bytes(gzip.compress(off))
    for name in ("c.vtp", "lh.d.surf.gii", "notes.txt", "points.xyz", "lh.pial"):
        (folder / name).write_bytes(b"")
    assert [member.name for member in read_members(folder)] == ["a", "b", "c", "lh.d.surf"]
    (tmp_path / "list.txt").write_text("shapes/lh.pial\nshapes/b.OFF.gz\n")
    names = [member.name for member in read_members(tmp_path / "list.txt")]
    assert names == ["lh.pial", "b"]
    (tmp_path / "pairs.txt").write_text("b.OFF.gz lh.pial\n")
    assert listed_pairs(tmp_path / "pairs.txt", names) == [(1, 0)]


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are bytes on Linux only")
def test_a_list_may_name_files_whose_names_are_no_utf8(folder: Path) -> None:
    (folder / os.fsdecode(b"K\xf6rper.off")).write_bytes((folder / "pose1.off").read_bytes())
    (folder / "list.txt").write_bytes(b"K\xf6rper.off\npose1.off\n")
    members = read_members(folder / "list.txt")
    assert [os.fsencode(member.name) for member in members] == [b"K\xf6rper", b"pose1"]
    assert members[0].digest == members[1].digest != ""
    (folder / "list.txt").write_bytes(bytes(range(256)))
    with pytest.raises(ResultError, match=r"is neither a folder nor a list of meshes \(it is no text\)"):
        read_members(folder / "list.txt")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (".", "no mesh file in this folder"),
        ("absent", "neither a folder nor a list"),
        ("one.off", "is one mesh file"),
        ("one.txt", "needs two meshes or more, found 1"),
    ],
)
def test_what_is_no_collection_is_refused(tmp_path: Path, given: str, message: str) -> None:
    (tmp_path / "one.txt").write_text("one.off\n")
    with pytest.raises(ResultError, match=message):
        read_members(tmp_path / given)


def test_all_pairs_are_there_once_and_neighbours_share_shapes() -> None:
    pairs = all_pairs(17)
    assert sorted(pairs) == [(i, j) for i in range(17) for j in range(i + 1, 17)]
    for start in range(0, len(pairs) - BLOCK * BLOCK, BLOCK * BLOCK):
        assert len({shape for pair in pairs[start : start + BLOCK * BLOCK] for shape in pair}) <= 4 * BLOCK


def test_star_has_the_middle_and_tree_joins_neighbours() -> None:
    places = np.array([0.0, 1.0, 2.1, 3.3, 9.0])
    distances = np.abs(places[:, None] - places[None])
    assert sorted(star_pairs(distances)) == [(0, 2), (1, 2), (2, 3), (2, 4)]
    assert sorted(tree_pairs(distances)) == [(0, 1), (1, 2), (2, 3), (3, 4)]


def test_spectrum_distances_are_a_metric_of_logarithms(rng: np.random.Generator) -> None:
    values = np.sort(rng.uniform(1, 100, (4, 6)), axis=1)
    values[3] = 2 * values[0]
    distances = spectrum_distances(values)
    np.testing.assert_allclose(distances, distances.T)
    np.testing.assert_allclose(np.diag(distances), 0.0)
    assert distances[0, 3] == pytest.approx(np.log(2))


def test_listed_pairs(tmp_path: Path) -> None:
    listing = tmp_path / "pairs.txt"
    listing.write_text("b a\na.off c  # the other\na b\n")
    assert listed_pairs(listing, ["a", "b", "c"]) == [(1, 0), (0, 2)]
    listing.write_text("a d\n")
    with pytest.raises(ResultError, match="there is no mesh 'd'"):
        listed_pairs(listing, ["a", "b"])
    listing.write_text("a a\n")
    with pytest.raises(ResultError, match="paired with itself"):
        listed_pairs(listing, ["a", "b"])
