"""``clalign bench``: benchmarks of accuracy, of a whole collection, and of speed."""

from __future__ import annotations

import argparse

from clalign.cli.bench.accuracy import add_parser as add_accuracy
from clalign.cli.bench.accuracy import add_study
from clalign.cli.bench.collection import add_parser as add_collection
from clalign.cli.bench.confidence import add_parser as add_confidence
from clalign.cli.bench.register import add_parser as add_register
from clalign.cli.bench.signs import add_parser as add_signs
from clalign.cli.bench.speed import add_forecast, add_kernels, add_pair, add_scale


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``bench`` with all its subcommands to the program."""
    parser = subparsers.add_parser(
        "bench", help="run a benchmark", description="Run a benchmark: accuracy on a data set, or speed."
    )
    inner = parser.add_subparsers(title="benchmarks", metavar="BENCHMARK", required=True)
    for add in (
        add_accuracy,
        add_study,
        add_confidence,
        add_signs,
        add_register,
        add_collection,
        add_kernels,
        add_pair,
        add_scale,
        add_forecast,
    ):
        add(inner)
