"""The cache must never change a result: damage, competition and full disks included."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clalign.geometry import cache as cache_module
from clalign.geometry.cache import ShapeCache, content_key
from clalign.storage.files import cache_folder

A, B, C, D = (content_key("test", {}, {"name": name}) for name in "abcd")


def arrays(seed: int = 0, size: int = 1000) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    return {
        "doubles": rng.normal(size=(size, 3)),
        "singles": rng.normal(size=size).astype(np.float32),
        "numbers": rng.integers(0, 9, size),
    }


def assert_same(found: dict[str, Any] | None, expected: dict[str, Any]) -> None:
    assert found is not None
    assert found.keys() == expected.keys()
    for name, array in expected.items():
        assert found[name].dtype == array.dtype
        np.testing.assert_array_equal(found[name], array)


def test_what_is_put_comes_back(tmp_path: Path) -> None:
    cache = ShapeCache(tmp_path / "not" / "there" / "yet")
    assert cache.get(A) is None
    assert cache.info().entries == 0
    assert cache.put(A, arrays())
    assert_same(ShapeCache(cache.folder).get(A), arrays())
    assert os.listdir(cache.folder) == [f"{A}.npz"]


@pytest.mark.parametrize("keep", [0, 1, 100, 0.5, 0.999])
def test_truncated_entry_is_dropped_with_a_warning(
    tmp_path: Path, keep: float, caplog: pytest.LogCaptureFixture
) -> None:
    cache = ShapeCache(tmp_path)
    cache.put(A, arrays())
    path = tmp_path / f"{A}.npz"
    content = path.read_bytes()
    path.write_bytes(content[: int(keep * len(content)) if keep < 1 else int(keep)])
    assert cache.get(A) is None
    assert str(path) in caplog.text
    assert not path.exists()
    assert cache.put(A, arrays())
    assert_same(cache.get(A), arrays())


def test_every_flipped_byte_is_noticed_or_harmless(tmp_path: Path) -> None:
    """Sampled over the whole file: a read gives the right arrays or nothing."""
    cache = ShapeCache(tmp_path)
    expected = arrays(size=20)
    cache.put(A, expected)
    path = tmp_path / f"{A}.npz"
    content = path.read_bytes()
    noticed = 0
    for position in range(0, len(content), 7):
        damaged = bytearray(content)
        damaged[position] ^= 0xFF
        path.write_bytes(bytes(damaged))
        found = cache.get(A)
        noticed += found is None
        if found is not None:
            assert_same(found, expected)
    assert noticed > len(content) // 14


def test_pickled_objects_are_not_loaded(tmp_path: Path) -> None:
    np.savez(tmp_path / f"{A}.npz", thing=np.array([{"not": "an array"}], dtype=object))
    assert ShapeCache(tmp_path).get(A) is None


def test_entries_used_longest_ago_go_first(tmp_path: Path) -> None:
    one = sum(array.nbytes for array in arrays().values())
    cache = ShapeCache(tmp_path, limit_bytes=int(3.5 * one))
    for age, key in enumerate((A, B, C)):
        cache.put(key, arrays())
        os.utime(tmp_path / f"{key}.npz", (1000 + age, 1000 + age))
    assert cache.get(A) is not None
    cache.put(D, arrays())
    assert [cache.get(key) is not None for key in (A, B, C, D)] == [True, False, True, True]
    assert cache.info().size <= cache.limit_bytes


@pytest.mark.parametrize("number", [errno.EPERM, errno.EROFS, errno.ENOENT])
def test_entry_whose_time_cannot_be_set_is_still_a_hit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, number: int
) -> None:
    """A file of another user, a read-only file system, and an entry that is evicted just after it was read."""
    cache = ShapeCache(tmp_path)
    cache.put(A, arrays())

    def refused(path: Any) -> None:
        if number == errno.ENOENT:
            os.unlink(path)
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "utime", refused)
    assert_same(cache.get(A), arrays())
    assert (tmp_path / f"{A}.npz").exists() == (number != errno.ENOENT)
    assert not caplog.records


def test_files_that_cannot_be_removed_do_not_make_an_entry_unwritable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The entry used longest ago belongs to somebody else; the one after it goes in its place."""
    one = sum(array.nbytes for array in arrays().values())
    cache = ShapeCache(tmp_path, limit_bytes=int(2.5 * one))
    leftover = tmp_path / f"{D}left.part"
    leftover.write_text("unfinished")
    foreign = {tmp_path / f"{A}.npz", leftover}
    for age, key in enumerate((A, B)):
        cache.put(key, arrays())
        os.utime(tmp_path / f"{key}.npz", (1000 + age, 1000 + age))
    os.utime(leftover, (1000, 1000))
    unlink = Path.unlink

    def refused(path: Path, missing_ok: bool = False) -> None:
        if path in foreign:
            raise PermissionError(errno.EPERM, "Operation not permitted")
        unlink(path, missing_ok=missing_ok)

    monkeypatch.setattr(Path, "unlink", refused)
    assert cache.put(C, arrays())
    assert not caplog.records
    assert [cache.get(key) is not None for key in (A, B, C)] == [True, False, True]
    assert leftover.exists()


def test_entry_above_the_limit_is_not_stored(tmp_path: Path) -> None:
    cache = ShapeCache(tmp_path, limit_bytes=1000)
    assert not cache.put(A, arrays())
    assert cache.info().entries == 0


def test_clear_and_info(tmp_path: Path) -> None:
    cache = ShapeCache(tmp_path)
    cache.put(A, arrays(1))
    cache.put(B, arrays(2))
    (tmp_path / "of somebody else.txt").write_text("keep")
    info = cache.info()
    assert (info.entries, info.folder, info.limit) == (2, tmp_path, cache.limit_bytes)
    assert info.size == sum(path.stat().st_size for path in tmp_path.glob("*.npz"))
    assert cache.clear() == 2
    assert os.listdir(tmp_path) == ["of somebody else.txt"]


def test_full_disk_costs_the_entry_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    cache = ShapeCache(tmp_path)
    cache.put(A, arrays(1))

    def full(stream: Any, **_: Any) -> None:
        stream.write(b"the beginning of an entry")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    assert not cache.put(A, arrays(2))
    assert "No space left" in caplog.text
    assert os.listdir(tmp_path) == [f"{A}.npz"]
    assert_same(cache.get(A), arrays(1))


def test_folder_that_cannot_be_made(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "file").write_text("in the way")
    cache = ShapeCache(tmp_path / "file" / "cache")
    assert not cache.put(A, arrays())
    assert cache.get(A) is None
    assert "going on without it" in caplog.text
    assert cache.clear() == 0


def test_files_of_killed_processes_are_removed_when_old(tmp_path: Path) -> None:
    cache = ShapeCache(tmp_path)
    old, young = tmp_path / f"{B}old.part", tmp_path / f"{B}young.part"
    for path in (old, young):
        path.write_text("unfinished")
    past = time.time() - 2 * cache_module.ABANDONED_AFTER
    os.utime(old, (past, past))
    cache.put(A, arrays())
    assert not old.exists()
    assert young.exists()


RACER = """
import sys
import numpy as np
from clalign.geometry.cache import ShapeCache, content_key
cache = ShapeCache(sys.argv[1], limit_bytes=400_000)
def whole(number, found):
    return found is not None and found["values"].shape == (20_000,) and bool((found["values"] == number).all())
keys = [content_key("test", {}, {"number": number}) for number in range(3)]
print(whole(0, cache.get(keys[0])), flush=True)
sys.stdin.readline()
for turn in range(50):
    for number, key in enumerate(keys):
        # Before and after, since three entries do not fit and the other process evicts, too.
        for found in (cache.get(key), cache.put(key, {"values": np.full(20_000, float(number))}) and cache.get(key)):
            assert not found or whole(number, found)
    if turn % 20 == 19:
        cache.clear()
"""


def test_two_processes_share_a_folder(tmp_path: Path) -> None:
    """Both write, read, evict and clear the same entries; what is read is always whole."""
    cache = ShapeCache(tmp_path, limit_bytes=400_000)
    keys = [content_key("test", {}, {"number": number}) for number in range(3)]
    assert cache.put(keys[0], {"values": np.zeros(20_000)})
    command = [sys.executable, "-W", "error", "-c", RACER, str(tmp_path)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    racers = [subprocess.Popen(command, text=True, **pipes) for _ in range(2)]
    # Both have read the entry from here before either begins to evict it.
    started = [racer.stdout.readline() for racer in racers if racer.stdout is not None]
    ended = [(racer.communicate("go\n", timeout=60), racer.returncode) for racer in racers]
    for (_, complaints), status in ended:
        assert status == 0, complaints
        assert complaints == ""
    assert started == ["True\n", "True\n"]
    assert not list(tmp_path.glob("*.part"))
    assert cache.put(keys[1], {"values": np.ones(20_000)})
    assert_same(cache.get(keys[1]), {"values": np.ones(20_000)})


def test_keys_depend_on_everything_and_on_nothing_else() -> None:
    vertices, faces = np.zeros((4, 3)), np.zeros((4, 3), dtype=np.int32)
    base = content_key("basis", {"vertices": vertices, "faces": faces}, {"count": 10, "xi": 0.3})
    assert base == content_key("basis", {"faces": faces, "vertices": vertices.copy()}, {"xi": 0.3, "count": 10})
    nudged = vertices.copy()
    nudged[2, 1] = 1e-300
    others = {
        content_key("basis", {"vertices": nudged, "faces": faces}, {"count": 10, "xi": 0.3}),
        content_key("basis", {"vertices": vertices.reshape(3, 4), "faces": faces}, {"count": 10, "xi": 0.3}),
        content_key("basis", {"vertices": vertices, "faces": faces.astype(np.int64)}, {"count": 10, "xi": 0.3}),
        content_key("basis", {"vertices": vertices, "faces": faces}, {"count": 11, "xi": 0.3}),
        content_key("geodesics", {"vertices": vertices, "faces": faces}, {"count": 10, "xi": 0.3}),
    }
    assert len(others | {base}) == 6
    assert base.startswith("basis-")


def test_key_changes_with_the_format(monkeypatch: pytest.MonkeyPatch) -> None:
    before = content_key("basis", {}, {})
    monkeypatch.setattr(cache_module, "FORMAT", cache_module.FORMAT + 1)
    assert content_key("basis", {}, {}) != before


def test_folder_from_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("CLALIGN_CACHE", str(tmp_path))
    assert ShapeCache().folder == tmp_path
    monkeypatch.delenv("CLALIGN_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert "clalign" in cache_folder().name
