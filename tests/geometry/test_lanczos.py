"""The proof that no eigenvalue was passed over: what it must reject."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import analytic
import numpy as np
import pytest
import scipy.sparse as sparse

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
    """Factors made in one thread and dropped in another are never freed; here they would hold 20 MB a solve."""
    surface = analytic.bumpy(5)
    mass, stiffness = operators.lumped_mass(*surface), operators.stiffness(*surface)

    def resident() -> float:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20

    def solve_times(times: int) -> float:
        for _ in range(times):
            spectra.solve(stiffness, mass, 60, threads=threads)
        return resident()

    before = solve_times(3)
    assert solve_times(12) - before < 12.0
