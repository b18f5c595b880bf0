"""Results check themselves, survive the disk, and are written wholly or not at all."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clalign.correspondence import Correspondence
from clalign.errors import ResultError
from clalign.storage.folders import atomic_folder

MARKER = "result.json"


def leftovers(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir() if path.name.startswith(".")]


def assert_same(one: Any, other: Any, where: str) -> None:
    """Compare nested dataclasses exactly, eigenfunctions to single precision."""
    if dataclasses.is_dataclass(one):
        for field in dataclasses.fields(one):
            assert_same(getattr(one, field.name), getattr(other, field.name), f"{where}.{field.name}")
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype, where
        if where.endswith(".functions"):
            np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6, err_msg=where)
        else:
            np.testing.assert_array_equal(one, other, err_msg=where)
    elif isinstance(one, tuple):
        assert len(one) == len(other), where
        for number, (left, right) in enumerate(zip(one, other, strict=True)):
            assert_same(left, right, f"{where}[{number}]")
    else:
        np.testing.assert_equal(one, other, err_msg=where)


def test_save_and_load_return_every_field(tmp_path: Path, true_correspondence: Correspondence) -> None:
    true_correspondence.save(tmp_path / "result")
    assert_same(true_correspondence, Correspondence.load(tmp_path / "result"), "result")
    assert leftovers(tmp_path) == []


def test_results_and_meshes_show_themselves_in_one_line(true_correspondence: Correspondence) -> None:
    name = f"{true_correspondence.source.name} -> {true_correspondence.target.name}"
    assert repr(true_correspondence) == (
        f"<Correspondence {name}: 642 -> 642 vertices, confidence 0.75, orientation +0.98>"
    )
    nothing = dataclasses.replace(true_correspondence, confidence=float("nan"), orientation=float("nan"))
    assert repr(nothing) == f"<Correspondence {name}: 642 -> 642 vertices>"
    assert repr(nothing.source) == f"<Mesh {nothing.source.name}: 642 vertices, 1,280 faces>"


def test_results_from_before_the_score_load(tmp_path: Path, true_correspondence: Correspondence) -> None:
    true_correspondence.save(tmp_path / "result")
    path = tmp_path / "result" / MARKER
    facts = json.loads(path.read_text(encoding="utf-8"))
    assert facts.pop("score") == true_correspondence.score
    path.write_text(json.dumps(facts), encoding="utf-8")
    assert np.isnan(Correspondence.load(tmp_path / "result").score)


def test_map_files_hold_the_other_files_vertex_in_line_i(tmp_path: Path, true_correspondence: Correspondence) -> None:
    true_correspondence.save(tmp_path / "result")
    forward = (tmp_path / "result" / "target_of_source.txt").read_text().splitlines()
    backward = (tmp_path / "result" / "source_of_target.txt").read_text().splitlines()
    assert [int(line) for line in forward] == true_correspondence.target_of_source.tolist()
    assert all(int(backward[int(target)]) == source for source, target in enumerate(forward))


def test_facts_are_strict_json_with_null_for_what_is_no_number(
    tmp_path: Path, true_correspondence: Correspondence
) -> None:
    true_correspondence.save(tmp_path / "result")

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is not JSON")

    facts = json.loads((tmp_path / "result" / MARKER).read_text(encoding="utf-8"), parse_constant=refuse)
    assert facts["losses"]["cycle"] is None
    assert facts["options"]["alignment"]["weight"] == 50.0
    assert facts["source"]["vertices"] == 642


def test_aligned_functions_agree_at_matched_points(true_correspondence: Correspondence) -> None:
    """With R from the truth, Φ̃R and Ψ̃ agree at matched points, and so do Φ̃ and Ψ̃Rᵀ (Eq. 20)."""
    truth = true_correspondence.target_of_source
    scale_invariant = true_correspondence.target_scale_invariant.functions[truth]
    error = np.linalg.norm(true_correspondence.source_aligned - scale_invariant) / np.linalg.norm(scale_invariant)
    assert error < 0.15
    back = true_correspondence.target_aligned[truth]
    sources = true_correspondence.source_scale_invariant.functions
    assert np.linalg.norm(back - sources) / np.linalg.norm(sources) < 0.15


def test_one_sided_match_leaves_the_target_functions(true_correspondence: Correspondence) -> None:
    options = true_correspondence.options.replace({"alignment.sides": "one"})
    one_sided = dataclasses.replace(true_correspondence, options=options)
    np.testing.assert_array_equal(one_sided.target_aligned, one_sided.target_scale_invariant.functions)
    np.testing.assert_array_equal(one_sided.source_aligned, true_correspondence.source_aligned)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"target_of_source": np.zeros(5, dtype=np.int64)}, "one entry for each of 642 vertices"),
        ({"source_of_target": np.full(642, 642, dtype=np.int64)}, "entry 0 is 642"),
        ({"target_of_source": np.full(642, -2, dtype=np.int64)}, "entry 0 is -2"),
        ({"target_of_source": np.zeros(642)}, "float64"),
        ({"distortion": np.zeros(3)}, "distortion"),
    ],
)
def test_parts_that_do_not_fit_are_refused(
    true_correspondence: Correspondence, change: dict[str, Any], message: str
) -> None:
    with pytest.raises(ResultError, match=message):
        dataclasses.replace(true_correspondence, **change)


def test_existing_result_needs_force(tmp_path: Path, true_correspondence: Correspondence) -> None:
    folder = tmp_path / "result"
    true_correspondence.save(folder)
    changed = dataclasses.replace(true_correspondence, confidence=0.1)
    with pytest.raises(ResultError, match=r"give --force \(in Python force=True\)"):
        changed.save(folder)
    assert Correspondence.load(folder).confidence == 0.75
    changed.save(folder, force=True)
    assert Correspondence.load(folder).confidence == 0.1
    assert leftovers(tmp_path) == []


def test_force_never_replaces_a_folder_of_other_things(tmp_path: Path, true_correspondence: Correspondence) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter1.tex").write_text("years of work")
    with pytest.raises(ResultError, match="not a result"):
        true_correspondence.save(tmp_path / "thesis", force=True)
    (tmp_path / "file").write_text("")
    with pytest.raises(ResultError, match="is not a folder"):
        true_correspondence.save(tmp_path / "file", force=True)
    assert (tmp_path / "thesis" / "chapter1.tex").read_text() == "years of work"


def test_empty_folder_is_filled(tmp_path: Path, true_correspondence: Correspondence) -> None:
    (tmp_path / "result").mkdir()
    true_correspondence.save(tmp_path / "result")
    assert Correspondence.load(tmp_path / "result").confidence == 0.75


@pytest.mark.parametrize("failure", [ValueError("no picture"), OSError(28, "No space left on device")])
def test_failing_extra_file_leaves_nothing(
    tmp_path: Path, true_correspondence: Correspondence, failure: Exception
) -> None:
    def fail(folder: Path) -> None:
        (folder / "half.png").write_bytes(b"half")
        raise failure

    expected = ResultError if isinstance(failure, OSError) else ValueError
    with pytest.raises(expected, match=r"No space left|no picture"):
        true_correspondence.save(tmp_path / "result", extra_files=fail)
    assert list(tmp_path.iterdir()) == []
    true_correspondence.save(tmp_path / "result")
    with pytest.raises(expected):
        dataclasses.replace(true_correspondence, confidence=0.1).save(tmp_path / "result", force=True, extra_files=fail)
    assert Correspondence.load(tmp_path / "result").confidence == 0.75
    assert leftovers(tmp_path) == []


@pytest.mark.parametrize("limit", [100, 20_000, 100_000])
def test_disk_that_takes_no_more_is_reported_and_leaves_nothing(
    tmp_path: Path, true_correspondence: Correspondence, limit: int
) -> None:
    """The operating system's limit on the size of a file stands in for a full disk: writes fail in the same place."""
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    try:
        with pytest.raises(ResultError, match=r"could not be written .*nothing was left"):
            true_correspondence.save(tmp_path / "result")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda folder: (folder / "result.npz").unlink(), "result.npz is missing"),
        (lambda folder: (folder / "result.json").unlink(), "is not a result folder"),
        (lambda folder: (folder / "result.json").write_text("{"), "cannot be read"),
        (lambda folder: (folder / "result.json").write_text('{"format": 99}'), "format 99"),
        (lambda folder: (folder / "result.json").write_text('{"format": 1}'), "'options' is missing"),
        (lambda folder: (folder / "result.npz").write_bytes(b"PK"), "cannot be read"),
        (lambda folder: os.truncate(folder / "result.npz", 20_000), "cannot be read"),
    ],
)
def test_damaged_results_are_refused(
    tmp_path: Path, true_correspondence: Correspondence, damage: Any, message: str
) -> None:
    folder = tmp_path / "result"
    true_correspondence.save(folder)
    damage(folder)
    with pytest.raises(ResultError, match=message):
        Correspondence.load(folder)


def test_every_flipped_byte_region_is_noticed_or_harmless(
    tmp_path: Path, true_correspondence: Correspondence, rng: np.random.Generator
) -> None:
    folder = tmp_path / "result"
    true_correspondence.save(folder)
    whole = (folder / "result.npz").read_bytes()
    for position in rng.integers(0, len(whole), size=25):
        broken = bytearray(whole)
        broken[position] ^= 0xFF
        (folder / "result.npz").write_bytes(bytes(broken))
        try:
            loaded = Correspondence.load(folder)
        except ResultError:
            continue
        np.testing.assert_array_equal(loaded.target_of_source, true_correspondence.target_of_source)


WRITER = textwrap.dedent(
    """
    import sys
    from pathlib import Path
    from clalign.storage.folders import atomic_folder

    number = 0
    print("ready", flush=True)
    while True:
        number += 1
        with atomic_folder(Path(sys.argv[1]), "result.json", force=True) as folder:
            for part in range(8):
                (folder / f"part{part}").write_text(str(number) * 20000)
            (folder / "result.json").write_text(str(number))
    """
)


def test_kill_at_any_moment_leaves_a_whole_folder(tmp_path: Path, rng: np.random.Generator) -> None:
    folder = tmp_path / "result"
    for delay in rng.uniform(0.0, 0.12, size=12):
        process = subprocess.Popen([sys.executable, "-c", WRITER, str(folder)], stdout=subprocess.PIPE)
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        time.sleep(delay)
        process.kill()
        process.wait()
        process.stdout.close()
        with atomic_folder(tmp_path / "result", MARKER, force=True) as unfinished:
            # An earlier result is in its place again, whole, before anything new is written.
            if folder.exists():
                number = (folder / MARKER).read_text()
                assert {(folder / f"part{part}").read_text() for part in range(8)} == {number * 20000}
            (unfinished / MARKER).write_text("0")
            for part in range(8):
                (unfinished / f"part{part}").write_text("0" * 20000)
        assert [path.name for path in tmp_path.iterdir()] == ["result"]


def test_kill_between_the_two_renames_is_mended_by_loading(tmp_path: Path, true_correspondence: Correspondence) -> None:
    folder = tmp_path / "result"
    true_correspondence.save(folder)
    folder.rename(tmp_path / ".result.clalign-old-0123456789ab")
    assert Correspondence.load(folder).confidence == 0.75
    assert leftovers(tmp_path) == []


def test_a_living_writer_keeps_its_unfinished_folder(tmp_path: Path) -> None:
    with atomic_folder(tmp_path / "result", MARKER) as first:
        (first / MARKER).write_text("first")
        with atomic_folder(tmp_path / "result", MARKER) as second:
            (second / MARKER).write_text("second")
        assert (first / MARKER).read_text() == "first"
        assert (tmp_path / "result" / MARKER).read_text() == "second"
    assert (tmp_path / "result" / MARKER).read_text() == "first"
    assert leftovers(tmp_path) == []
