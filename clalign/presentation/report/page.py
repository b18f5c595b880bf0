"""Writes the page: template, style, program, library, facts and arrays in one HTML file."""

from __future__ import annotations

import base64
import html
import json
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clalign.correspondence import Correspondence
from clalign.evaluation.errors import Evaluation
from clalign.presentation.camera import Up
from clalign.presentation.html_page import file_text, fill, head, write_page
from clalign.presentation.picture import match_png
from clalign.presentation.report.payload import Payload, build_payload

_STYLE = "page.css"
_LIBRARY = "vendor/three.min.js"
_LICENCE = "vendor/LICENSE.three.txt"
_PROGRAM = ("data.js", "charts.js", "viewer.js", "sections.js", "page.js")
_TYPES = {"u1": "Uint8Array", "u2": "Uint16Array", "u4": "Uint32Array", "i4": "Int32Array", "f4": "Float32Array"}
_COMPRESSION = 6


def write_report(
    correspondence: Correspondence,
    path: str | Path,
    *,
    evaluation: Evaluation | None = None,
    functions: int | None = None,
    up: Up | None = None,
) -> None:
    """Write the page of a match: one self-contained HTML file that loads nothing from anywhere else.

    Positions are stored in 16 bits per coordinate and eigenfunctions in 8 bits per value, which is finer than the
    screen shows.

    Parameters
    ----------
    correspondence : the match.
    path : the file to write; an earlier one is replaced only when the new one is complete.
    evaluation : errors of the match, if a truth is known; adds the error curve.
    functions : how many eigenfunctions the page can show (default: as many as fit into about 8 MB).
    up : coordinate axis of the target that points up, if the guess from its extent is wrong.
    """
    payload = build_payload(correspondence, evaluation=evaluation, functions=functions, up=up)
    picture = match_png(correspondence, height=480, up=up)
    write_page(Path(path), _page(payload, picture))


def _page(payload: Payload, picture: bytes) -> str:
    title = html.escape(f"{payload.facts['source']['name']} → {payload.facts['target']['name']}")
    parts = {
        "head": head(title, _text(_STYLE), "data:"),
        "title": title,
        "licence": html.escape(_text(_LICENCE)),
        "picture": base64.b64encode(picture).decode("ascii"),
        # The facts hold names and messages from outside: no "<" may end the script element they stand in.
        "facts": json.dumps(payload.facts, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c"),
        "arrays": "\n".join(_array(name, values) for name, values in payload.arrays.items()),
        "library": _text(_LIBRARY),
        "program": "\n".join(_text(name) for name in _PROGRAM),
    }
    return fill(_text("page.html"), parts)


def _array(name: str, values: NDArray[np.generic]) -> str:
    kind = _TYPES[f"{values.dtype.kind}{values.dtype.itemsize}"]
    shape = ",".join(str(count) for count in values.shape)
    little_endian = values.astype(values.dtype.newbyteorder("<"), copy=False)
    text = base64.b64encode(zlib.compress(little_endian.tobytes(), _COMPRESSION)).decode("ascii")
    return f'<script type="text/plain" id="array-{name}" data-type="{kind}" data-shape="{shape}">{text}</script>'


def _text(name: str) -> str:
    return file_text(__package__, name)
