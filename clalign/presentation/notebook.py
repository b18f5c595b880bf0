"""How a result shows itself in a notebook."""

from __future__ import annotations

import base64
import math

from clalign.correspondence import Correspondence
from clalign.presentation.html_page import rendered
from clalign.presentation.picture import match_png
from clalign.storage.files import visible


def notebook_html(correspondence: Correspondence) -> str:
    """Return a fragment of HTML with the picture of a match and what to know before trusting it."""
    source, target = correspondence.source, correspondence.target
    rows = [
        ("source", f"{source.name}, {source.n_vertices:,} vertices"),
        ("target", f"{target.name}, {target.n_vertices:,} vertices"),
        ("confidence", _known(f"{correspondence.confidence:.2f} of 1")),
        ("orientation kept", _known(f"{correspondence.orientation:+.2f}")),
        ("device", correspondence.device),
        ("time", f"{math.fsum(correspondence.timings.values()):.1f} s"),
    ]
    rows += [("warning", text) for text in correspondence.warnings]
    picture = base64.b64encode(match_png(correspondence, height=360)).decode("ascii")
    page = rendered("notebook.html", source=source, target=target, rows=rows, picture=picture)
    return visible(page)


def _known(text: str) -> str:
    return "–" if "nan" in text else text
