"""Draw the pictures of the documentation with ``clalign figures``; those that are there already are kept.

``python docs/gallery.py`` draws the bundled pair (some minutes: Fig. 5 and 7 run the method as printed);
``--quick`` draws the same with few eigenfunctions and one outer iteration. Meshes and a truth of one's own may be
named.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from clalign.cli.main import main as clalign
from clalign.presentation.figures.gallery import PLANS

IMAGES = Path(__file__).resolve().parent / "figures" / "images"
QUICK = {
    "spectrum.basis": 40,
    "spectrum.refinement": 60,
    "spectrum.scale_invariant": 60,
    "geodesics.factor_samples": 40,
    "geodesics.search_samples": 400,
    "alignment.samples": 400,
    "alignment.outer_iterations": 1,
    "alignment.iterations": 6,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw what is missing and return the status of ``clalign figures``."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", metavar="MESH", nargs="*", help="source and target (default: the bundled pair)")
    parser.add_argument("--truth", metavar="FILE", nargs="+", default=[], help="as of 'clalign figures'")
    parser.add_argument("--out", metavar="DIR", type=Path, default=IMAGES, help="default: %(default)s")
    parser.add_argument("--quick", action="store_true", help="small settings")
    args = parser.parse_args(arguments)
    missing = [number for number in PLANS if not (args.out / f"figure-{number}.png").is_file()]
    if not missing:
        return 0
    command = ["figures", *args.meshes, "--which", ",".join(missing), "--out", str(args.out)]
    if args.truth:
        command += ["--truth", *args.truth]
    if args.quick:
        command += [word for name, value in QUICK.items() for word in ("--set", f"{name}={value}")]
        command += ["--height", "80"]
    return clalign(command)


if __name__ == "__main__":
    sys.exit(main())
