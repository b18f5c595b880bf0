"""A pair of posed humans that comes with the package, for the demo and the tests."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple


class BundledPair(NamedTuple):
    """Where the files of the pair lie.

    source, target : PLY meshes of one person in two poses, 6,890 vertices, numbered independently.
    truth : text, line i holds the 0-based target vertex of source vertex i.
    mirrored : the same for the left-right mirror image of the truth, the error that a matcher makes most easily.
    """

    source: Path
    target: Path
    truth: Path
    mirrored: Path


def bundled_pair() -> BundledPair:
    """Return the paths of the bundled pair's files."""
    folder = Path(__file__).resolve().parent
    return BundledPair(
        source=folder / "human_source.ply",
        target=folder / "human_target.ply",
        truth=folder / "human_truth.txt",
        mirrored=folder / "human_truth_mirrored.txt",
    )
