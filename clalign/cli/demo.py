"""``clalign demo``: match the bundled pair of humans and compare the outcome with the truth."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from clalign.cli.job import Truths, add_job_arguments, run_job
from clalign.data import bundled_pair

if TYPE_CHECKING:
    from clalign.mesh.mesh import Mesh

DEFAULT_FOLDER = Path("clalign-demo")


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``demo`` to the program."""
    parser = subparsers.add_parser(
        "demo",
        help="match the bundled pair and compare it with the truth",
        description="Match one person in two poses, bundled with clalign, and compare the map with the truth and "
        "with its mirror image. An earlier result of the demo in DIR is replaced.",
    )
    add_job_arguments(parser, DEFAULT_FOLDER)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Match the bundled pair."""
    from clalign.evaluation.truth import read_index_truth

    pair = bundled_pair()

    def truths(source: Mesh, target: Mesh) -> Truths:
        truth, mirrored = (
            read_index_truth(path, source_count=source.file_count, target_count=target.file_count)
            for path in (pair.truth, pair.mirrored)
        )
        return Truths(truth, mirrored)

    return run_job(pair.source, pair.target, args, truths, force=True)
