"""Writes the page: template, style, program, library, facts and arrays in one HTML file."""

from __future__ import annotations

import base64
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clalign.correspondence import Correspondence
from clalign.evaluation.errors import Evaluation
from clalign.mesh.front import Up
from clalign.presentation.html_page import write_page
from clalign.presentation.picture import match_png
from clalign.presentation.report.payload import build_payload

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
    facts, arrays = build_payload(correspondence, evaluation=evaluation, functions=functions, up=up)
    write_page(
        Path(path),
        "report/page.html",
        title=f"{correspondence.source.name} → {correspondence.target.name}",
        picture=base64.b64encode(match_png(correspondence, height=480, up=up)).decode("ascii"),
        facts=facts,
        arrays=[_stored(name, values) for name, values in arrays.items()],
    )


def _stored(name: str, values: NDArray[np.generic]) -> dict[str, object]:
    kind = _TYPES[f"{values.dtype.kind}{values.dtype.itemsize}"]
    packed = zlib.compress(values.astype(values.dtype.newbyteorder("<"), copy=False).tobytes(), _COMPRESSION)
    return {"name": name, "type": kind, "shape": values.shape, "text": base64.b64encode(packed).decode("ascii")}
