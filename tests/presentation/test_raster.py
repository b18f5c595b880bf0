from __future__ import annotations

import io
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import shapes

from clalign.presentation.raster import png_bytes, rasterise, write_png


def _square(low: float, high: float, depth: float) -> tuple[np.ndarray, np.ndarray]:
    vertices = np.array([[low, low, depth], [high, low, depth], [high, high, depth], [low, high, depth]])
    return vertices, np.array([[0, 1, 2], [0, 2, 3]])


def test_covers_exactly_the_pixels_of_a_square() -> None:
    vertices, faces = _square(10, 30, 0)
    image = rasterise(vertices, faces, np.zeros((4, 3)), (40, 50))
    drawn = (image < 200).all(axis=2)
    rows, columns = np.nonzero(drawn)
    assert image.shape == (50, 40, 3)
    # y points upwards from the lower edge: rows 10 to 29 from below are rows 20 to 39 from above.
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (20, 39, 10, 29)
    assert drawn.sum() == 20 * 20
    assert (image[~drawn] == 255).all()


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_nearer_surface_hides_the_farther_whatever_the_order(order: tuple[int, int]) -> None:
    far, faces = _square(0, 40, -5.0)
    near, _ = _square(10, 30, 5.0)
    vertices = np.concatenate([far, near])
    colours = np.repeat([[0.9, 0.0, 0.0], [0.0, 0.0, 0.9]], 4, axis=0)
    both = np.concatenate([faces + 4 * index for index in order])
    image = rasterise(vertices, both, colours, (40, 40)).astype(int)
    assert image[20, 20, 2] > 100 > image[20, 20, 0]
    assert image[2, 2, 0] > 100 > image[2, 2, 2]


def test_face_order_and_corner_order_do_not_matter(rng: np.random.Generator) -> None:
    vertices, faces = shapes.bumpy_sphere(2)
    placed = 30 * vertices / np.abs(vertices).max() + (40, 40, 0)
    colours = rng.uniform(size=(len(vertices), 3))
    first = rasterise(placed, faces, colours, (80, 80))
    rolled = np.roll(rng.permutation(faces), 1, axis=1)
    assert np.abs(first.astype(int) - rasterise(placed, rolled, colours, (80, 80))).max() <= 2


def test_lit_from_the_front_and_darker_at_the_rim() -> None:
    vertices, faces = shapes.icosphere(4)
    image = rasterise(90 * vertices + (100, 100, 0), faces, np.full(vertices.shape, 0.7), (200, 200)).astype(int)
    covered = (image < 250).all(axis=2).mean()
    assert covered == pytest.approx(np.pi * 90**2 / 200**2, rel=0.01)
    assert image[70, 80].mean() > image[150, 150].mean() + 40


def test_degenerate_outside_and_empty_input() -> None:
    line = np.array([[5.0, 5, 0], [15, 5, 0], [25, 5, 0], [-900, -900, 3], [-800, -900, 3], [-900, -800, 3]])
    image = rasterise(line, np.array([[0, 1, 2], [3, 4, 5]]), np.zeros((6, 3)), (30, 20))
    assert (image == 255).all()
    assert (rasterise(line, np.zeros((0, 3), dtype=int), np.zeros((6, 3)), (30, 20)) == 255).all()


def test_png_is_read_back_by_another_library(tmp_path: Path, rng: np.random.Generator) -> None:
    from matplotlib import image as plt

    image = rng.integers(0, 256, size=(7, 11, 3), dtype=np.uint8)
    write_png(tmp_path / "a.png", image)
    read = plt.imread(tmp_path / "a.png")
    assert np.array_equal(np.rint(read[..., :3] * 255).astype(np.uint8), image)
    assert np.array_equal(np.rint(plt.imread(io.BytesIO(png_bytes(image)))[..., :3] * 255), image)


def test_a_picture_that_a_shape_fills_needs_little_memory() -> None:
    vertices, faces = shapes.icosphere(3)
    tracemalloc.start()
    try:
        image = rasterise(vertices * 700 + 700, faces, np.full((len(vertices), 3), 0.5), (1400, 1400))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    covered = (image != 255).any(axis=2)
    assert covered.mean() == pytest.approx(np.pi / 4, abs=0.01)
    # The image is 6 MB; one double for each of the 7.8 million rays would be 63 MB.
    assert peak < 60e6
