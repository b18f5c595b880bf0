"""A small software renderer: triangle meshes to images without a display or driver."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from clalign.mesh.topology import vertex_normals

_INK = (70, 70, 70)
_LOWEST_MARGIN = 12
"""Rows below which a word could not be read."""
_RAYS = 2
_BLOCK = 1 << 17
_DEPTH_LEVELS = 1 << 30
_KEY_LIGHT = np.array([-0.38, 0.52, 0.76])
_FILL_LIGHT = np.array([0.78, 0.10, 0.42])


def rasterise(
    vertices: NDArray[np.floating],
    faces: NDArray[np.integer],
    colours: NDArray[np.floating],
    size: tuple[int, int],
    *,
    background: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> NDArray[np.uint8]:
    """Draw one mesh, seen along the negative third axis, with smooth shading and hidden surfaces removed.

    Every pixel is the mean, in linear light, of `_RAYS` rays along each axis.

    Parameters
    ----------
    vertices : (n, 3) float, in pixels: x to the right, y upwards from the lower edge, z towards the viewer.
    faces : (m, 3) int.
    colours : (n, 3) float in [0, 1], sRGB.
    size : (width, height) of the image in pixels.
    background : sRGB colour where nothing is hit.

    Returns
    -------
    (height, width, 3) uint8.
    """
    width, height = size[0] * _RAYS, size[1] * _RAYS
    points = np.asarray(vertices, dtype=np.float64) * _RAYS
    scene = _scene(points, np.asarray(faces, dtype=np.int64), np.asarray(colours, dtype=np.float32), width, height)
    empty = _linear(np.asarray(background, dtype=np.float32))
    image = np.empty((size[1], size[0], 3), dtype=np.uint8)
    # Rows of the finished image at a time: a picture that a shape fills would take a gigabyte at once.
    step = max(1, _BLOCK // (width * _RAYS))
    for first in range(0, size[1], step):
        last = min(first + step, size[1])
        lit = _lit_rows(scene, first * _RAYS, last * _RAYS, width, empty)
        blocks = lit.reshape(last - first, _RAYS, size[0], _RAYS, 3).mean(axis=(1, 3))
        image[first:last] = np.rint(_encoded(blocks) * 255.0)
    return np.ascontiguousarray(image[::-1])


def write_png(path: str | Path, image: NDArray[np.uint8]) -> None:
    """Write an (height, width, 3) uint8 image as a PNG file."""
    Image.fromarray(image).save(path, "png")


def png_bytes(image: NDArray[np.uint8]) -> bytes:
    """Return an (height, width, 3) uint8 image in PNG format."""
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, "png")
    return stream.getvalue()


def with_word(image: NDArray[np.uint8], word: str, margin: int) -> NDArray[np.uint8]:
    """Return a picture with a word in the middle of its lower margin; without it where it does not fit.

    Parameters
    ----------
    image : (height, width, 3) uint8.
    margin : free rows below what is drawn.
    """
    height, width, _ = image.shape
    font = ImageFont.load_default(max(0.6 * margin, 1))
    if margin < _LOWEST_MARGIN or font.getlength(word) > width:
        return image
    lettered = Image.fromarray(image)
    ImageDraw.Draw(lettered).text((width / 2, height - margin / 2), word, fill=_INK, font=font, anchor="mm")
    return np.asarray(lettered)


@dataclass(frozen=True)
class _Scene:
    """What drawing reads of a mesh, in pixels of the image before averaging.

    Attributes
    ----------
    faces : (m, 3) vertices of the faces.
    planes : (m, 2, 3), see `_weight_planes`.
    low, high : (m, 2) first pixel of each face's bounding box and the one after its last, as column and row.
    depths : (n,) from 0 to `_DEPTH_LEVELS` - 1, the nearest being the largest.
    albedo, normals : (n, 3) linear colour and unit normal of each vertex.
    """

    faces: NDArray[np.int64]
    planes: NDArray[np.float64]
    low: NDArray[np.int64]
    high: NDArray[np.int64]
    depths: NDArray[np.float64]
    albedo: NDArray[np.float32]
    normals: NDArray[np.float32]


def _scene(
    points: NDArray[np.float64], faces: NDArray[np.int64], colours: NDArray[np.float32], width: int, height: int
) -> _Scene:
    corners = points[faces][:, :, :2]
    depths = points[:, 2] - points[:, 2].min(initial=0.0)
    depths *= (_DEPTH_LEVELS - 1) / (depths.max(initial=0.0) or 1.0)
    return _Scene(
        faces=faces,
        planes=_weight_planes(points, faces),
        low=np.clip(np.ceil(corners.min(axis=1) - 0.5), 0, (width, height)).astype(np.int64),
        high=np.clip(np.floor(corners.max(axis=1) + 0.5), 0, (width, height)).astype(np.int64),
        depths=depths,
        albedo=_linear(colours),
        normals=vertex_normals(points, faces).astype(np.float32),
    )


def _weight_planes(points: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return (m, 2, 3): the second and third barycentric coordinate of each face as a plane over (x, y, 1).

    A face seen edge-on gets planes that are -1 everywhere.
    """
    a, b, c = (points[faces[:, corner], :2] for corner in range(3))
    (bx, by), (cx, cy) = (b - a).T, (c - a).T
    area = bx * cy - by * cx
    flat = np.abs(area) < 1e-12
    planes = np.stack([np.stack([cy, -cx], axis=1), np.stack([-by, bx], axis=1)], axis=1)
    planes /= np.where(flat, 1.0, area)[:, None, None]
    offsets = -np.einsum("fwc,fc->fw", planes, a)
    planes = np.concatenate([planes, offsets[:, :, None]], axis=2)
    planes[flat] = (0.0, 0.0, -1.0)
    return np.asarray(planes)


def _lit_rows(scene: _Scene, first: int, last: int, width: int, background: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the linear colours ((last - first) * width, 3) of some rows, counted from the lower edge."""
    face_of_pixel = _visible_faces(scene, first, last, width)
    lit = np.empty((face_of_pixel.size, 3), dtype=np.float32)
    lit[:] = background
    hit = np.flatnonzero(face_of_pixel >= 0)
    owner = face_of_pixel[hit]
    triangles = scene.faces[owner]
    place = np.stack([hit % width + 0.5, hit // width + first + 0.5, np.ones(hit.size)], axis=1)
    upper = np.einsum("pwc,pc->pw", scene.planes[owner], place)
    weights = np.concatenate([1.0 - upper.sum(axis=1, keepdims=True), upper], axis=1).astype(np.float32)
    lit[hit] = _shade(_blend(weights, scene.albedo, triangles), _blend(weights, scene.normals, triangles))
    return lit


def _visible_faces(scene: _Scene, first: int, last: int, width: int) -> NDArray[np.int64]:
    """Return for every pixel of some rows (row-major from the lower edge) the frontmost face at its centre, or -1."""
    buffer = np.full(width * (last - first), -1, dtype=np.int64)
    columns = np.maximum(scene.high[:, 0] - scene.low[:, 0], 0)
    lowest = np.maximum(scene.low[:, 1], first)
    counts = columns * np.maximum(np.minimum(scene.high[:, 1], last) - lowest, 0)
    order = np.flatnonzero(counts)
    block_of = np.cumsum(counts[order]) // _BLOCK
    for block in np.split(order, np.flatnonzero(np.diff(block_of)) + 1):
        repeats = counts[block]
        planes = scene.planes[block]
        place = np.arange(repeats.sum()) - np.repeat(np.cumsum(repeats) - repeats, repeats)
        row, column = np.divmod(place, np.repeat(columns[block], repeats))
        x = column + np.repeat(scene.low[block, 0], repeats)
        y = row + np.repeat(lowest[block], repeats)
        second, third = (
            np.repeat(planes[:, weight, 0], repeats) * (x + 0.5)
            + np.repeat(planes[:, weight, 1], repeats) * (y + 0.5)
            + np.repeat(planes[:, weight, 2], repeats)
            for weight in range(2)
        )
        kept = np.flatnonzero((second >= 0) & (third >= 0) & (second + third <= 1))
        owner = np.repeat(block, repeats)[kept]
        front = scene.depths[scene.faces[owner]]
        level = front[:, 0] + second[kept] * (front[:, 1] - front[:, 0]) + third[kept] * (front[:, 2] - front[:, 0])
        # Depth above, face below: one integer maximum finds the frontmost face, whatever the order of drawing.
        key = (np.clip(level, 0, _DEPTH_LEVELS - 1).astype(np.int64) << 32) | owner
        np.maximum.at(buffer, (y[kept] - first) * width + x[kept], key)
    return np.where(buffer >= 0, buffer & 0xFFFFFFFF, -1)


def _blend(
    weights: NDArray[np.float32], values: NDArray[np.float32], triangles: NDArray[np.int64]
) -> NDArray[np.float32]:
    blended = np.zeros((len(weights), values.shape[1]), dtype=np.float32)
    for corner in range(3):
        blended += weights[:, corner, None] * values[triangles[:, corner]]
    return blended


def _shade(albedo: NDArray[np.float32], normals: NDArray[np.float32]) -> NDArray[np.float32]:
    """Light a surface: ambient from above, a key and a fill light (Lambert), a faint highlight; both sides alike."""
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-6)
    normals = np.where(normals[:, 2:] < 0, -normals, normals)
    key = _KEY_LIGHT / np.linalg.norm(_KEY_LIGHT)
    fill = _FILL_LIGHT / np.linalg.norm(_FILL_LIGHT)
    halfway = key + np.array([0.0, 0.0, 1.0])
    halfway /= np.linalg.norm(halfway)
    diffuse = np.maximum(normals @ key, 0.0) * 0.72 + np.maximum(normals @ fill, 0.0) * 0.16
    ambient = 0.25 + 0.09 * normals[:, 1]
    highlight = 0.06 * np.maximum(normals @ halfway, 0.0) ** 24
    lit = albedo * (diffuse + ambient)[:, None] + highlight[:, None]
    return np.asarray(np.clip(lit, 0.0, 1.0), dtype=np.float32)


def _linear(encoded: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(
        np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4), dtype=np.float32
    )


def _encoded(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    clipped = np.clip(linear, 0.0, 1.0)
    return np.where(clipped <= 0.0031308, clipped * 12.92, 1.055 * clipped ** (1 / 2.4) - 0.055)
