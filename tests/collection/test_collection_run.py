"""Collections in worker processes: results, resuming, lost workers, killed runs, a scheduler that is there already."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest
from collections_small import ARGUMENTS, OPTIONS, mean_error, write_shapes
from numpy.typing import NDArray

import clalign
from clalign.collection import run
from clalign.collection.cluster import Task
from clalign.collection.members import Member
from clalign.collection.result import Collection
from clalign.collection.run import match_collection
from clalign.collection.store import PairMaps, PairRow, Store
from clalign.collection.work import Settings
from clalign.errors import OptionError, ResultError

PROGRAM = [sys.executable, "-m", "clalign.cli.main", "collection"]
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
PAIRS = 6
LIMIT = 120.0

Numbers = dict[str, NDArray[np.int64]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("shapes")


@pytest.fixture(scope="module")
def numbers(folder: Path) -> Numbers:
    return write_shapes(folder)


@pytest.fixture(scope="module")
def whole(folder: Path, numbers: Numbers, tmp_path_factory: pytest.TempPathFactory) -> Collection:
    """All pairs of four shapes, and of a fifth that cannot be read, by one worker."""
    listing = folder / "list.txt"
    listing.write_text("".join(f"s{index}.off\n" for index in range(4)) + "broken.off\n")
    (folder / "broken.off").write_text("OFF\n3 1 0\n0 0 0\n")
    return match_collection(listing, tmp_path_factory.mktemp("out") / "whole", OPTIONS, workers=1, latent=20)


def times(collection: Collection) -> dict[tuple[str, str], int]:
    """Return when every pair's folder was written."""
    return {
        names: (collection.store.pair_folder("pairs", *names) / "pair.json").stat().st_mtime_ns
        for names in collection.store.pair_names("pairs")
    }


def same_maps(first: Collection, second: Collection) -> bool:
    return all(
        np.array_equal(first.maps(row.source, row.target).target_of_source, maps.target_of_source)
        and np.array_equal(first.maps(row.source, row.target).functional_map, maps.functional_map)
        for row in second.pairs
        if row.ok
        for maps in [second.maps(row.source, row.target)]
    )


def wait_for(condition: Callable[[], bool], process: subprocess.Popen[bytes] | None = None) -> None:
    limit = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < limit, "waited too long"
        assert process is None or process.poll() is None, "the process ended too early"
        time.sleep(0.02)


def started(folder: Path, out: Path, *extra: str) -> subprocess.Popen[bytes]:
    command = [*PROGRAM, str(folder), "--out", str(out), "--no-report", "--quiet", "--latent", "20", *ARGUMENTS, *extra]
    return subprocess.Popen(command, env=ENVIRONMENT)


def finished_pairs(out: Path) -> list[PairRow]:
    return [row for row in Store(out).pairs.read() if row.ok] if out.is_dir() else []


def test_every_pair_is_matched_and_recorded(whole: Collection, folder: Path, numbers: Numbers) -> None:
    rows = {(row.source, row.target): row for row in whole.pairs}
    assert len(rows) == 10
    good = [row for row in whole.pairs if row.ok]
    assert len(good) == PAIRS
    for row in good:
        error = mean_error(
            whole.maps(row.source, row.target).target_of_source, folder, (row.source, row.target), numbers
        )
        assert error < 0.1, row
        assert row.confidence is not None
        assert row.cycle_error is not None
        assert row.cycle_error < 0.5
        assert row.total is not None
    assert Collection.load(whole.folder).pairs == tuple(whole.store.pairs.read())


def test_a_mesh_that_fails_is_named_and_its_pairs_are_skipped(whole: Collection) -> None:
    skipped = [row for row in whole.pairs if row.status == "skipped"]
    assert {row.target for row in skipped} == {"broken"}
    assert all("broken.off" in row.message for row in skipped)
    assert [failure.partition(":")[0] for failure in whole.failures] == ["broken"]
    with pytest.raises(ResultError, match="s0 broken has no map"):
        whole.maps("s0", "broken")


def test_resume_does_only_what_is_missing(whole: Collection, folder: Path, numbers: Numbers) -> None:
    """A second run touches nothing; one pair taken away comes back the same, the rest stays as it was."""
    import shutil

    maps = whole.maps("s1", "s2")
    before = times(whole)
    shutil.rmtree(whole.store.pair_folder("pairs", "s1", "s2"))
    shapes = [folder / f"s{index}.off" for index in range(4)]
    with pytest.raises(ResultError, match="--resume"):
        match_collection(shapes, whole.folder, OPTIONS, latent=20)
    again = match_collection(shapes, whole.folder, OPTIONS, workers=1, resume=True, latent=20)
    after = times(again)
    assert {names for names in before if before[names] != after[names]} == {("s1", "s2")}
    np.testing.assert_array_equal(again.maps("s1", "s2").target_of_source, maps.target_of_source)
    with pytest.raises(OptionError, match=r"other values of spectrum.scale_invariant"):
        match_collection(shapes, whole.folder, OPTIONS.replace({"spectrum.scale_invariant": 41}), resume=True)


def test_star_gives_all_maps_and_a_wrong_one_is_repaired(
    folder: Path, numbers: Numbers, whole: Collection, tmp_path: Path
) -> None:
    """Star: pairs not matched come from the network. Then one map is spoilt, and the network puts it right."""
    shapes = [folder / f"s{index}.off" for index in range(4)]
    star = match_collection(shapes, tmp_path / "star", OPTIONS, pairs="star", workers=1, latent=20)
    kinds = sorted(row.kind for row in star.pairs)
    assert kinds == ["derived"] * 3 + ["direct"] * 3
    for row in star.pairs:
        names = row.source, row.target
        assert mean_error(star.maps(*names).target_of_source, folder, names, numbers) < 0.1
        assert mean_error(star.maps(*names[::-1]).target_of_source, folder, names[::-1], numbers) < 0.1
    around = star.functional_map("s2", "s0") @ star.functional_map("s1", "s2") @ star.functional_map("s0", "s1")
    np.testing.assert_allclose(around, np.eye(20), atol=1e-12)
    with pytest.raises(ResultError, match="no shape 's9'"):
        star.functional_map("s0", "s9")
    spoil(whole, "s0", "s3")
    repaired = match_collection(shapes, whole.folder, OPTIONS, workers=1, resume=True, latent=20)
    rows = {(row.source, row.target): row for row in repaired.pairs}
    assert [names for names, row in rows.items() if row.kind == "repaired"] == [("s0", "s3")]
    assert (rows["s0", "s3"].network_error or 0.0) > 0.5
    assert mean_error(repaired.maps("s0", "s3").target_of_source, folder, ("s0", "s3"), numbers) < 0.1


def test_a_derived_map_takes_the_place_of_a_match_that_failed_in_the_other_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def derived(_: object, tasks: list[Task]) -> Iterator[tuple[Task, PairRow]]:
        yield from ((task, PairRow(task.arguments[0].name, task.arguments[1].name)) for task in tasks)

    monkeypatch.setattr(run, "outcomes", derived)
    settings = Settings(str(tmp_path), OPTIONS, str(tmp_path / "cache"), 0, "maps", 20)
    job = run.Job([Member(name, f"{name}.off", "", 0) for name in "abc"], settings, lambda *_: None)
    nothing = np.zeros(0, dtype=np.int32)
    for pair in (("a", "c"), ("b", "c")):
        job.direct[pair] = PairRow(*pair)
        job.store.write_pair("pairs", job.direct[pair], "key", PairMaps(nothing, nothing, np.eye(5)))
    job.direct["b", "a"] = PairRow("b", "a", status="failed", message="lost")
    job.make_consistent(None, everything=True)
    rows = job.finished().pairs
    assert [(row.source, row.target, row.kind) for row in rows if row.ok] == [
        ("a", "b", "derived"),
        ("a", "c", "direct"),
        ("b", "c", "direct"),
    ]
    assert len(rows) == 3


def spoil(collection: Collection, source: str, target: str) -> None:
    """Replace the maps of a pair by a random permutation, under the same key."""
    import json
    from dataclasses import replace

    document = json.loads((collection.store.pair_folder("pairs", source, target) / "pair.json").read_text())
    maps = collection.store.read_maps("pairs", source, target)
    order = np.random.default_rng(5).permutation(len(maps.target_of_source)).astype(np.int32)
    functional = np.linalg.qr(np.random.default_rng(6).normal(size=maps.functional_map.shape))[0]
    wrong = replace(maps, target_of_source=order, source_of_target=np.argsort(order), functional_map=functional)
    row = replace(PairRow(**document["row"]), distortion=0.5)
    collection.store.write_pair("pairs", row, document["key"], wrong)


def test_killed_worker_costs_its_running_pair_only(folder: Path, numbers: Numbers, tmp_path: Path) -> None:
    out = tmp_path / "out"
    process = started(meshes(folder, tmp_path), out, "--workers", "2")
    wait_for(lambda: bool(finished_pairs(out)), process)
    before = {row.target: row for row in finished_pairs(out)}
    lost = int(next(iter(before.values())).worker.rpartition(":")[2])
    psutil.Process(lost).kill()
    assert process.wait(timeout=LIMIT) == 0
    done = Collection.load(out)
    assert sum(row.ok for row in done.pairs) == PAIRS
    assert len(Store(out).pairs.read()) == PAIRS
    workers = {row.worker for row in done.pairs}
    assert len(workers) > 1
    for row in done.pairs:
        assert (
            mean_error(done.maps(row.source, row.target).target_of_source, folder, (row.source, row.target), numbers)
            < 0.1
        )


def test_killed_run_goes_on_with_resume(folder: Path, numbers: Numbers, whole: Collection, tmp_path: Path) -> None:
    out, shapes = tmp_path / "out", meshes(folder, tmp_path)
    process = started(shapes, out, "--workers", "2")
    wait_for(lambda: len(finished_pairs(out)) >= 2, process)
    process.kill()
    process.wait(timeout=LIMIT)
    workers = {int(row.worker.rpartition(":")[2]) for row in finished_pairs(out)}
    wait_for(lambda: not any(map(psutil.pid_exists, workers)))
    before = times(Collection.load(out))
    assert 2 <= len(before) < PAIRS
    assert started(shapes, out, "--workers", "2").wait(timeout=LIMIT) == 2
    assert started(shapes, out, "--workers", "2", "--resume").wait(timeout=LIMIT) == 0
    done = Collection.load(out)
    after = times(done)
    assert len(after) == PAIRS
    assert all(after[names] == moment for names, moment in before.items())
    assert [path for path in (out / "pairs").rglob(".*")] == []


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[str]:
    """A scheduler and two workers, started by hand as on other machines."""
    address = tmp_path / "scheduler.json"
    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--scheduler-file", str(address)]
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", str(address)]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    processes = [
        subprocess.Popen([*dask, "--port", "0", "--no-dashboard", "--host", "127.0.0.1"], env=ENVIRONMENT, **quiet)
    ]
    try:
        wait_for(address.is_file, processes[0])
        for _ in range(2):
            command = [*worker, "--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(tmp_path)]
            processes.append(subprocess.Popen(command, env=ENVIRONMENT, **quiet))
        import json

        yield json.loads(address.read_text())["address"]
    finally:
        for process in reversed(processes):
            process.terminate()
        for process in processes:
            try:
                process.wait(timeout=20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def test_same_maps_from_workers_of_a_scheduler(folder: Path, whole: Collection, scheduler: str, tmp_path: Path) -> None:
    """Three shapes by two remote workers give what one local worker gave, bit by bit."""
    shapes = [folder / f"s{index}.off" for index in range(3)]
    far = match_collection(shapes, tmp_path / "far", OPTIONS, scheduler=scheduler, latent=20)
    assert sum(row.ok for row in far.pairs) == 3
    assert same_maps(whole, far)


def test_scheduler_that_is_not_there_is_an_error(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="no Dask scheduler"):
        match_collection(folder, tmp_path / "out", OPTIONS, scheduler="nonsense://x", latent=20)


def meshes(folder: Path, place: Path) -> Path:
    """Return a list file of the four good shapes."""
    listing = place / "good.txt"
    listing.write_text("".join(f"{folder / f's{index}.off'}\n" for index in range(4)))
    return listing


def test_front_door() -> None:
    assert clalign.match_collection is match_collection
