"""``clalign bench``: benchmarks, each a module with ``add_parser(subparsers)`` and ``run(args) -> int``."""

from __future__ import annotations

import argparse

from clalign.cli.bench import accuracy as bench_accuracy
from clalign.cli.bench import collection as bench_collection
from clalign.cli.bench import forecast as bench_forecast
from clalign.cli.bench import kernels as bench_kernels
from clalign.cli.bench import pair as bench_pair
from clalign.cli.bench import scale as bench_scale
from clalign.cli.bench import study as bench_study

SUBCOMMANDS = (bench_accuracy, bench_study, bench_collection, bench_kernels, bench_pair, bench_scale, bench_forecast)


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``bench`` with all its subcommands to the program."""
    parser = subparsers.add_parser(
        "bench", help="run a benchmark", description="Run a benchmark: accuracy on a data set, or speed."
    )
    inner = parser.add_subparsers(title="benchmarks", metavar="BENCHMARK", required=True)
    for subcommand in SUBCOMMANDS:
        subcommand.add_parser(inner)
