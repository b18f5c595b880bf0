"""``clalign match SOURCE TARGET``: match two mesh files and write the result folder."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from clalign.cli.evaluate import read_truth
from clalign.cli.job import Truths, add_job_arguments, run_job

if TYPE_CHECKING:
    from clalign.mesh.mesh import Mesh

DEFAULT_FOLDER = Path("clalign-result")

_DESCRIPTION = """\
Find for every vertex of SOURCE the corresponding vertex of TARGET, and the other way round. Meshes are OFF, PLY, OBJ
or STL files of one connected surface each. The result folder gets both maps as text (line i: 0-based vertex of the
other file), result.npz, result.json, match.png and report.html (open it in a browser); it is written wholly or not at
all.
"""

_EPILOG = """\
examples:
  clalign match cat0.off cat7.off
  clalign match a.ply b.ply --out a-to-b --truth identity --seed 1
  clalign match a.ply b.ply --truth points-on-a.txt points-on-b.txt
  clalign match a.ply b.ply --preset fast --set spectrum.basis=80 --set alignment.weight=50
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``match`` to the program."""
    parser = subparsers.add_parser("match", help="match two mesh files", description=_DESCRIPTION, epilog=_EPILOG)
    parser.add_argument("source", metavar="SOURCE", type=Path, help="mesh whose vertices are mapped")
    parser.add_argument("target", metavar="TARGET", type=Path, help="mesh that they are mapped to")
    add_job_arguments(parser, DEFAULT_FOLDER)
    parser.add_argument("--force", action="store_true", help="replace an earlier result in DIR")
    parser.add_argument(
        "--truth",
        metavar="FILE",
        nargs="+",
        action="extend",
        default=[],
        help="after the meshes; measure the error: FILE holds the target vertex (0-based) of source vertex i in line "
        "i, or is the word 'identity'; with two files, line i of both names the same point on source and target",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Match the two files of the command line."""

    def truths(source: Mesh, target: Mesh) -> Truths | None:
        return Truths(read_truth(args.truth, None, source, target)) if args.truth else None

    return run_job(args.source, args.target, args, truths, force=args.force)
