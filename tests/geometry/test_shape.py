"""What `prepare` returns: eigenfunctions known on spheres, and the same bits alone, in pairs and from the cache."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import analytic
import numpy as np
import pytest
import scipy.sparse as sparse
import threadpoolctl

from clalign.geometry import shape as shape_module
from clalign.geometry.cache import ShapeCache
from clalign.geometry.shape import Shape, equally_smoothed, prepare, prepare_all, prepare_pair, with_scale_invariant
from clalign.geometry.workers import single_threaded_blas
from clalign.mesh.mesh import Mesh, mesh_from_arrays
from clalign.options import Options, SpectrumOptions
from clalign.rules import ShapeRules

OPTIONS = Options().replace(
    {
        "spectrum.basis": 40,
        "spectrum.refinement": 60,
        "spectrum.scale_invariant": 80,
        "geodesics.search_samples": 60,
        "geodesics.factor_samples": 30,
    }
)


@pytest.fixture(scope="module")
def bumpy() -> Mesh:
    return analytic.as_unit_mesh(analytic.bumpy(3), "bumpy")


@pytest.fixture(scope="module")
def bumpy_shape(bumpy: Mesh) -> Shape:
    return prepare(bumpy, OPTIONS)


def leaves(value: Any, name: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """All arrays of a shape with their names."""
    if dataclasses.is_dataclass(value):
        for item in dataclasses.fields(value):
            yield from leaves(getattr(value, item.name), f"{name}.{item.name}")
    elif sparse.issparse(value):
        yield name, value.toarray()
    elif isinstance(value, np.ndarray):
        yield name, value


def assert_same(first: Shape, second: Shape) -> None:
    ours, theirs = dict(leaves(first)), dict(leaves(second))
    assert ours.keys() == theirs.keys()
    for name, array in ours.items():
        np.testing.assert_array_equal(theirs[name], array, err_msg=name)


def test_sizes_and_finiteness(bumpy: Mesh, bumpy_shape: Shape) -> None:
    n = bumpy.n_vertices
    assert bumpy_shape.basis.functions.shape == (n, 60)
    assert bumpy_shape.scale_invariant.functions.shape == (n, 80)
    assert bumpy_shape.geodesics.distances.shape == (60, 60)
    assert bumpy_shape.geodesics.rows.shape == (30, n)
    assert bumpy_shape.factors.left.shape == (n, 15)
    assert bumpy_shape.orientation.shape == (30, 30, 30)
    assert bumpy_shape.signatures.shape == (n, 6)
    assert bumpy_shape.curvatures.shape == (n, 2)
    for name, array in leaves(bumpy_shape):
        assert np.isfinite(array).all(), name
    assert bumpy_shape.mass.sum() == pytest.approx(1.0, rel=1e-12)
    assert bumpy_shape.scale_invariant.mass.sum() == pytest.approx(1.0, rel=1e-12)


def test_both_spectra_are_of_one_stiffness(bumpy_shape: Shape) -> None:
    for spectrum in (bumpy_shape.basis, bumpy_shape.scale_invariant):
        energy = spectrum.functions.T @ (bumpy_shape.stiffness @ spectrum.functions)
        np.testing.assert_allclose(energy, np.diag(spectrum.eigenvalues), atol=1e-6)
    assert not np.allclose(bumpy_shape.basis.mass, bumpy_shape.scale_invariant.mass)


def test_descriptors_of_a_sphere() -> None:
    """On a unit-area sphere: h_t = Σ (2l+1) exp(−4π l(l+1) t), H = sqrt(4π), K = 4π, everywhere alike."""
    options = OPTIONS.replace({"spectrum.refinement": 169})
    found = prepare(analytic.as_unit_mesh(analytic.sphere(4)), options)
    degree = np.arange(13.0)[:, None]
    kernel = (
        (2 * degree + 1) * np.exp(-4 * np.pi * degree * (degree + 1) * shape_module.signature_times(ShapeRules()))
    ).sum(axis=0)
    np.testing.assert_allclose(found.signatures, np.broadcast_to(np.log(kernel), found.signatures.shape), atol=0.04)
    np.testing.assert_allclose(found.curvatures[:, 0], np.sqrt(4 * np.pi), rtol=0.05)
    np.testing.assert_allclose(found.curvatures[:, 1], 4 * np.pi, rtol=0.05)


def test_curvatures_are_not_thrown_by_single_wild_values(bumpy_shape: Shape) -> None:
    wild = bumpy_shape.curvature.copy()
    wild[[5, 77]] = 1e9
    mean = np.zeros_like(wild)
    before = shape_module.smoothed_curvatures(bumpy_shape.basis, mean, bumpy_shape.curvature, ShapeRules())[:, 1]
    after = shape_module.smoothed_curvatures(bumpy_shape.basis, mean, wild, ShapeRules())[:, 1]
    assert np.abs(after - before).mean() < 0.1 * np.abs(before).mean()


def test_mirror_image_has_the_same_shape_and_the_opposite_orientation(bumpy: Mesh, bumpy_shape: Shape) -> None:
    """A mirrored surface, faces outward again: all intrinsic values stay, triple products change sign."""
    mirrored = mesh_from_arrays(bumpy.vertices * [-1.0, 1.0, 1.0], bumpy.faces[:, ::-1], name="mirrored")
    found = prepare(mirrored, OPTIONS)
    np.testing.assert_allclose(found.basis.eigenvalues, bumpy_shape.basis.eigenvalues, rtol=1e-9, atol=1e-8)
    np.testing.assert_allclose(found.signatures, bumpy_shape.signatures, atol=1e-6)
    np.testing.assert_allclose(found.curvatures, bumpy_shape.curvatures, atol=1e-3)
    largest = np.abs(bumpy_shape.orientation).max()
    np.testing.assert_allclose(found.orientation, -bumpy_shape.orientation, atol=1e-5 * largest)
    assert largest > 1.0


def test_alone_in_pairs_and_from_the_cache_bit_for_bit(bumpy: Mesh, bumpy_shape: Shape, tmp_path: Path) -> None:
    other = analytic.as_unit_mesh(analytic.torus(40, 20, 0.4), "torus")
    cache = ShapeCache(tmp_path)
    first, second = prepare_pair(bumpy, other, OPTIONS, cache)
    assert_same(first, bumpy_shape)
    assert cache.info().entries == 6
    again, same = prepare_pair(bumpy, other, OPTIONS, ShapeCache(tmp_path))
    assert_same(again, bumpy_shape)
    assert_same(same, second)
    assert cache.info().entries == 6


def test_stored_parts_are_not_computed_again(
    bumpy: Mesh, bumpy_shape: Shape, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache = ShapeCache(tmp_path)
    prepare(bumpy, OPTIONS, cache)

    def refuse(*_: Any) -> None:
        raise AssertionError("computed although stored")

    monkeypatch.setattr(shape_module, "farthest_point_geodesics", refuse)
    with monkeypatch.context() as patch:
        patch.setattr(shape_module, "solve", refuse)
        assert_same(prepare(bumpy, OPTIONS, cache), bumpy_shape)
        # Options that the preparation does not read leave everything usable.
        assert_same(prepare(bumpy, OPTIONS.replace({"alignment.weight": 1, "spectrum.basis": 30}), cache), bumpy_shape)
    # Another metric needs one decomposition, and neither the basis nor the distances.
    changed = prepare(bumpy, OPTIONS.replace({"spectrum.xi": 0.3}), cache)
    np.testing.assert_array_equal(changed.basis.functions, bumpy_shape.basis.functions)
    assert np.abs(changed.scale_invariant.eigenvalues - bumpy_shape.scale_invariant.eigenvalues).max() > 1.0
    assert cache.info().entries == 4


def test_damaged_entries_are_computed_again_and_replaced(
    bumpy: Mesh, bumpy_shape: Shape, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    cache = ShapeCache(tmp_path)
    prepare(bumpy, OPTIONS, cache)
    for path in tmp_path.glob("*.npz"):
        path.write_bytes(path.read_bytes()[:1000])
    assert_same(prepare(bumpy, OPTIONS, cache), bumpy_shape)
    assert sum(record.levelno == logging.WARNING for record in caplog.records) == 3
    caplog.clear()
    assert_same(prepare(bumpy, OPTIONS, cache), bumpy_shape)
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING]


@pytest.mark.parametrize("content", [{}, {"eigenvalues": np.zeros(3)}, {"something": np.zeros(3)}])
def test_entries_with_other_contents_are_computed_again(
    bumpy: Mesh, bumpy_shape: Shape, tmp_path: Path, content: dict[str, Any]
) -> None:
    cache = ShapeCache(tmp_path)
    prepare(bumpy, OPTIONS, cache)
    for path in list(tmp_path.glob("*.npz")):
        cache.put(path.stem, content)
    assert_same(prepare(bumpy, OPTIONS, cache), bumpy_shape)


def test_other_descriptors_for_a_prepared_shape(bumpy: Mesh, bumpy_shape: Shape) -> None:
    changed = with_scale_invariant(bumpy_shape, dataclasses.replace(OPTIONS.spectrum, xi=0.15, scale_invariant=50))
    expected = prepare(bumpy, OPTIONS.replace({"spectrum.xi": 0.15, "spectrum.scale_invariant": 50}))
    assert_same(changed, expected)


def noisy(mesh: Mesh) -> Mesh:
    rng = np.random.default_rng(0)
    return analytic.as_unit_mesh((mesh.vertices + 0.01 * rng.standard_normal(mesh.vertices.shape), mesh.faces), "noisy")


def test_curvature_is_smoothed_where_it_is_noise(bumpy: Mesh, bumpy_shape: Shape) -> None:
    assert bumpy_shape.smoothing == 0.0
    assert prepare(noisy(bumpy), OPTIONS).smoothing == OPTIONS.spectrum.smoothing > 0
    assert prepare(noisy(bumpy), OPTIONS.replace({"spectrum.metric": "euclidean"})).smoothing == 0.0
    assert prepare(bumpy, OPTIONS.replace({"spectrum.noisy_below": 1.0})).smoothing > 0
    assert Options.preset("paper").spectrum.smoothing == 0.0


def test_a_pair_is_smoothed_as_its_noisier_mesh_asks_for(bumpy: Mesh, bumpy_shape: Shape, tmp_path: Path) -> None:
    cache = ShapeCache(tmp_path)
    clean, rough = prepare_pair(bumpy, noisy(bumpy), OPTIONS, cache)
    assert clean.smoothing == rough.smoothing == OPTIONS.spectrum.smoothing
    assert_same(clean, prepare(bumpy, OPTIONS.replace({"spectrum.noisy_below": 1.0})))
    assert np.abs(clean.scale_invariant.eigenvalues - bumpy_shape.scale_invariant.eigenvalues).max() > 1.0
    again, _ = equally_smoothed(clean, bumpy_shape, OPTIONS.spectrum)
    assert again is clean
    # Another exponent for a pair keeps its smoothing.
    changed = with_scale_invariant(clean, dataclasses.replace(OPTIONS.spectrum, xi=0.3), smoothing=clean.smoothing)
    assert changed.smoothing == clean.smoothing


@pytest.mark.parametrize("metric", ["euclidean", "regularized", "heat-kernel", "auto"])
def test_every_metric_prepares(bumpy_shape: Shape, metric: str) -> None:
    options = SpectrumOptions(metric=metric, basis=40, refinement=60, scale_invariant=80)  # type: ignore[arg-type]
    changed = with_scale_invariant(bumpy_shape, options)
    gram = changed.scale_invariant.functions.T @ (
        changed.scale_invariant.mass[:, None] * changed.scale_invariant.functions
    )
    np.testing.assert_allclose(gram, np.eye(80), atol=1e-12)
    if metric == "euclidean":
        np.testing.assert_allclose(changed.scale_invariant.eigenvalues[:60], changed.basis.eigenvalues, atol=1e-6)


def test_many_shapes_at_once(bumpy: Mesh, bumpy_shape: Shape) -> None:
    for found in prepare_all([bumpy] * 3, OPTIONS):
        assert_same(found, bumpy_shape)


def test_blas_threads_are_given_back() -> None:
    def threads() -> list[int]:
        return [pool["num_threads"] for pool in threadpoolctl.threadpool_info() if pool["user_api"] == "blas"]

    with threadpoolctl.threadpool_limits(2, user_api="blas"):
        before = threads()
        outer = single_threaded_blas()
        with single_threaded_blas():
            outer.__enter__()
            assert set(threads()) == {1}
        # The first to enter has left; the other one still holds the limit.
        assert set(threads()) == {1}
        outer.__exit__(None, None, None)
        assert threads() == before
