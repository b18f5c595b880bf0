"""The folder of a collection: index, pair folders, locks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from collections_small import OPTIONS, write_shapes

from clalign.collection.forecast import check_disk, needs, shape_bytes, workers_that_fit
from clalign.collection.members import Member, read_members
from clalign.collection.store import PairMaps, PairRow, ShapeRow, Store, pair_key
from clalign.errors import MemoryBudgetError, OptionError, ResultError
from clalign.options import Options

ROW = PairRow("a", "b", confidence=0.5, seconds=1.25, warnings='two\nlines, a comma and a "quote"', device="d")


def maps(rng: np.random.Generator) -> PairMaps:
    return PairMaps(*(rng.integers(-1, 9, size).astype(np.int32) for size in (10, 12)), rng.normal(size=(4, 4)))


def test_rows_survive_the_file(tmp_path: Path) -> None:
    other = PairRow("a", "c", status="failed", message="why")
    index = Store(tmp_path).pairs
    index.append(ROW)
    index.append(other)
    assert index.read() == [replace(ROW, warnings='two lines, a comma and a "quote"'), other]
    shape = ShapeRow("a", "/a.off", vertices=12, seconds=0.5, eigenvalues=(1.0, 2.0))
    Store(tmp_path).shapes.write([shape])
    assert Store(tmp_path).shapes.read() == [replace(shape, eigenvalues=())]


def test_pair_is_finished_only_under_its_key(tmp_path: Path, rng: np.random.Generator) -> None:
    store, stored = Store(tmp_path), maps(rng)
    row = replace(ROW, warnings="")
    store.write_pair("pairs", row, "key", stored)
    assert store.finished("pairs", "a", "b", "key") == row
    assert store.finished("pairs", "a", "b", "other key") is None
    assert store.finished("consistent", "a", "b", "key") is None
    assert list(store.pair_names("pairs")) == [("a", "b")]
    found = store.read_maps("pairs", "a", "b")
    np.testing.assert_array_equal(found.functional_map, stored.functional_map)
    np.testing.assert_array_equal(found.reversed().target_of_source, stored.source_of_target)
    (tmp_path / "pairs" / "a" / "b" / "pair.json").write_text('{"key": "key", "ro')
    assert store.finished("pairs", "a", "b", "key") is None


def test_failure_inside_leaves_no_pair(tmp_path: Path, rng: np.random.Generator) -> None:
    def full(folder: Path) -> None:
        raise OSError(28, "No space left on device")

    with pytest.raises(ResultError, match="No space left"):
        Store(tmp_path).write_pair("pairs", ROW, "key", maps(rng), full)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_key_tells_everything_apart_that_maps_depend_on() -> None:
    a, b = Member("a", "/a", "1", 1), Member("b", "/b", "2", 1)
    keys = {
        pair_key(a, b, OPTIONS),
        pair_key(b, a, OPTIONS),
        pair_key(a, replace(b, digest="3"), OPTIONS),
        pair_key(a, b, OPTIONS.replace({"seed": 1})),
        pair_key(a, b, OPTIONS, "network"),
    }
    assert len(keys) == 5
    assert pair_key(a, replace(b, path="/elsewhere/b"), OPTIONS) == pair_key(a, b, OPTIONS)


def test_folder_is_gone_on_with_only_when_asked_and_with_the_same_options(tmp_path: Path) -> None:
    store = Store(tmp_path / "out")
    store.begin(OPTIONS, {"pairs": "all"}, resume=True)
    with pytest.raises(ResultError, match="already holds a collection; give --resume"):
        store.begin(OPTIONS, {}, resume=False)
    with pytest.raises(OptionError, match=r"other values of spectrum.basis, seed"):
        store.begin(OPTIONS.replace({"spectrum.basis": 31, "seed": 2}), {}, resume=True)
    store.begin(OPTIONS, {"pairs": "star"}, resume=True)
    assert store.settings()["pairs"] == "star"
    (tmp_path / "file.txt").write_text("mine")
    with pytest.raises(ResultError, match="holds files that are not a collection"):
        Store(tmp_path).begin(OPTIONS, {}, resume=True)


def test_two_runs_do_not_share_a_folder(tmp_path: Path) -> None:
    with Store(tmp_path).lock(), pytest.raises(ResultError, match="another run works"), Store(tmp_path).lock():
        pass
    with Store(tmp_path).lock():
        pass


def test_forecast_grows_with_what_is_kept_and_bounds_the_prepared_shapes(tmp_path: Path) -> None:
    from clalign.geometry.cache import ShapeCache
    from clalign.geometry.shape import prepare
    from clalign.mesh.mesh import load_mesh

    write_shapes(tmp_path / "shapes", 3)
    members = read_members(tmp_path / "shapes")
    little = needs(members, 3, OPTIONS, keep="maps", latent=20, pages=False)
    much = needs(members, 3, OPTIONS, keep="full", latent=20, pages=True)
    assert little.pairs < much.pairs
    assert little.cache == much.cache
    cache = ShapeCache(tmp_path / "cache")
    for member in members:
        prepare(load_mesh(member.path), OPTIONS, cache)
    assert 0.6 * little.cache < cache.info().size < 1.2 * little.cache
    assert shape_bytes(5000, Options()) > 20 * shape_bytes(162, OPTIONS)


def test_too_little_disk_or_memory_is_said_before_the_work(tmp_path: Path) -> None:
    with pytest.raises(ResultError, match=r"needs up to 931322\.6 GiB"):
        check_disk(1e15, tmp_path)
    with pytest.raises(MemoryBudgetError, match="use fewer --workers"):
        workers_that_fit(1e15, 2, 4)
    assert workers_that_fit(1.0, None, 4) == 4
    assert workers_that_fit(1.0, 7, 4) == 7
