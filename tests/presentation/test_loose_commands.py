"""``clalign transfer``, ``export`` and ``evaluate`` on a saved match of files with seams and loose pieces."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from assembled import assembled, matched, truth
from malformed import WRITERS

from clalign.cli.main import main
from clalign.mesh.reading import read_mesh_file

SOURCE, TARGET = assembled(), assembled(0.3, seed=4)


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("saved") / "result"
    matched(SOURCE, TARGET).save(folder)
    return folder


def test_labels_scalars_and_colours_reach_every_vertex(result: Path, tmp_path: Path) -> None:
    np.savetxt(tmp_path / "labels.txt", np.arange(len(SOURCE.vertices)), fmt="%d")
    np.savetxt(tmp_path / "colours.txt", np.linspace(0, 1, 3 * len(SOURCE.vertices)).reshape(-1, 3))
    for kind, given, out in (
        ("labels", "labels.txt", "labels-there.txt"),
        ("scalars", "labels.txt", "scalars.npy"),
        ("colours", "colours.txt", "colours.ply"),
    ):
        assert main(["transfer", str(result), kind, str(tmp_path / given), "--out", str(tmp_path / out)]) == 0
    labels = np.loadtxt(tmp_path / "labels-there.txt", dtype=int)
    np.testing.assert_array_equal(np.flatnonzero(labels < 0), np.sort(TARGET.left_out))
    np.testing.assert_array_equal(labels[TARGET.loose], truth(TARGET, SOURCE)[TARGET.loose])
    scalars = np.load(tmp_path / "scalars.npy")
    np.testing.assert_array_equal(np.where(np.isnan(scalars), -1, scalars), labels)
    written = read_mesh_file(tmp_path / "colours.ply")
    np.testing.assert_allclose(written.vertices[TARGET.carried], TARGET.vertices[TARGET.carried], atol=1e-6)


def test_a_deformed_mesh_has_its_loose_pieces_with_it(result: Path, tmp_path: Path) -> None:
    shift = np.array([2.0, -1.0, 0.5])
    (tmp_path / "moved.off").write_bytes(WRITERS["off"]((SOURCE.vertices + shift, SOURCE.faces)))
    out = tmp_path / "there.off"
    assert main(["transfer", str(result), "deformation", str(tmp_path / "moved.off"), "--out", str(out)]) == 0
    written = read_mesh_file(out)
    has = np.setdiff1d(np.arange(len(TARGET.vertices)), TARGET.left_out)
    np.testing.assert_allclose(np.ptp(written.vertices[has] - TARGET.vertices[has], axis=0), 0.0, atol=1e-6)


def test_errors_are_measured_on_the_surface(result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.savetxt(tmp_path / "truth.txt", truth(SOURCE, TARGET), fmt="%d")
    command = ["evaluate", str(result), "--truth", str(tmp_path / "truth.txt"), "--json"]
    assert main(command) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["exact"] == 1.0
    assert document["skipped"] == len(SOURCE.carried) + len(SOURCE.left_out)


def test_every_format_is_written(result: Path, tmp_path: Path) -> None:
    formats = ("ply", "obj", "vts", "map", "numpy", "matlab", "pyfm", "geomfum", "report", "picture")
    wanted = [word for name in formats for word in ("--format", name)]
    assert main(["export", str(result), *wanted, "--out", str(tmp_path / "out")]) == 0
    assert len(list((tmp_path / "out").iterdir())) == 16
    for name, file in (("source", SOURCE), ("target", TARGET)):
        assert len(read_mesh_file(tmp_path / "out" / f"{name}.ply").vertices) == len(file.vertices)
