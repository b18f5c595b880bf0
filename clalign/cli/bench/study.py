"""``clalign bench study PATH --of NAME``: tables over the values that the paper fixed by hand."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from clalign.cli.bench.accuracy import EXIT_INTERRUPTED, option_changes, progress_line
from clalign.cli.terminal import Terminal

if TYPE_CHECKING:
    from clalign.benchmark.runner import Run
    from clalign.evaluation.layouts import Layout
    from clalign.options import Options

_DESCRIPTION = """\
Vary one choice of the method over the pairs of a folder in the layout of the humans, all else as in the preset, and
write a table with the default in bold: weight (lambda), band (a, b and how the funnel is read), xi (the metric), sizes
(d and k), samples (N, and vertices of the losses) or rounds.
"""

_EPILOG = """\
The folder DIR gets pairs.csv, curves.csv and study-NAME.md. The last step of the default read-out, two steps without
the mask, evens out much of what a choice does to R: --set readout.steps=0 shows R itself.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``study``."""
    parser = subparsers.add_parser(
        "study",
        help="tables over lambda, the funnel, xi, sizes, samples, rounds",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("path", metavar="PATH", nargs="?", type=Path, help="folder of meshes, or of such folders")
    parser.add_argument(
        "--root", metavar="DIR", type=Path, help="instead of PATH: a folder as of 'clalign bench faust'"
    )
    parser.add_argument(
        "--of", metavar="NAMES", required=True, help="comma-separated: weight,band,xi,sizes,samples,rounds"
    )
    parser.add_argument(
        "--pairs", metavar="FILE", help="a pairs file (default: all pairs*.txt in PATH), or as of 'bench faust'"
    )
    parser.add_argument("--limit", metavar="N", type=int, help="only the first N pairs of each suite")
    parser.add_argument("--preset", metavar="NAME", default="default", help="what is varied (default: %(default)s)")
    parser.add_argument(
        "--set", metavar="GROUP.NAME=VALUE", action="append", default=[], dest="changes", help="change an option of all"
    )
    parser.add_argument("--device", metavar="SPEC", help="as of 'clalign match'")
    parser.add_argument("--seed", metavar="N", type=int, default=0, help="seed of the match and the points")
    parser.add_argument("--jobs", metavar="N", type=int, default=1, help="processes with one thread each (default: 1)")
    parser.add_argument("--fresh", action="store_true", help="compute pairs again that pairs.csv has already")
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        default=Path("clalign-bench-study"),
        help="result folder (default: %(default)s)",
    )
    parser.add_argument(
        "--update", metavar="FILE", type=Path, help="put each table between <!-- table:SECTION-NAME --> marks of FILE"
    )
    parser.add_argument(
        "--section", metavar="SECTION", default="study", help="of the marks in FILE (default: %(default)s)"
    )
    parser.add_argument("--quiet", action="store_true", help="show nothing but warnings and errors")
    parser.add_argument("--json", action="store_true", help="print the summaries as one JSON document")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the studies of the command line; 1 when a pair has no map."""
    from clalign.benchmark.runner import Measurement
    from clalign.benchmark.runner import run as run_pairs
    from clalign.benchmark.study import methods_of, settings_of
    from clalign.options import Options

    terminal = Terminal(quiet=args.quiet, as_json=args.json)
    base = Options.preset(args.preset).replace(option_changes(args))
    studies = {name: settings_of(name, base) for name in dict.fromkeys(word.strip() for word in args.of.split(","))}
    layouts = [layout.limited(args.limit) for layout in _layouts(args)]
    for layout in layouts:
        for problem in layout.problems:
            terminal.warn(problem)
    documents: dict[str, object] = {}
    failed = False
    for name, settings in studies.items():
        try:
            finished = run_pairs(
                layouts,
                methods_of(settings, base),
                args.out,
                jobs=args.jobs,
                measurement=Measurement(seed=args.seed),
                resume=not args.fresh,
                progress=lambda count, total, record: terminal.note(f"{count}/{total} {progress_line(record)}"),
            )
        except KeyboardInterrupt:
            terminal.warn(f"interrupted: what is done is in {args.out}; the same command goes on from there")
            return EXIT_INTERRUPTED
        documents[name] = _report(name, finished, base, args, terminal)
        failed |= any(record.failed for record in finished.records)
    terminal.document(documents)
    return 1 if failed else 0


def _layouts(args: argparse.Namespace) -> tuple[Layout, ...]:
    """Read the pairs of the command line."""
    from clalign.errors import OptionError
    from clalign.evaluation.layouts import faust, humans

    if (args.path is None) == (args.root is None):
        raise OptionError("name either a folder in the layout of the humans, or with --root one of FAUST's")
    return humans(args.path, args.pairs) if args.root is None else faust(args.root, args.pairs or "intra")


def _report(
    name: str, finished: Run, base: Options, args: argparse.Namespace, terminal: Terminal
) -> list[dict[str, object]]:
    """Write and show the table of one study, and return its summaries as plain values."""
    from dataclasses import asdict

    from clalign.benchmark.study import STUDIES, settings_of, study_table
    from clalign.benchmark.table import failures, summarise, update_file

    summaries = summarise(finished.records)
    text = study_table(STUDIES[name].title, settings_of(name, base), summaries, base)
    (args.out / f"study-{name}.md").write_text(text + "\n", encoding="utf-8")
    for failure in failures(finished.records):
        terminal.warn(failure)
    terminal.say(text)
    if args.update is not None:
        update_file(args.update, f"{args.section}-{name}", text)
    return [asdict(summary) for summary in summaries]
