"""The proof that no eigenvalue was passed over: what it must reject."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import CancelledError
from pathlib import Path
from typing import Any

import analytic
import numpy as np
import pytest
import scipy.sparse as sparse
from skips import posix

from clalign.errors import ConvergenceError
from clalign.geometry import lanczos, operators, spectra

COUNT = 214


@pytest.fixture(scope="module")
def matrix() -> sparse.csc_matrix:
    surface = analytic.bumpy(3)
    root = sparse.diags_array(1 / np.sqrt(operators.lumped_mass(*surface) / 4.0))
    return sparse.csc_matrix(root @ operators.stiffness(*surface) @ root)


def omit(part: lanczos._Slice, index: int) -> lanczos._Slice:
    """Return a slice as it comes out when one pair below the shift is passed over: the numbers move up."""
    return lanczos._Slice(part.first + 1, np.delete(part.values, index), np.delete(part.rows, index, axis=0))


def slices(matrix: sparse.csc_matrix) -> list[lanczos._Slice]:
    values, vectors = np.linalg.eigh(matrix.toarray())
    bounds = [(0, 100), (88, 160), (148, COUNT)]
    return [lanczos._Slice(first, values[first:end], vectors[:, first:end].T) for first, end in bounds]


def test_slices_that_agree_are_joined(matrix: sparse.csc_matrix) -> None:
    values, rows = lanczos._joined(slices(matrix), 1.0)
    np.testing.assert_allclose(values, np.linalg.eigvalsh(matrix.toarray())[:COUNT], atol=1e-9)
    np.testing.assert_allclose(rows @ rows.T, np.eye(COUNT), atol=1e-12)
    lanczos._check_count(matrix, values)


@pytest.mark.parametrize(("which", "index"), [(1, 40), (2, 30), (1, 1)])
def test_a_pair_missing_between_shifts_shows_as_disagreement(matrix: sparse.csc_matrix, which: int, index: int) -> None:
    parts = slices(matrix)
    parts[which] = omit(parts[which], index)
    with pytest.raises(ConvergenceError, match="disagree"):
        lanczos._joined(parts, 1.0)


def test_a_pair_missing_at_the_upper_end_shows_in_the_count(matrix: sparse.csc_matrix) -> None:
    values = np.linalg.eigvalsh(matrix.toarray())[: COUNT + 1]
    with pytest.raises(ConvergenceError, match="were found"):
        lanczos._check_count(matrix, np.delete(values, COUNT - 40))


def test_a_vector_found_twice_is_refused(matrix: sparse.csc_matrix) -> None:
    rows = np.linalg.eigh(matrix.toarray())[1].T[:20].copy()
    rows[7] = rows[8]
    with pytest.raises(ConvergenceError, match="coincide"):
        lanczos._orthonormal(rows)


@pytest.mark.parametrize("size", [60, 176, 214])
def test_any_number_of_slices_gives_the_dense_answer(
    matrix: sparse.csc_matrix, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lanczos, "SLICE", size)
    values, vectors = lanczos.lowest_pairs(matrix, COUNT, np.pi, threads=2)
    exact = np.linalg.eigvalsh(matrix.toarray())[:COUNT]
    np.testing.assert_allclose(values, exact, rtol=1e-9, atol=1e-8)
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(COUNT), atol=1e-12)


def test_a_basis_that_cannot_grow_is_an_error(matrix: sparse.csc_matrix, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lanczos, "CAPACITY", 0.5)
    monkeypatch.setattr(lanczos, "FIRST_CHECK", 0.5)
    with pytest.raises(ConvergenceError, match="did not converge"):
        lanczos.lowest_pairs(matrix, COUNT, np.pi)


def test_threads_are_given_a_matrix_that_scipy_need_not_sort(
    matrix: sparse.csc_matrix, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Scipy sorts a matrix in place when first asked to; in several threads at once that destroys it."""
    place = lanczos._plan
    seen = []

    def watch(permuted: sparse.csc_matrix, *arguments: Any) -> Any:
        seen.append(permuted.has_sorted_indices and permuted.has_canonical_format)
        return place(permuted, *arguments)

    monkeypatch.setattr(lanczos, "_plan", watch)
    lanczos.lowest_pairs(matrix, 20, np.pi, threads=2)
    assert seen == [True]


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="tells its memory in another way")
@pytest.mark.parametrize("threads", [1, 2])
def test_solving_again_and_again_takes_no_more_memory(threads: int) -> None:
    """Factors made in one thread and dropped in another are never freed; here they would hold 20 MB a solve.

    An allocator may take more once, as it does in a process that has done much else; a leak goes on.
    """
    surface = analytic.bumpy(5)
    mass, stiffness = operators.lumped_mass(*surface), operators.stiffness(*surface)

    def resident() -> float:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20

    def solve_times(times: int) -> float:
        for _ in range(times):
            spectra.solve(stiffness, mass, 60, threads=threads)
        return resident()

    levels = [solve_times(times) for times in (3, 6, 6)]
    assert min(np.diff(levels)) < 12.0


INTERRUPTED = """
import os, time
import analytic
from clalign.geometry import lanczos, operators, spectra

class Slow(lanczos._Basis):
    # The pace of a mesh of a hundred thousand vertices: half a minute and more for either of the two slices.
    def __init__(self, solve, *arguments):
        def slowly(sides):
            os.write(1, b"block\\n")
            time.sleep(0.4)
            return solve(sides)
        super().__init__(slowly, *arguments)

lanczos._Basis = Slow
surface = analytic.bumpy(4)
spectra.solve(operators.stiffness(*surface), operators.lumped_mass(*surface), 2 * lanczos.SLICE, threads=2)
"""


@posix
def test_after_ctrl_c_the_process_ends_without_finishing_its_slices() -> None:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    command = [sys.executable, "-c", INTERRUPTED]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as script:
        assert script.stdout is not None
        assert [script.stdout.readline() for _ in range(3)] == 3 * ["block\n"]
        script.send_signal(signal.SIGINT)
        sent = time.monotonic()
        try:
            rest, complaints = script.communicate(timeout=20)
        finally:
            script.kill()
    assert time.monotonic() - sent < 5.0
    assert script.returncode == -signal.SIGINT, complaints
    assert complaints.endswith("KeyboardInterrupt\n")
    # Those that were begun while the signal was on its way: either thread had more than sixty to go.
    assert rest.count("block") < 20


def test_a_slice_that_fails_ends_the_others(monkeypatch: pytest.MonkeyPatch, matrix: sparse.csc_matrix) -> None:
    """One of two slices fails at once, the other one would go on until it is told to stop."""
    compute, given_up = lanczos._slice, []

    def one_fails(
        matrix: sparse.csc_matrix, factor: Any, first: int, end: int, unit: float, stop: threading.Event
    ) -> lanczos._Slice:
        if first == 0:
            raise ConvergenceError("did not converge")
        assert stop.wait(20.0)
        try:
            return compute(matrix, factor, first, end, unit, stop)
        except CancelledError:
            given_up.append(first)
            raise

    monkeypatch.setattr(lanczos, "_slice", one_fails)
    monkeypatch.setattr(lanczos, "SLICE", COUNT // 2)
    with pytest.raises(ConvergenceError, match="did not converge"):
        lanczos.lowest_pairs(matrix, COUNT, np.pi, threads=2)
    assert len(given_up) == 1
