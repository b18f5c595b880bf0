"""The other interpreter: the same numbers bit for bit, the same errors, and nothing left of it."""

from __future__ import annotations

import dataclasses
import logging
import os
import pickle
import signal
import subprocess
import sys
import threading
from concurrent.futures import CancelledError
from pathlib import Path

import analytic
import numpy as np
import psutil
import pytest
from numpy.typing import NDArray
from skips import posix
from waiting import wait_until

from clalign.errors import MemoryBudgetError, MeshError
from clalign.geometry import heat, heat_process, shape
from clalign.geometry.geodesics import farthest_point_geodesics
from clalign.geometry.heat import Geodesics, HeatMethod, Surface, farthest_points
from clalign.geometry.heat_process import HeatProcess
from clalign.geometry.operators import lumped_mass
from clalign.mesh.mesh import Mesh
from clalign.options import Options

ANSWER_FIRST = "import json, sys\nsys.path[:] = json.loads(sys.argv[1])\n"


def surface(mesh: Mesh) -> Surface:
    return Surface(mesh.vertices, mesh.faces, lumped_mass(mesh.vertices, mesh.faces), mesh.name)


@pytest.fixture(scope="module")
def bumpy() -> Surface:
    return surface(analytic.as_unit_mesh(analytic.bumpy(3), "bumpy"))


@pytest.fixture(autouse=True)
def always(monkeypatch: pytest.MonkeyPatch) -> None:
    """Use the process however small the mesh and the machine."""
    monkeypatch.setattr(heat_process, "WORTH_A_PROCESS", 0)
    monkeypatch.setattr(heat_process, "processor_count", lambda: 2)


@pytest.fixture
def not_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fail where the work is done in this interpreter."""

    def refuse(*_: object) -> Geodesics:
        raise AssertionError("computed in this interpreter")

    monkeypatch.setattr(heat_process, "farthest_points", refuse)


def assert_same(found: Geodesics, expected: Geodesics) -> None:
    for name in ("samples", "distances", "rows", "weights"):
        one, other = getattr(found, name), getattr(expected, name)
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)


def gone(process: int) -> bool:
    return not psutil.pid_exists(process)


@pytest.mark.usefixtures("not_here")
def test_the_same_bit_for_bit(bumpy: Surface) -> None:
    process = HeatProcess()
    assert_same(process.farthest_points(bumpy, 60, 20), farthest_points(bumpy, 60, 20))
    assert process._process is not None
    assert process._process.pid != os.getpid()
    assert gone(process._process.pid)


def test_preparation_is_the_same_bit_for_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = analytic.as_unit_mesh(analytic.bumpy(3), "bumpy")
    options = Options().replace(
        {
            "spectrum.basis": 20,
            "spectrum.refinement": 30,
            "spectrum.scale_invariant": 40,
            "geodesics.search_samples": 50,
        }
    )
    with monkeypatch.context() as patch:
        patch.setattr(heat_process, "processor_count", lambda: 1)
        patch.setattr(heat_process, "_started", lambda: pytest.fail("a process on one processor"))
        here = shape.prepare(mesh, options)
    monkeypatch.setattr(heat_process, "farthest_points", lambda *_: pytest.fail("computed in this interpreter"))
    there = shape.prepare(mesh, options)
    for name in ("samples", "distances", "rows", "weights"):
        np.testing.assert_array_equal(getattr(there.geodesics, name), getattr(here.geodesics, name))
    np.testing.assert_array_equal(there.factors.left, here.factors.left)


def test_small_meshes_need_no_process(bumpy: Surface, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(heat_process, "WORTH_A_PROCESS", 10 * len(bumpy.vertices) + 1)
    process = HeatProcess()
    process.farthest_points(bumpy, 10, 5)
    assert process._process is None


@pytest.mark.usefixtures("not_here")
def test_what_the_heat_method_refuses_has_the_same_message(bumpy: Surface, capfd: pytest.CaptureFixture[str]) -> None:
    broken = dataclasses.replace(bumpy, vertices=np.full_like(bumpy.vertices, np.nan), name="Ünruhe")
    with pytest.raises(MeshError) as here:
        farthest_points(broken, 3, 2)
    capfd.readouterr()
    with pytest.raises(MeshError) as there:
        HeatProcess().farthest_points(broken, 3, 2)
    assert str(there.value) == str(here.value)
    assert "Ünruhe" in str(here.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.usefixtures("not_here")
@posix
def test_a_crash_of_native_code_is_an_error_of_the_mesh(
    bumpy: Surface, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(heat_process, "PROGRAM", "import os; os.abort()")
    with pytest.raises(MeshError, match=r"bumpy: geodesic distances .*SIGABRT"):
        HeatProcess().farthest_points(bumpy, 6, 2)
    assert capfd.readouterr() == ("", "")


@pytest.mark.usefixtures("not_here")
@posix
@pytest.mark.parametrize("ending", ["SIGKILL", "SIGTERM"])
def test_a_kill_from_outside_is_no_error_of_the_mesh(
    bumpy: Surface, monkeypatch: pytest.MonkeyPatch, ending: str
) -> None:
    """As the system kills where memory runs out: this process, with all it holds, must not be the next."""
    kill = f"import os, sys; sys.stdin.buffer.read(20); os.kill(os.getpid(), {int(getattr(signal, ending))})"
    monkeypatch.setattr(heat_process, "PROGRAM", kill)
    with pytest.raises(MemoryBudgetError, match=rf"bumpy: .*{ending}.* CLALIGN_THREADS=1"):
        HeatProcess().farthest_points(bumpy, 6, 2)


@posix
def test_other_signals_leave_the_work_to_this_interpreter(bumpy: Surface, monkeypatch: pytest.MonkeyPatch) -> None:
    end = f"import os, sys; sys.stdin.buffer.read(20); os.kill(os.getpid(), {int(signal.SIGHUP)})"
    monkeypatch.setattr(heat_process, "PROGRAM", end)
    assert_same(HeatProcess().farthest_points(bumpy, 6, 2), farthest_points(bumpy, 6, 2))


@pytest.mark.usefixtures("not_here")
def test_two_meshes_have_two_processes_at_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Neither answers before both were asked."""
    meeting = f"""import os, pathlib, time
from clalign.geometry.heat import answer
folder, limit = pathlib.Path({str(tmp_path)!r}), time.monotonic() + 100
(folder / str(os.getpid())).touch()
while len(list(folder.iterdir())) < 2:
    assert time.monotonic() < limit
    time.sleep(0.01)
answer()"""
    meshes = [
        analytic.as_unit_mesh(analytic.bumpy(3), "bumpy"),
        analytic.as_unit_mesh(analytic.torus(30, 15, 0.4), "t"),
    ]
    few = {
        "spectrum.basis": 20,
        "spectrum.refinement": 30,
        "spectrum.scale_invariant": 40,
        "geodesics.search_samples": 50,
    }
    monkeypatch.setattr(heat_process, "PROGRAM", ANSWER_FIRST + meeting)
    monkeypatch.setattr(shape, "processor_count", lambda: 2)
    shapes = shape.prepare_all(meshes, Options().replace(few))
    numbers = {int(path.name) for path in tmp_path.iterdir()}
    assert len(numbers) == 2
    assert os.getpid() not in numbers
    assert all(gone(number) for number in numbers)
    for one, mesh in zip(shapes, meshes, strict=True):
        np.testing.assert_array_equal(one.geodesics.samples, farthest_point_geodesics(mesh, 50, 100).samples)


@pytest.mark.parametrize(
    "program",
    [
        "raise SystemExit(3)",
        "import nothing_of_this_name",
        "import os; os.write(1, b'=' + bytes(7))",
        "import pickle, sys; sys.stdout.buffer.write(pickle.dumps(7))",
        "import sys; sys.stdin.buffer.read(20); sys.exit()",
        "import sys; sys.stdin.buffer.read(20); sys.exit(1)",
    ],
)
def test_without_an_answer_the_work_is_done_here(
    bumpy: Surface, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], program: str
) -> None:
    monkeypatch.setattr(heat_process, "PROGRAM", program)
    assert_same(HeatProcess().farthest_points(bumpy, 6, 2), farthest_points(bumpy, 6, 2))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("executable", ["", None, "missing/python3", "application"])
def test_without_an_interpreter_the_work_is_done_here(
    bumpy: Surface, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, executable: str | None
) -> None:
    started = tmp_path / "started"
    application = tmp_path / "application"
    application.write_text(f"#!/bin/sh\ntouch '{started}'\n", encoding="utf-8")
    application.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(tmp_path / executable) if executable else executable)
    assert_same(HeatProcess().farthest_points(bumpy, 6, 2), farthest_points(bumpy, 6, 2))
    assert not started.exists()


def test_a_frozen_program_is_not_started_again(bumpy: Surface, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "frozen", True, raising=False)
    monkeypatch.setattr(heat_process, "_started", lambda: pytest.fail("started"))
    assert_same(HeatProcess().farthest_points(bumpy, 6, 2), farthest_points(bumpy, 6, 2))


@pytest.mark.usefixtures("not_here")
@pytest.mark.parametrize("entry", ["", ".", "modules"])
def test_modules_in_the_working_folder_are_not_taken_for_libraries(
    entry: str, bumpy: Surface, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    folder = tmp_path / entry
    folder.mkdir(exist_ok=True)
    for name in ("json", "numpy", "clalign"):
        (folder / f"{name}.py").write_text("raise SystemExit('the wrong one')", encoding="utf-8")
    monkeypatch.setattr(sys, "path", [entry, *(os.path.abspath(folder) for folder in sys.path if folder)])
    monkeypatch.chdir(tmp_path)
    assert_same(HeatProcess().farthest_points(bumpy, 6, 2), farthest_points(bumpy, 6, 2))


@pytest.mark.usefixtures("not_here")
def test_stopping_ends_a_process_that_is_at_work(bumpy: Surface, monkeypatch: pytest.MonkeyPatch) -> None:
    """As Ctrl-C does: the thread that waits for an answer gets an exception, and no process is left."""
    monkeypatch.setattr(heat_process, "PROGRAM", "import time; time.sleep(600)")
    errors: list[BaseException] = []
    process = HeatProcess()

    def ask() -> None:
        try:
            process.farthest_points(bumpy, 6, 2)
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=ask)
    thread.start()
    wait_until(lambda: process._process is not None)
    assert process._process is not None
    number = process._process.pid
    process.stop()
    thread.join(60)
    assert not thread.is_alive()
    assert [type(error) for error in errors] == [CancelledError]
    assert gone(number)
    with pytest.raises(CancelledError):
        process.farthest_points(bumpy, 6, 2)


def test_stopping_ends_what_is_computed_in_this_process(bumpy: Surface, monkeypatch: pytest.MonkeyPatch) -> None:
    """On one processor; the interpreter would wait at its exit for the last sample."""
    monkeypatch.setattr(heat_process, "processor_count", lambda: 1)
    process, plain, rows = HeatProcess(), HeatMethod.row, []

    def row(method: HeatMethod, vertex: int) -> NDArray[np.float64]:
        rows.append(vertex)
        if len(rows) == 4:
            process.stop()
        return plain(method, vertex)

    monkeypatch.setattr(HeatMethod, "row", row)
    with pytest.raises(CancelledError):
        process.farthest_points(bumpy, 60, 20)
    assert len(rows) == 4


def test_an_interrupt_during_preparation_ends_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = analytic.as_unit_mesh(analytic.bumpy(3), "bumpy")
    monkeypatch.setattr(heat_process, "PROGRAM", "import time; time.sleep(600)")
    numbers: list[int] = []
    started = heat_process._started

    def noted() -> object:
        process = started()
        numbers.append(process.pid)
        return process

    def interrupt(*_: object) -> None:
        wait_until(lambda: bool(numbers))
        raise KeyboardInterrupt

    monkeypatch.setattr(heat_process, "_started", noted)
    monkeypatch.setattr(shape, "_spectra", interrupt)
    monkeypatch.setattr(shape, "processor_count", lambda: 2)
    with pytest.raises(KeyboardInterrupt):
        shape.prepare_pair(mesh, mesh, Options())
    assert numbers
    assert all(gone(number) for number in numbers)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_a_process_ends_with_its_input(bumpy: Surface, share: float) -> None:
    """So that none outlives a program that is killed before it has sent everything, or before it gets the answer."""
    request = pickle.dumps((bumpy, 6, 2))
    with heat_process._started() as process:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            process.stdout.close()
            process.stdin.write(request[: int(share * len(request))])
            process.stdin.close()
            assert process.wait(60) > 0
        finally:
            process.kill()


def test_what_the_process_imports() -> None:
    """A start of a fifth of a second, not of two: neither trimesh nor scipy's solvers."""
    program = "from clalign.geometry import heat; import potpourri3d, sys; print(*sys.modules)"
    with os.popen(f'"{sys.executable}" -c "{program}"') as output:
        loaded = set(output.read().split())
    assert {"numpy", "potpourri3d", heat.__name__} <= loaded
    assert not loaded & {"trimesh", "scipy.linalg", "scipy.spatial", "pyopencl", "clalign.mesh.mesh"}


def test_a_package_found_in_the_working_folder_is_found_by_the_process(tmp_path: Path) -> None:
    """As from a checkout that is not installed, whose only entry in the path is the working folder."""
    program = """import sys
sys.path = [folder for folder in sys.path if folder != sys.argv[1]]
sys.path.insert(0, "")
from clalign.geometry import heat_process
print(*heat_process._module_path(), sep="\\n")"""
    root = str(Path(heat_process.__file__).parents[2])
    done = subprocess.run(
        [sys.executable, "-c", program, root], cwd=root, capture_output=True, text=True, check=True, timeout=100
    )
    folders = done.stdout.splitlines()
    assert folders[-1] == root
    assert all(os.path.isabs(folder) for folder in folders)


def test_a_lost_process_is_logged(
    bumpy: Surface, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(heat_process, "PROGRAM", "raise SystemExit(7)")
    with caplog.at_level(logging.INFO, logger="clalign"):
        HeatProcess().farthest_points(bumpy, 6, 2)
    assert "status 7" in caplog.text
