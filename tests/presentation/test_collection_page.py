"""The page of a collection, made from maps that are known to be right."""

from __future__ import annotations

import re
import struct
from dataclasses import replace
from html.parser import HTMLParser
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from collections_small import OPTIONS, write_shapes
from numpy.typing import NDArray

from clalign.collection.result import Collection
from clalign.collection.store import PairMaps, PairRow, ShapeRow, Store
from clalign.mesh.front import front_view
from clalign.presentation.collection_page import page as collection_page
from clalign.presentation.collection_page import write_collection_page
from clalign.presentation.collection_page.page import MEASURES
from clalign.presentation.collection_page.pictures import shape_pictures
from clalign.transfer.colours import position_colours


class Page(HTMLParser):
    """What a page holds: links, images, text, and whether every element was closed."""

    VOID = frozenset({"meta", "link", "img", "input", "br"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.links: list[str] = []
        self.images: list[str] = []
        self.classes: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        if tag not in self.VOID:
            self.open.append(tag)
        if tag == "a":
            self.links.append(values["href"] or "")
        if tag == "img":
            self.images.append(values["src"] or "")
        self.classes.append(values.get("class") or "")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def collection(tmp_path_factory: pytest.TempPathFactory) -> Collection:
    """Four shapes with true maps, pair s2 s3 repaired, and a fifth shape that failed with a name full of signs."""
    root = tmp_path_factory.mktemp("collection")
    numbers = write_shapes(root / "shapes")
    store = Store(root / "out")
    store.begin(OPTIONS, {}, resume=False)
    rows = []
    for names in combinations(sorted(numbers), 2):
        forward = numbers[names[1]][np.argsort(numbers[names[0]])].astype(np.int32)
        maps = PairMaps(forward, np.argsort(forward).astype(np.int32), np.eye(4))
        row = PairRow(*names, confidence=0.8, cycle_error=0.1, network_error=0.05, distortion=0.01, seconds=2.0)
        if names == ("s2", "s3"):
            row = replace(row, kind="repaired")
        store.write_pair("consistent" if row.kind == "repaired" else "pairs", row, "key", maps, page)
        rows.append(row)
    bad = '<b> & "q"'
    rows += [PairRow(name, bad, status="skipped", message="no mesh") for name in sorted(numbers)]
    shapes = [ShapeRow(name, str(root / "shapes" / f"{name}.off"), vertices=162) for name in sorted(numbers)]
    shapes.append(ShapeRow(bad, "/nowhere", "failed", "is no <mesh>"))
    return Collection(store, tuple(shapes), tuple(rows))


def page(folder: Path) -> None:
    (folder / "report.html").write_text("a page")


def test_page_links_to_every_pair_and_shows_every_shape(collection: Collection) -> None:
    path = collection.folder / "index.html"
    write_collection_page(collection, path)
    text = path.read_text(encoding="utf-8")
    shown = Page(text)
    assert shown.open == []
    cells = shown.links[: 2 * 6]
    assert len(set(cells)) == 6
    assert all((collection.folder / link).is_file() for link in shown.links)
    assert "consistent/s2/s3/report.html" in shown.links
    assert sorted(shown.images) == [f"pictures/s{index}.png" for index in range(4)]
    for image in shown.images:
        width, height = struct.unpack(">II", (collection.folder / image).read_bytes()[16:24])
        assert height == 300
        assert width > 100
    assert shown.classes.count("failed") == 8
    assert shown.classes.count("repaired") == 2
    assert "<b> &" not in text
    assert "&lt;b&gt; &amp; " in text
    assert not re.search(r'(?:src|href)="https?:', text)


def test_page_without_pictures(collection: Collection) -> None:
    path = collection.folder / "plain.html"
    write_collection_page(collection, path, pictures=False)
    assert Page(path.read_text(encoding="utf-8")).images == []


def test_colours_are_carried_by_the_maps(collection: Collection, monkeypatch: pytest.MonkeyPatch) -> None:
    """Vertices that are the same point get the same colour, also over two maps; a shape without maps is grey."""
    from clalign.presentation.collection_page import pictures

    painted: list[NDArray[np.float64]] = []

    def record(shapes: list[tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]], height: int) -> object:
        painted.append(shapes[0][2])
        return np.zeros((1, 1, 3), dtype=np.uint8)

    monkeypatch.setattr(pictures, "draw_row", record)
    chain = [row for row in collection.pairs if (row.source, row.target) in (("s0", "s1"), ("s1", "s2"))]
    part = replace(collection, pairs=tuple(chain))
    drawn = list(shape_pictures(part))
    assert [name for name, _, _ in drawn] == ["s1", "s0", "s2", "s3"]
    assert [way for _, _, way in drawn] == [(), ("s1",), ("s1",), ()]
    maps = collection.maps("s0", "s2")
    np.testing.assert_allclose(painted[1], painted[2][maps.target_of_source])
    assert np.ptp(painted[3]) == 0.0
    from clalign.mesh.mesh import load_mesh

    reference = load_mesh(collection.shapes[1].path).vertices
    np.testing.assert_allclose(painted[0], position_colours(reference, front_view(reference)))


def test_large_collections_get_a_picture_of_the_matrix(collection: Collection, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(collection_page, "MOST_CELLS", 3)
    path = collection.folder / "large.html"
    write_collection_page(collection, path, pictures=False)
    shown = Page(path.read_text(encoding="utf-8"))
    assert len(shown.images) == len(MEASURES)
    assert all(image.startswith("data:image/png;base64,") for image in shown.images)
