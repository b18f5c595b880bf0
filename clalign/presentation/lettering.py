"""The few words that a picture carries, drawn without a font."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Rows of pixels from above; the last two of nine reach below the line.
_GLYPHS = {
    "a": (0, 0, 0b01110, 0b00001, 0b01111, 0b10001, 0b01111, 0, 0),
    "c": (0, 0, 0b01110, 0b10000, 0b10000, 0b10001, 0b01110, 0, 0),
    "e": (0, 0, 0b01110, 0b10001, 0b11111, 0b10000, 0b01110, 0, 0),
    "g": (0, 0, 0b01111, 0b10001, 0b10001, 0b10001, 0b01111, 0b00001, 0b01110),
    "o": (0, 0, 0b01110, 0b10001, 0b10001, 0b10001, 0b01110, 0, 0),
    "r": (0, 0, 0b10110, 0b11001, 0b10000, 0b10000, 0b10000, 0, 0),
    "s": (0, 0, 0b01111, 0b10000, 0b01110, 0b00001, 0b11110, 0, 0),
    "t": (0b01000, 0b01000, 0b11110, 0b01000, 0b01000, 0b01001, 0b00110, 0, 0),
    "u": (0, 0, 0b10001, 0b10001, 0b10001, 0b10011, 0b01101, 0, 0),
}
_WIDTH = 5
HEIGHT = 9
"""Of a line, in pixels of the smallest size."""
_INK = 70


def word_mask(word: str, scale: int = 1) -> NDArray[np.bool_]:
    """Return (HEIGHT · scale, width) bool, the pixels of a word; only letters that some picture needs are known."""
    columns = []
    for letter in word:
        rows = np.array(_GLYPHS[letter])[:, None]
        columns += [(rows >> np.arange(_WIDTH - 1, -1, -1)) & 1, np.zeros((HEIGHT, 1), dtype=np.int64)]
    mask = np.concatenate(columns[:-1], axis=1).astype(bool)
    return np.asarray(np.kron(mask, np.ones((scale, scale), dtype=bool)))


def with_word(image: NDArray[np.uint8], word: str, margin: int) -> NDArray[np.uint8]:
    """Return a picture with a word in the middle of its lower margin; without it where it does not fit.

    Parameters
    ----------
    image : (height, width, 3) uint8.
    margin : free rows below what is drawn.
    """
    # Three rows stay free above and below at the smallest size.
    scale = margin // (HEIGHT + 3)
    if not scale:
        return image
    mask = word_mask(word, scale)
    height, width = mask.shape
    if width > image.shape[1]:
        return image
    lettered = image.copy()
    top, left = image.shape[0] - (margin + height) // 2, (image.shape[1] - width) // 2
    lettered[top : top + height, left : left + width][mask] = _INK
    return lettered
