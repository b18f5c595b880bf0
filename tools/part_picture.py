"""Draw the picture of the page on parts: the bundled source, cut by a plane, on the bundled target.

``python tools/part_picture.py [FILE]``; FILE is docs/images/part.png.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import clalign
from clalign.benchmark.cut import KINDS
from clalign.benchmark.parts import taken
from clalign.data import bundled_pair
from clalign.mesh.mesh import load_mesh
from clalign.presentation.picture import save_match_picture

SHARE, SEED = 0.4, 2


def main() -> None:
    """Cut, match and draw."""
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[1] / "docs" / "images" / "part.png"
    pair = bundled_pair()
    part, _ = taken(load_mesh(pair.source), KINDS["cuts"], SHARE, np.random.default_rng(SEED))
    save_match_picture(clalign.match(part, load_mesh(pair.target)), path, height=600)


if __name__ == "__main__":
    main()
