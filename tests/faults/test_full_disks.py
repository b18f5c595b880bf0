"""Disks that are full, caches that are damaged or shared, processes that are killed while they write."""

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
from quick import QUICK, Run, left_in

from clalign.correspondence import Correspondence


def maps_in(folder: Path) -> tuple[str, str]:
    return (folder / "target_of_source.txt").read_text(), (folder / "source_of_target.txt").read_text()


def fill(folder: Path) -> None:
    """Take the space that a disk has left."""
    with pytest.raises(OSError, match="No space left"):
        (folder / "filler").write_bytes(bytes(200_000))


def test_full_disk_leaves_nothing_and_keeps_the_earlier_result(match: Run, small_disk: Path, tmp_path: Path) -> None:
    out = small_disk / "out"
    shown = match(out)
    assert shown.status == 1
    assert shown.err.endswith("could not be written (No space left on device); nothing was left half-written\n")
    assert left_in(small_disk) == []
    # A result that does fit, made elsewhere, must survive a failed replacement.
    out.mkdir()
    (out / "result.json").write_text("{}")
    assert match(out, "--force").status == 1
    assert left_in(small_disk) == ["out", "out/result.json"]
    assert match(tmp_path / "elsewhere").status == 0


def test_full_disk_costs_the_cache_not_the_result(
    match: Run, small_disk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fill(small_disk)
    monkeypatch.setenv("CLALIGN_CACHE", str(small_disk / "cache"))
    assert match(tmp_path / "out").status == 0
    assert not [name for name in left_in(small_disk) if name.endswith((".npz", ".part"))]
    monkeypatch.setenv("CLALIGN_CACHE", str(tmp_path / "cache"))
    assert match(tmp_path / "again").status == 0
    assert maps_in(tmp_path / "again") == maps_in(tmp_path / "out")


def test_full_disk_leaves_no_half_of_a_repaired_mesh(run: Run, small_disk: Path, pair: tuple[Path, Path]) -> None:
    fill(small_disk)
    shown = run("check", pair[0], "--repair", small_disk / "clean.ply")
    assert shown.status == 1
    assert "No space left on device" in shown.err
    assert left_in(small_disk) == ["filler"]


def test_a_write_that_fails_anywhere_leaves_nothing(
    match: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a disk of its own: each kind of write refuses in turn."""

    def full(*_: Any, **__: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    for place in ("clalign.correspondence.write_map", "numpy.savez", "os.fsync", "os.rename"):
        with monkeypatch.context() as patched:
            patched.setattr(place, full)
            shown = match(tmp_path / "out", "--no-cache")
        assert shown.status == 1, place
        assert "No space left on device" in shown.err
        assert left_in(tmp_path) == []


@pytest.mark.parametrize("damage", ["empty", "cut", "flipped", "text", "folder"])
def test_damaged_cache_entries_are_computed_again(
    match: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, damage: str
) -> None:
    cache = tmp_path / "cache"
    monkeypatch.setenv("CLALIGN_CACHE", str(cache))
    assert match(tmp_path / "first").status == 0
    entries = sorted(cache.glob("*.npz"))
    assert len(entries) == 6
    for entry in entries:
        content = entry.read_bytes()
        entry.unlink()
        if damage == "folder":
            entry.mkdir()
        elif damage == "flipped":
            middle = len(content) // 2
            entry.write_bytes(content[:middle] + bytes([content[middle] ^ 0xFF]) + content[middle + 1 :])
        else:
            entry.write_bytes({"empty": b"", "cut": content[: len(content) // 2], "text": b"not an archive"}[damage])
    shown = match(tmp_path / "second")
    assert shown.status == 0
    assert "Traceback" not in shown.err
    assert caplog.text.count("cannot be read") >= len(entries)
    assert maps_in(tmp_path / "second") == maps_in(tmp_path / "first")
    if damage != "folder":
        caplog.clear()
        assert match(tmp_path / "third").status == 0
        assert "cannot be read" not in caplog.text
        for entry in entries:
            with np.load(entry) as stored:
                assert stored.files


def test_two_processes_share_one_cache(pair: tuple[Path, Path], tmp_path: Path) -> None:
    """Both start on an empty cache at the same time; both are right, and a third finds everything there."""
    environment = {**os.environ, "CLALIGN_CACHE": str(tmp_path / "cache"), "OMP_NUM_THREADS": "1"}

    def start(name: str) -> subprocess.Popen[str]:
        command = ["match", *map(str, pair), "--out", str(tmp_path / name), "--device", "reference", *QUICK]
        return subprocess.Popen(
            [sys.executable, "-m", "clalign.cli.main", *command], stderr=subprocess.PIPE, text=True, env=environment
        )

    for process in (start("one"), start("two")):
        _, errors = process.communicate(timeout=120)
        assert process.returncode == 0, errors
        assert "cache" not in errors
    assert maps_in(tmp_path / "one") == maps_in(tmp_path / "two")
    before = {path.name: path.stat().st_ino for path in (tmp_path / "cache").iterdir()}
    assert len(before) == 6
    _, errors = start("three").communicate(timeout=120)
    assert errors.count("\n") == 1
    assert {path.name: path.stat().st_ino for path in (tmp_path / "cache").iterdir()} == before


REPAIRING = """
import sys
from pathlib import Path
from clalign.cli.check import repair_file
for number in range(10**9):
    repair_file(Path(sys.argv[1 + number % 2]), Path(sys.argv[3]), merge=False, force=True)
    print(number, flush=True)
"""


def test_kill_at_any_moment_leaves_a_mesh_with_its_own_index(tmp_path: Path, rng: np.random.Generator) -> None:
    """Two meshes of different sizes are repaired to one name in turn; an index beside the mesh must be its own."""
    import malformed

    from clalign.mesh.mesh import load_mesh

    cases = {case.name: case for case in malformed.write_collection(tmp_path)}
    first, second = cases["Möbius strip"].path, cases["two bodies"].path
    folder = tmp_path / "repaired"
    out = folder / "clean.ply"
    for delay in rng.uniform(0.0, 0.05, size=5):
        process = subprocess.Popen(
            [sys.executable, "-c", REPAIRING, str(first), str(second), str(out)], stdout=subprocess.PIPE
        )
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(delay)
        process.kill()
        process.wait(timeout=60)
        process.stdout.close()
        mesh = load_mesh(out)
        index = out.with_name("clean.ply.index.txt")
        if index.exists():
            assert len(np.loadtxt(index)) == mesh.file_count
        assert mesh.file_count in (82, 162)
        assert len([name for name in left_in(folder) if name.startswith(".") and "/" not in name]) <= 1


def test_a_result_is_whole_after_the_writer_was_killed(match: Run, tmp_path: Path) -> None:
    """What a killed writer leaves beside the result is gone after the next match to the same place."""
    (tmp_path / ".out.clalign-new-0123456789ab").mkdir()
    (tmp_path / ".out.clalign-new-0123456789ab" / "result.npz").write_bytes(b"half")
    assert match(tmp_path / "out").status == 0
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert Correspondence.load(tmp_path / "out").source.n_vertices == 162
