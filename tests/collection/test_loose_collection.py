"""A collection of files with seams, pinched vertices and loose pieces: direct and derived maps have all of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from assembled import assembled, truth
from collections_small import OPTIONS
from malformed import WRITERS

from clalign.collection.result import Collection
from clalign.collection.run import match_collection
from clalign.presentation.collection_page import write_collection_page


def test_every_map_carries_what_hangs_loose(tmp_path: Path) -> None:
    files = {"a": assembled(), "b": assembled(0.3, seed=4), "c": assembled(-0.3, seed=5)}
    for name, file in files.items():
        (tmp_path / f"{name}.off").write_bytes(WRITERS["off"]((file.vertices, file.faces)))
    out = tmp_path / "out"
    match_collection(tmp_path, out, OPTIONS, pairs="star", workers=1, latent=20)
    collection = Collection.load(out)
    assert collection.failures == ()
    kinds = {(row.source, row.target): row.kind for row in collection.pairs}
    assert sorted(kinds.values()) == ["derived", "direct", "direct"]
    for source, target in kinds:
        here, there = files[source], files[target]
        found = collection.maps(source, target).target_of_source
        assert len(found) == len(here.vertices)
        np.testing.assert_array_equal(np.flatnonzero(found < 0), np.sort(here.left_out))
        np.testing.assert_array_equal(*found[here.seam].T)
        assert np.isin(found[here.loose], there.loose).all()
        away = np.linalg.norm(there.vertices[found] - there.vertices[truth(here, there)], axis=1)
        assert away[here.carried].mean() < 0.1
    write_collection_page(collection, out / "index.html")
    assert (out / "pictures" / "c.png").is_file()
