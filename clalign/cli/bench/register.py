"""``clalign bench register``: registered meshes over pairs of data sets."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path

from clalign.cli.bench.accuracy import limited
from clalign.cli.bench.common import add_option_arguments, add_output_arguments
from clalign.cli.match import option_changes
from clalign.cli.terminal import Terminal
from clalign.options import Options
from clalign.storage.files import write_text

_DESCRIPTION = """\
Match pairs of posed humans and of animals, lay each source on its target, and say how many faces are turned over, how
far the surface is, and how near the registered vertices come to the truth beside the map's. The folder DIR gets
register.md and curve.png.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``register`` to the benchmarks."""
    parser = subparsers.add_parser(
        "register", help="registered meshes: folds, distance, errors", description=_DESCRIPTION
    )
    parser.add_argument("--humans", metavar="PATH", type=Path, action="append", default=[], help="as of 'bench humans'")
    parser.add_argument("--animals", metavar="PATH", type=Path, action="append", default=[], help="as 'bench animals'")
    parser.add_argument("--limit", metavar="N", type=int, help="only the first N pairs of each suite")
    parser.add_argument("--out", metavar="DIR", type=Path, default=Path("clalign-bench-register"), help="result folder")
    parser.add_argument("--points", metavar="N", type=int, help="points measured a pair (default: 500)")
    add_option_arguments(parser)
    add_output_arguments(parser, "register")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the pairs of the command line and show their table."""
    from clalign.benchmark.layouts import animals, humans
    from clalign.benchmark.registered import RegisteredPair, registered_curves, registered_pairs, registered_table
    from clalign.benchmark.table import update_file
    from clalign.errors import OptionError
    from clalign.presentation.curves import save_error_curves

    terminal = Terminal(quiet=args.quiet, as_json=args.json)
    layouts = [layout for path in args.humans for layout in humans(path)]
    layouts += [layout for path in args.animals for layout in animals(path)]
    pairs = [pair for layout in limited(layouts, args, terminal) for pair in layout.pairs]
    if not pairs:
        raise OptionError("no pairs: name folders with --humans PATH or --animals PATH")
    options = Options.preset(args.preset).replace(option_changes(args))
    done: list[RegisteredPair] = []
    for each in registered_pairs(pairs, options, points=args.points, seed=args.seed):
        done.append(each)
        terminal.note(f"{len(done)}/{len(pairs)} {registered_table([each]).splitlines()[2]}")
    table = registered_table(done)
    terminal.say(table)
    args.out.mkdir(parents=True, exist_ok=True)
    write_text(args.out / "register.md", table + "\n")
    save_error_curves(registered_curves(done), args.out / "curve.png")
    for page in args.update:
        update_file(page, args.section, table)
    terminal.document(
        {
            "pairs": [
                {
                    "name": each.name,
                    "quality": asdict(each.quality),
                    "map": float(each.map_errors.mean()),
                    "registered": float(each.place_errors.mean()),
                    "seconds": each.seconds,
                }
                for each in done
            ]
        }
    )
    return 0
