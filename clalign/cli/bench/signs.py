"""``clalign bench signs``: the paper's method under the paper's conditions, and without their accident."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from clalign.cli.bench.accuracy import limited
from clalign.cli.bench.common import add_option_arguments, add_output_arguments
from clalign.cli.match import option_changes
from clalign.cli.terminal import Terminal
from clalign.errors import OptionError
from clalign.options import Options
from clalign.storage.files import make_folder, write_text

if TYPE_CHECKING:
    from clalign.benchmark.signs import SignsRow

_DESCRIPTION = """\
Match pairs of one connectivity by the method as printed, from eigenfunctions with the signs that ARPACK gives them,
with the vertices in one order and with the target's shuffled; each with the xi that the truth says is best, as in the
paper. Say what share of the eigenfunctions has the same sign on both shapes. DIR gets signs.md and signs.json.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``signs`` to the benchmarks."""
    parser = subparsers.add_parser(
        "signs", help="the paper's conditions: signs that agree by accident", description=_DESCRIPTION
    )
    parser.add_argument("path", metavar="PATH", type=Path, help="folder in the layout of the humans, one connectivity")
    parser.add_argument("--pairs", metavar="FILE", help="run this pairs file only (default: all pairs*.txt in PATH)")
    parser.add_argument("--xi", metavar="VALUES", default="0.5,0.3,0.15", help="to try (default: %(default)s)")
    parser.add_argument("--limit", metavar="N", type=int, default=3, help="pairs of each list (default: %(default)s)")
    parser.add_argument("--out", metavar="DIR", type=Path, default=Path("clalign-bench-signs"))
    add_option_arguments(parser)
    add_output_arguments(parser, "signs")
    parser.set_defaults(run=run, preset="paper")


def run(args: argparse.Namespace) -> int:
    """Match the pairs, and show and write the table."""
    from clalign.benchmark.layouts import humans
    from clalign.benchmark.pairs import Pair
    from clalign.benchmark.signs import signs_row, signs_table
    from clalign.benchmark.table import update_file

    try:
        exponents = [float(word) for word in args.xi.split(",")]
    except ValueError as error:
        raise OptionError(f"--xi must be numbers with commas between them, got {args.xi!r}") from error
    options = Options.preset(args.preset).replace(option_changes(args))
    terminal = Terminal(quiet=args.quiet, as_json=args.json)
    make_folder(args.out)
    rows: list[SignsRow] = [
        signs_row(pair, options, exponents, terminal.note, shuffled=shuffled)
        for layout in limited(humans(args.path, args.pairs), args, terminal)
        for pair in layout.pairs
        if isinstance(pair, Pair)
        for shuffled in (False, True)
    ]
    text = signs_table(rows)
    write_text(args.out / "signs.md", text + "\n")
    write_text(args.out / "signs.json", json.dumps([asdict(row) for row in rows], indent=1) + "\n")
    terminal.say(text)
    terminal.document([asdict(row) for row in rows])
    for page in args.update:
        update_file(page, args.section, text)
    return 0
