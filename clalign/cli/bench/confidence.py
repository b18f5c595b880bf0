"""``clalign bench confidence``: the share of right maps against the confidence, over pairs of every kind."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from clalign.cli.bench.accuracy import add_run_arguments, limited, run_methods
from clalign.cli.bench.common import add_option_arguments, add_output_arguments
from clalign.cli.match import option_changes
from clalign.cli.terminal import EXIT_INTERRUPTED, Terminal
from clalign.storage.files import write_text

_DESCRIPTION = """\
Match people as they are, with other proportions and with damages, animals, and bodies with symmetries, and say how many
maps are right at which confidence. The confidence is told before a map is refined, so that the search is enough
(--method search-only); right are maps that bring nine of ten points to within 0.2 sqrt(area) of the truth.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``confidence`` to the benchmarks."""
    parser = subparsers.add_parser(
        "confidence", help="the share of right maps against the confidence", description=_DESCRIPTION
    )
    parser.add_argument("path", metavar="PATH", type=Path, help="folder in the layout of the humans")
    parser.add_argument("--animals", metavar="DIR", type=Path, help="folder of frames, or of such folders")
    parser.add_argument("--method", default="search-only", help="as of the other benchmarks (default: %(default)s)")
    add_option_arguments(parser, preset=False)
    add_run_arguments(parser, "clalign-bench-confidence")
    add_output_arguments(parser, "confidence")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the pairs, and show and write the table; 1 when a pair has no map."""
    from clalign.benchmark.confidence import confidence_layouts, confidence_table, verdicts
    from clalign.benchmark.methods import named_methods
    from clalign.benchmark.runner import Measurement
    from clalign.benchmark.table import failures, update_file

    terminal = Terminal(quiet=args.quiet, as_json=args.json)
    layouts = limited(confidence_layouts(args.path, args.animals), args, terminal)
    methods = named_methods([args.method], option_changes(args))
    finished = run_methods(layouts, methods, Measurement(seed=args.seed), args, terminal)
    if finished is None:
        return EXIT_INTERRUPTED
    said = verdicts(finished.records)
    text = "\n".join([confidence_table(finished.records), "", *(f"- {each}" for each in said)])
    write_text(args.out / "confidence.md", text + "\n")
    write_text(args.out / "confidence.json", json.dumps([asdict(each) for each in finished.records], indent=1) + "\n")
    for failure in failures(finished.records):
        terminal.warn(failure)
    terminal.say(text)
    terminal.document({"verdicts": said, "records": [asdict(each) for each in finished.records]})
    for page in args.update:
        update_file(page, args.section, text)
    return 1 if any(record.failed for record in finished.records) or not finished.records else 0
