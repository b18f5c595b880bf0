"""``clalign bench scale``: how the time and memory of a whole match grow with the meshes."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path

from clalign.cli.bench.common import add_option_arguments, add_output_arguments, deliver
from clalign.cli.job import option_changes
from clalign.cli.terminal import Terminal
from clalign.errors import OptionError
from clalign.options import Options

SIZES = "5000,10000,20000,50000,100000,200000"

_DESCRIPTION = """\
Match generated pairs (one bumpy body in two poses, each meshed in its own random way) of growing size, each in a
process of its own without a cache of shapes; OpenCL programs are built beforehand. The table has the seconds of each
stage, the peak memory, the mean distance to the true vertex (x 100, in sqrt(area)) and the fitted exponents.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``scale``."""
    parser = subparsers.add_parser(
        "scale", help="time and memory over the number of vertices", description=_DESCRIPTION
    )
    parser.add_argument(
        "--sizes",
        metavar="NUMBERS",
        default=SIZES,
        help="vertices of each mesh, comma-separated (default: %(default)s)",
    )
    parser.add_argument("--plot", metavar="FILE", type=Path, help="draw the times into a PNG, SVG or PDF file")
    add_option_arguments(parser)
    parser.add_argument("--out", metavar="FILE", type=Path, help="write the JSON document to FILE")
    add_output_arguments(parser, "scale")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Time all sizes and show the table."""
    from clalign.benchmark.pair import measure_scale, scale_table, stage_exponents
    from clalign.benchmark.performance import bytes_text, this_machine
    from clalign.presentation.performance_plot import save_scale_plot

    sizes = parsed_sizes(args.sizes)
    options = Options.preset(args.preset).replace(option_changes(args))
    terminal, machine = Terminal(quiet=args.quiet, as_json=args.json), this_machine()
    times = measure_scale(
        sizes,
        options,
        args.seed,
        lambda one: terminal.note(f"{one.time.label}: {one.time.seconds:.1f} s, {bytes_text(one.time.peak)}"),
    )
    document = {
        "options": options.as_dict(),
        "runs": [asdict(one) for one in times],
        "exponents": stage_exponents(times),
    }
    deliver({f"Generated pairs on {times[0].time.device}": scale_table(times)}, document, machine, args, terminal)
    if args.plot is not None:
        save_scale_plot(times, args.plot, title=times[0].time.device)
    return 0


def parsed_sizes(text: str) -> list[int]:
    """Return the numbers of a comma-separated list, ascending.

    Raises
    ------
    OptionError
        Something in it is not a positive whole number.
    """
    from clalign.benchmark.generated import SMALLEST

    words = [word.strip() for word in text.split(",")]
    if not all(word.isdecimal() and int(word) >= SMALLEST for word in words):
        raise OptionError(f"--sizes must be whole numbers of at least {SMALLEST}, comma-separated; got {text!r}")
    return sorted({int(word) for word in words})
