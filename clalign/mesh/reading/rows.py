"""Rows of numbers in text files; the first row that is none is named by its number."""

from __future__ import annotations

import codecs
import re

import numpy as np
from numpy.typing import NDArray

from clalign.mesh.reading.common import FormatError, fan, shown


def text_lines(content: bytes) -> list[bytes]:
    """Return the lines without comments, blanks and byte-order mark."""
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        content = content.decode("utf-16", errors="replace").encode()
    content = content.removeprefix(b"\xef\xbb\xbf")
    if b"#" in content:
        content = re.sub(rb"#[^\r\n]*", b"", content)
    return [line for line in (raw.strip() for raw in content.splitlines()) if line]


def same_width(rows: list[list[bytes]]) -> None:
    """Refuse a row unlike the first: with wrong counts in the header, faces would be read as vertices."""
    for number, words in enumerate(rows):
        if len(words) != len(rows[0]):
            raise FormatError(
                f"vertex {number} is given as {shown(b' '.join(words))}, {len(words)} numbers where vertex 0 has "
                f"{len(rows[0])}; the counts in the header may be wrong; export it again"
            )


def numbers(rows: list[list[bytes]], width: int, wanted: str) -> NDArray[np.float64]:
    """(n, width) numbers from rows of as many words; names the first row that is something else."""
    try:
        return np.array(rows, dtype=np.float64).reshape(len(rows), width)
    except ValueError:
        pass
    for number, row in enumerate(rows):
        if not holds_numbers(row, width):
            raise misgiven(number, row, wanted)
    raise FormatError("its vertex positions are not numbers; export it again")


def holds_numbers(words: list[bytes], wanted: int) -> bool:
    """Tell whether all words are numbers, and at least as many as wanted."""
    try:
        return len([float(word) for word in words]) >= wanted
    except ValueError:
        return False


def misgiven(number: int, words: list[bytes], wanted: str) -> FormatError:
    """Return the sentence on a vertex that is not given as numbers."""
    comma = any(re.fullmatch(rb"[+-]?\d+,\d+(?:[eE][+-]?\d+)?", word) for word in words)
    said = f"vertex {number} is given as {shown(b' '.join(words))}"
    if comma:
        return FormatError(f"{said}: expected {wanted} numbers with decimal points, not commas; export it again")
    return FormatError(f"{said}: expected {wanted} numbers; mend that line, or export the mesh again")


def corners(words: list[bytes], number: int) -> list[bytes]:
    """Return the vertex numbers of a face that is given as their count and themselves."""
    size = integer(words[0], "face", number) if words else 0
    if not 3 <= size < len(words):
        raise FormatError(
            f"face {number} is given as {shown(b' '.join(words))}: expected a count of 3 or more and as many "
            "numbers; mend that line, or export the mesh again"
        )
    return words[1 : size + 1]


def triangles(polygons: list[list[bytes]]) -> NDArray[np.int64]:
    """(m, 3) numbers from the words of each polygon, cut into a fan of triangles around its first corner."""
    sizes = np.array([len(polygon) for polygon in polygons], dtype=np.int64)
    try:
        flat = np.array([word for polygon in polygons for word in polygon]).astype(np.int64)
    except (ValueError, OverflowError):
        flat = np.array([integer(w, "face", f) for f, polygon in enumerate(polygons) for w in polygon], dtype=np.int64)
    return fan(sizes, flat)


def integer(word: bytes, what: str, number: int) -> int:
    """Return one vertex number, or raise the reason why the word is none."""
    if not re.fullmatch(rb"[+-]?\d{1,18}", word):
        raise FormatError(
            f"{what} {number} contains {shown(word)} where a vertex number is expected; "
            "mend that line, or export the mesh again"
        )
    return int(word)
