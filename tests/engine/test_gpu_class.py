"""The kernels of the class of GPUs, on whatever device the tests run on: every operation, in both precisions.

Sizes are odd and just above those of a tile (128 or 64 rows, 64 columns, a panel of 8 or 16 steps, sums in parts of
128), so that every kernel has a second tile, of which little is used. That they are no larger is for the time that a
CPU takes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clalign.engine.band import Band
from clalign.engine.device import Device
from clalign.engine.kernels import Kernels
from clalign.engine.reference import Reference, pair_count


def band_of(size: int) -> Band:
    """About half of the matrix."""
    rows = np.arange(size)
    return Band.from_limits(np.maximum(rows - size // 3, 0), np.minimum(rows + size // 4 + 1, size))


@pytest.mark.parametrize("transpose_a", [False, True])
@pytest.mark.parametrize("transpose_b", [False, True])
@pytest.mark.parametrize("shape", [(131, 67, 141), (5, 3, 513)])
def test_product(check_gpu, rng, shape, transpose_a, transpose_b):
    m, n, depth = shape
    a = rng.normal(size=(depth, m) if transpose_a else (m, depth))
    b = rng.normal(size=(n, depth) if transpose_b else (depth, n))
    check_gpu("product", a, b, transpose_a=transpose_a, transpose_b=transpose_b, scale=-0.75)


def test_leading_columns_and_accumulation(check_gpu, rng):
    check_gpu("product", rng.normal(size=(70, 27)), rng.normal(size=(20, 9)), leading=True)
    kernels = check_gpu.args[0]
    a, b, c = rng.normal(size=(70, 20)), rng.normal(size=(20, 9)), rng.normal(size=(70, 9))
    out = kernels.array(c)
    kernels.product(kernels.array(a), kernels.array(b), scale=2.0, accumulate=True, out=out)
    np.testing.assert_allclose(kernels.numpy(out), c + 2 * a @ b, atol=1e-4)


@pytest.mark.parametrize("sides", ["left", "right", "kept", "all"])
def test_banded_product(check_gpu, rng, sides):
    band = band_of(137)
    a, b = (rng.normal(size=(137, 137)) for _ in range(2))
    bands = {side: band for side in ("left", "right", "kept") if sides in (side, "all")}
    # What lies outside of a band is zero, as it is for callers.
    inside = Reference().band_expand(np.ones(band.count), band)
    a, b = (a * inside if "left" in bands else a), (b * inside if "right" in bands else b)
    check_gpu("banded_product", a, b, **bands, inside=band if "kept" in bands else None)


@pytest.mark.parametrize("weighted", [True, False])
@pytest.mark.parametrize(("rows", "m", "n"), [(1, 1, 2), (600, 67, 5), (140, 9, 131)])
def test_weighted_gram(check_gpu, rng, rows, m, n, weighted):
    check_gpu(
        "weighted_gram", rng.normal(size=(rows, m)), rng.normal(size=(rows, n)), rng.random(rows) if weighted else None
    )


@pytest.mark.parametrize(("m", "k"), [(1, 1), (35, 13), (7, 50)])
def test_solve(check_gpu, rng, m, k):
    left = rng.normal(size=(k, 3 * k))
    check_gpu("solve_right", left @ left.T, rng.normal(size=(m, k)), 1e-4)


@pytest.mark.usefixtures("opencl")
def test_a_factor_larger_than_the_work_group(rng):
    kernels = Kernels(Device(kind="gpu"))
    left = rng.normal(size=(270, 400))
    gram, x = left @ left.T, rng.normal(size=(3, 270))
    shifted = gram + 0.1 * np.trace(gram) / 270 * np.eye(270)
    solved = kernels.solve_right(kernels.array(gram), kernels.array(x @ shifted), 0.1)
    np.testing.assert_allclose(kernels.numpy(solved), x, atol=5e-5)


@pytest.mark.parametrize(("n", "k", "r"), [(1, 1, 1), (150, 17, 7), (40, 5, 67)])
def test_moments(check_gpu, rng, n, k, r):
    check_gpu("packed_moments", rng.normal(size=(n, k)), rng.random(n), rng.normal(size=(n, r)))
    check_gpu("packed_moments_gradient", rng.normal(size=(n, k)), rng.random(n), rng.normal(size=(pair_count(k), r)))


@pytest.mark.parametrize("with_normal", [True, False])
@pytest.mark.parametrize(("n", "k", "r"), [(1, 2, 1), (131, 17, 5), (20, 9, 67)])
def test_soft_map(check_gpu, rng, n, k, r, with_normal):
    c, dz, packed = rng.normal(size=(n, k)), rng.normal(size=(n, r)), rng.normal(size=(pair_count(k), r))
    left = rng.normal(size=(k, 2 * k))
    normal = left @ left.T if with_normal else None
    z, s = check_gpu("soft_map", c, packed, normal)
    check_gpu("soft_map_gradient", c, packed, normal, z, s, dz)


@pytest.mark.parametrize(("n", "n_y", "k", "r"), [(1, 3, 2, 1), (67, 131, 9, 5), (20, 66, 70, 67)])
def test_streamed_soft_map(check_gpu, rng, n, n_y, k, r):
    c, psi, w, u = rng.normal(size=(n, k)), rng.normal(size=(n_y, k)), rng.random(n_y), rng.normal(size=(n_y, r))
    z, s = check_gpu("soft_map_streamed", c, psi, w, u)
    check_gpu("soft_map_streamed_gradient", c, psi, w, u, z, s, rng.normal(size=(n, r)))


@pytest.mark.parametrize(("m", "p", "depth"), [(1, 1, 1), (131, 137, 9), (5, 300, 40)])
def test_best_points(check_gpu, rng, m, p, depth):
    queries, points = rng.normal(size=(m, depth)), rng.normal(size=(p, depth))
    check_gpu("nearest", queries, points, 0.5 * np.sum(points**2, axis=1))
    check_gpu("nearest", queries, points)
    check_gpu("soft_map_argmax", queries, points, rng.random(p))


@pytest.mark.parametrize("floor", [None, 0.05], ids=["squared", "relative"])
def test_candidates(check_gpu, rng, floor):
    points = [rng.random((count, 3)) for count in (50, 97)]
    dx, dy = (np.linalg.norm(each[:, None] - each, axis=2) for each in points)
    index, w = rng.integers(0, 50, size=(97, 33)), rng.random(97)
    check_gpu("distortion_batch", dx, dy, w, index, floor)
    check_gpu("map_distance", dx, w, index)


@pytest.mark.parametrize("one_sided", [False, True])
def test_alignment(check_gpu, rng, one_sided):
    band = band_of(70)
    inside = Reference().band_expand(np.ones(band.count), band)
    rotation = inside * rng.normal(size=(70, 70))
    grams = [values.T @ values for values in rng.normal(size=(3, 90, 70))]
    check_gpu("alignment", rotation, np.ascontiguousarray(rotation.T), *grams, band, one_sided, inside=band)


@pytest.mark.parametrize(("n", "r_x", "r_y"), [(1, 1, 1), (67, 6, 5), (80, 41, 64), (70, 3, 66)])
def test_distortion(check_gpu, rng, n, r_x, r_y):
    """The last has matrices that are larger than a tile."""
    left = np.linalg.qr(rng.normal(size=(n, r_x)))[0]
    core_x, core_y = (values + values.T for values in (rng.normal(size=(r, r)) / r for r in (r_x, r_y)))
    check_gpu("distortion", rng.normal(size=(n, r_y)) / n, core_y, left, core_x, np.ones(n))


def test_elementwise(check_gpu, rng):
    a, b, w = rng.normal(size=(37, 41)), rng.normal(size=(37, 41)), rng.random(37)
    w[::5] = 0
    check_gpu("add", a, b, scale_a=0.5, scale_b=-3.0)
    check_gpu("scale_rows", a, w)
    check_gpu("reciprocal", w)
    check_gpu("gather", a, rng.integers(0, 37, size=50))
    check_gpu("half_squares", a)
    check_gpu("transpose", a)
    check_gpu("total", rng.normal(size=9000), rng.random(9000))
    band = band_of(37)
    matrix = rng.normal(size=(37, 37))
    check_gpu("band_gather", matrix, band)
    check_gpu("band_expand", rng.normal(size=band.count), band)


@pytest.mark.usefixtures("opencl")
def test_neither_class_asks_for_a_device() -> None:
    """Both classes run on one device, and agree but for rounding."""
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(70, 31)), rng.normal(size=(31, 20))
    found: list[Any] = []
    for kind in ("cpu", "gpu"):
        kernels = Kernels(Device(kind=kind))  # type: ignore[arg-type]
        assert kernels.describe()["class"] == kind
        found.append(kernels.numpy(kernels.product(kernels.array(a), kernels.array(b))))
    np.testing.assert_allclose(*found, atol=1e-5)


@pytest.mark.usefixtures("opencl")
def test_a_gram_matrix_with_itself_is_symmetric(rng):
    """Tiles below the diagonal are mirrored, not computed."""
    kernels = Kernels(Device(kind="gpu"))
    values = rng.normal(size=(300, 131))
    a = kernels.array(values)
    gram = kernels.numpy(kernels.weighted_gram(a, a, kernels.array(np.ones(300))))
    np.testing.assert_array_equal(gram, gram.T)
    np.testing.assert_allclose(gram, values.T @ values, rtol=0, atol=2e-5 * 300)
