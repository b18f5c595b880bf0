"""``clalign bench collection PATH``: a set of shapes with one worker, two, and a scheduler; errors before and after."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from clalign.cli.bench.common import add_option_arguments, add_output_arguments
from clalign.cli.match import option_changes
from clalign.cli.terminal import Terminal
from clalign.options import Options
from clalign.storage.files import make_folder, write_text

if TYPE_CHECKING:
    from clalign.collection.result import Collection

_DESCRIPTION = """\
Match all pairs of a folder of shapes with one local worker, with two, and with two workers of a scheduler in other
processes, and say how long each takes and whether the maps are the same bit for bit; match a star of the shapes and
derive the other pairs; and measure errors and flips before and after maps are made consistent. Truth lies beside the
meshes as in the humans: X.truth.txt, or equal numbering, and mirror.txt.
"""

_EPILOG = """\
The folder DIR gets a collection a run, summary.md and summary.json. Run the same command again to go on after an
interruption; the seconds of a run that was interrupted are not shown.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``collection`` to the benchmarks."""
    parser = subparsers.add_parser(
        "collection",
        help="a whole set of shapes: seconds, equality of maps, consistency",
        description=_DESCRIPTION,
        epilog=_EPILOG,
    )
    parser.add_argument("path", metavar="PATH", type=Path, help="folder of meshes, or a file that lists them")
    parser.add_argument("--out", metavar="DIR", type=Path, default=Path("clalign-bench-collection"))
    parser.add_argument(
        "--runs", metavar="NAMES", default="one,two,scheduler,star", help="also: tree (default: %(default)s)"
    )
    add_option_arguments(parser)
    parser.add_argument("--points", metavar="N", type=int, default=500, help="points measured a pair")
    add_output_arguments(parser, "collection")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Make the runs and write the tables; 1 when maps differ between runs or a pair has none."""
    from clalign.benchmark import collections
    from clalign.benchmark.table import update_file

    options = Options.preset(args.preset).replace(option_changes(args))
    names = collections.run_names(args.runs)
    terminal = Terminal(quiet=args.quiet, as_json=args.json)
    make_folder(args.out)
    made: dict[str, Collection] = {}
    times, errors, failures = [], [], 0
    # Of the runs that match all pairs, the maps of the first are measured, and those of the others compared with them.
    first = next((name for name in names if name not in collections.FEW_PAIRS), None)
    for name in names:
        terminal.note(f"run: {name}")
        with terminal.progress() as progress:
            made[name], seconds = collections.run_one(name, args.path, args.out, options, progress)
        times.append(seconds)
        failures += len(made[name].failures)
        for failure in made[name].failures:
            terminal.warn(f"{name}: {failure}")
        if name == first or name in collections.FEW_PAIRS:
            errors += collections.error_rows(name, made[name], args.points, args.seed)
    differing = {
        name: len(collections.different_maps(made[first], made[name]))
        for name in made
        if first is not None and name != first and name not in collections.FEW_PAIRS
    }
    costs = collections.costs(made[first or names[0]])
    text = "\n\n".join([collections.times_table(times, differing), collections.errors_table(errors), costs.table()])
    document = {
        "times": [asdict(entry) for entry in times],
        "errors": [asdict(entry) for entry in errors],
        "different_maps": differing,
    }
    write_text(args.out / "summary.md", text + "\n")
    write_text(args.out / "summary.json", json.dumps(document, indent=1) + "\n")
    terminal.say(text)
    terminal.say("errors: mean geodesic error of each map x 100 / sqrt(area)")
    terminal.document(document)
    for page in args.update:
        update_file(page, args.section, text)
    return 1 if any(differing.values()) or failures else 0
