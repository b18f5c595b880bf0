"""``clalign bench study PATH --of NAME``: tables over values that were fixed by hand."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from clalign.benchmark.study import STUDIES, Study, methods_of, study_of, study_table
from clalign.cli.bench.common import (
    EXIT_INTERRUPTED,
    add_option_arguments,
    add_output_arguments,
    add_run_arguments,
    limited,
    run_methods,
)
from clalign.cli.job import option_changes
from clalign.cli.terminal import Terminal
from clalign.errors import OptionError
from clalign.options import Options

if TYPE_CHECKING:
    from clalign.benchmark.layouts import Layout
    from clalign.benchmark.runner import Run

_DESCRIPTION = """\
Vary one choice of the method over the pairs of a folder in the layout of the humans, all else as in the preset, and
write a table with the default in bold: weight (lambda), band (a, b and how the funnel is read), xi (the metric), sizes
(d and k), samples (N, and vertices of the losses), rounds, or any option by its name.
"""

_EPILOG = """\
The folder DIR gets pairs.csv, curves.csv and study-NAME.md. The last step of the default read-out, two steps without
the mask, evens out much of what a choice does to R: --set readout.steps=0 shows R itself.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``study``."""
    parser = subparsers.add_parser(
        "study",
        help="tables over one choice of the method: lambda, the funnel, xi, sizes, or any option",
        description=_DESCRIPTION,
        epilog=_EPILOG,
    )
    parser.add_argument("path", metavar="PATH", nargs="?", type=Path, help="folder of meshes, or of such folders")
    parser.add_argument(
        "--root", metavar="DIR", type=Path, help="instead of PATH: a folder as of 'clalign bench faust'"
    )
    parser.add_argument("--of", metavar="NAMES", default="", help=f"comma-separated: {', '.join(STUDIES)}")
    parser.add_argument(
        "--vary",
        metavar="OPTION=VALUES",
        action="append",
        default=[],
        help="a table over any option: alignment.decay=0.1,0.2,0.5; values that hold commas stand in brackets",
    )
    parser.add_argument(
        "--pairs", metavar="FILE", help="a pairs file (default: all pairs*.txt in PATH), or as of 'bench faust'"
    )
    add_option_arguments(parser)
    add_run_arguments(parser, "clalign-bench-study")
    add_output_arguments(parser, "study", "%(default)s, with -STUDY added")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the studies of the command line; 1 when a pair has no map."""
    from clalign.benchmark.runner import Measurement

    names = [word.strip() for word in args.of.split(",") if word.strip()] + args.vary
    if not names:
        raise OptionError("nothing to vary: name a study with --of, or an option with --vary OPTION=VALUES")
    terminal = Terminal(quiet=args.quiet, as_json=args.json)
    base = Options.preset(args.preset).replace(option_changes(args))
    studies = {name.partition("=")[0].strip(): study_of(name, base) for name in names}
    layouts = limited(_layouts(args), args, terminal)
    documents: dict[str, object] = {}
    failed = False
    for name, study in studies.items():
        methods = methods_of(study.settings, base)
        finished = run_methods(layouts, methods, Measurement(seed=args.seed), args, terminal)
        if finished is None:
            return EXIT_INTERRUPTED
        documents[name] = _report(name, study, finished, base, args, terminal)
        failed |= any(record.failed for record in finished.records)
    terminal.document(documents)
    return 1 if failed else 0


def _layouts(args: argparse.Namespace) -> tuple[Layout, ...]:
    """Read the pairs of the command line."""
    from clalign.benchmark.layouts import faust, humans

    if (args.path is None) == (args.root is None):
        raise OptionError("name either a folder in the layout of the humans, or with --root one of FAUST's")
    return humans(args.path, args.pairs) if args.root is None else faust(args.root, args.pairs or "intra")


def _report(
    name: str, study: Study, finished: Run, base: Options, args: argparse.Namespace, terminal: Terminal
) -> list[dict[str, object]]:
    """Write and show the table of one study, and return its summaries as plain values."""
    from clalign.benchmark.table import failures, summarise, update_file

    summaries = summarise(finished.records)
    text = study_table(study.title, study.settings, summaries, base)
    (args.out / f"study-{name}.md").write_text(text + "\n", encoding="utf-8")
    for failure in failures(finished.records):
        terminal.warn(failure)
    terminal.say(text)
    for page in args.update:
        update_file(page, f"{args.section}-{name}", text)
    return [asdict(summary) for summary in summaries]
