from __future__ import annotations

import argparse
import sys
import types
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from clalign.cli import saved
from clalign.correspondence import Correspondence
from clalign.errors import InputError, ResultError
from clalign.mesh.mesh import load_mesh
from clalign.mesh.writing import save_mesh
from clalign.transfer.texture import Texture, read_texture, write_textured_obj

Run = Callable[..., int]


@pytest.fixture(scope="module")
def result(small: Correspondence, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("saved") / "result"
    small.save(folder)
    return folder


@pytest.fixture
def run() -> Run:
    """Run one command line through the parsers of the three commands."""
    parser = argparse.ArgumentParser()
    subparsers = parser.add_subparsers(required=True)
    for add in (saved.add_transfer, saved.add_export, saved.add_show):
        add(subparsers)

    def run_line(*words: object) -> int:
        args = parser.parse_args([str(word) for word in words])
        return int(args.run(args))

    return run_line


def test_scalars_labels_and_landmarks(run: Run, small: Correspondence, result: Path, tmp_path: Path) -> None:
    np.savetxt(tmp_path / "in.txt", np.arange(643), fmt="%d")
    assert run("transfer", result, "labels", tmp_path / "in.txt", "--out", tmp_path / "labels.txt") == 0
    assert np.array_equal(np.loadtxt(tmp_path / "labels.txt", dtype=int)[1:], small.source_of_target[1:])
    assert run("transfer", result, "scalars", tmp_path / "in.txt", "--from", "target", "--out", tmp_path / "s.npy") == 0
    assert np.array_equal(np.load(tmp_path / "s.npy")[1:], small.target_of_source[1:])
    np.savetxt(tmp_path / "marks.txt", [5, 6], fmt="%d")
    assert run("transfer", result, "landmarks", tmp_path / "marks.txt", "--out", tmp_path / "m.txt") == 0
    assert np.array_equal(np.loadtxt(tmp_path / "m.txt", dtype=int), small.target_of_source[[5, 6]])


def test_unwritable_output_is_named(run: Run, result: Path, tmp_path: Path) -> None:
    np.savetxt(tmp_path / "in.txt", np.arange(643), fmt="%d")
    with pytest.raises(ResultError, match=r"none/out\.txt: cannot be written"):
        run("transfer", result, "scalars", tmp_path / "in.txt", "--out", tmp_path / "none" / "out.txt")


def test_colours_become_a_coloured_mesh(run: Run, small: Correspondence, result: Path, tmp_path: Path) -> None:
    colours = np.random.default_rng(0).integers(0, 256, size=(643, 3))
    np.save(tmp_path / "paint.npy", colours)
    assert run("transfer", result, "colours", tmp_path / "paint.npy", "--out", tmp_path / "painted.ply") == 0
    painted = trimesh.load(tmp_path / "painted.ply", process=False)
    assert np.array_equal(painted.visual.vertex_colors[1:, :3], colours[small.source_of_target[1:]])


def test_deformation_becomes_a_mesh(run: Run, small: Correspondence, result: Path, tmp_path: Path) -> None:
    faces = small.source.file_faces
    save_mesh(tmp_path / "moved.ply", 2 * small.source.file_positions(), faces)
    assert run("transfer", result, "deformation", tmp_path / "moved.ply", "--out", tmp_path / "out.off") == 0
    moved = load_mesh(tmp_path / "out.off")
    assert moved.file_count == 643
    assert moved.scale == pytest.approx(2 * small.target.scale, rel=1e-6)


def test_texture_becomes_an_obj(run: Run, small: Correspondence, result: Path, tmp_path: Path) -> None:
    source = small.source
    texture = Texture(source.vertices[:, :2], source.faces.astype(np.int64), source.file_faces)
    write_textured_obj(tmp_path / "in.obj", source.file_positions(), texture)
    assert run("transfer", result, "texture", tmp_path / "in.obj", "--out", tmp_path / "out.obj") == 0
    assert len(read_texture(tmp_path / "out.obj").faces) == small.target.n_faces
    with pytest.raises(InputError, match=r"\.obj"):
        run("transfer", result, "texture", tmp_path / "in.obj", "--out", tmp_path / "out.ply")


def test_export_writes_every_format(run: Run, result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [word for name in saved.FORMATS for word in ("--format", name)]
    assert run("export", result, *words, "--out", tmp_path / "all", "--up", "z") == 0
    printed = capsys.readouterr().out.splitlines()
    assert sorted(printed) == sorted(str(path) for path in (tmp_path / "all").iterdir())
    assert len(printed) >= len(saved.FORMATS)


def test_show_without_pyvista_says_what_to_install(run: Run, result: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(InputError, match=r"pip install 'clalign\[view\]'"):
        run("show", result)


def test_show_opens_the_page(run: Run, result: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import webbrowser

    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda address: opened.append(address) or True)
    assert run("show", result, "--page") == 0
    assert opened == [(result / "report.html").as_uri()]
    assert (result / "report.html").stat().st_size > 500_000


def test_show_without_a_browser_says_so(
    run: Run, result: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("webbrowser.open", lambda _: False)
    assert run("show", result, "--page") == 1
    shown = capsys.readouterr()
    assert shown.out == f"{result / 'report.html'}\n"
    assert shown.err == "no browser could be started; open this file yourself\n"


class _Plotter:
    """Stands in for pyvista's plotter and remembers what it was given."""

    meshes: list[tuple[np.ndarray, np.ndarray]]

    def __init__(self, **options: object) -> None:
        self.off_screen = options["off_screen"]
        _Plotter.meshes = []

    def add_mesh(self, surface: tuple[np.ndarray, np.ndarray], *, scalars: np.ndarray, **_: object) -> None:
        _Plotter.meshes.append((surface[0], scalars))

    def screenshot(self, path: str) -> None:
        assert self.off_screen
        Path(path).write_bytes(b"picture")

    def __getattr__(self, name: str) -> Callable[..., None]:
        return lambda *_, **__: None


def test_show_gives_the_viewer_matching_colours(
    run: Run, small: Correspondence, result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    library = types.SimpleNamespace(
        Plotter=_Plotter, PolyData=types.SimpleNamespace(from_regular_faces=lambda *arrays: arrays)
    )
    monkeypatch.setitem(sys.modules, "pyvista", library)
    assert run("show", result, "--screenshot", tmp_path / "shot.png") == 0
    (points, source), (_, target) = _Plotter.meshes
    assert len(points) == small.source.n_vertices
    assert np.allclose(source, target[small.target_of_source[1:] - 1])
    assert (tmp_path / "shot.png").exists()
