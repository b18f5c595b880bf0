"""A collection of shapes whose names are no UTF-8, from the files through the workers to the page."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from collections_small import OPTIONS, write_shapes

from clalign.collection.result import Collection
from clalign.collection.run import match_collection
from clalign.presentation.collection_page import write_collection_page

LATIN = os.fsdecode(b"K\xf6rper")


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are bytes on Linux only")
def test_a_collection_keeps_the_names(tmp_path: Path) -> None:
    write_shapes(tmp_path)
    (tmp_path / "s1.off").rename(tmp_path / f"{LATIN}.off")
    (tmp_path / "list.txt").write_bytes(b"s0.off\nK\xf6rper.off\n")
    out = tmp_path / "out"
    match_collection(tmp_path / "list.txt", out, OPTIONS, workers=1, latent=20)
    collection = Collection.load(out)
    assert [row.name for row in collection.shapes] == ["s0", LATIN]
    assert [row.status for row in collection.shapes] == ["ok", "ok"]
    assert len(collection.maps("s0", LATIN).target_of_source) > 100
    write_collection_page(collection, out / "index.html")
    page = (out / "index.html").read_bytes().decode()
    assert r"K\udcf6rper" in page
    assert 'src="pictures/K%F6rper.png"' in page
    assert (out / "pictures" / f"{LATIN}.png").is_file()
