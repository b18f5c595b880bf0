"""``clalign bench pair``: time and memory of a whole match, stage by stage, with a cold and a warm cache."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path

from clalign.cli.bench.common import add_option_arguments, add_output_arguments, deliver
from clalign.cli.job import option_changes
from clalign.cli.terminal import Terminal
from clalign.data import bundled_pair
from clalign.errors import OptionError
from clalign.options import Options

_DESCRIPTION = """\
Match two meshes in processes of their own: once as on a new machine, where OpenCL programs are built too, then in
turn with an empty and a filled cache of shapes. A time runs from the start of the process to its end.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``pair``."""
    parser = subparsers.add_parser("pair", help="time and memory of a whole match", description=_DESCRIPTION)
    parser.add_argument("source", metavar="SOURCE", type=Path, nargs="?", help="mesh file (default: the bundled pair)")
    parser.add_argument("target", metavar="TARGET", type=Path, nargs="?", help="mesh file")
    parser.add_argument("--peer", choices=["pyfm"], help="let pyFM match the pair in the same rounds")
    parser.add_argument("--repeat", metavar="N", type=int, default=3, help="rounds; the median counts (default: 3)")
    add_option_arguments(parser)
    parser.add_argument("--out", metavar="FILE", type=Path, help="write the JSON document to FILE")
    add_output_arguments(parser, "pair")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Time the pair and show the table."""
    from clalign.benchmark.pair import measure_pair, pair_table
    from clalign.benchmark.peers import PyfmMethod
    from clalign.benchmark.performance import bytes_text, this_machine
    from clalign.mesh.mesh import load_mesh

    if (args.source is None) != (args.target is None):
        raise OptionError("give both SOURCE and TARGET, or neither for the bundled pair")
    if args.repeat < 1:
        raise OptionError(f"--repeat must be at least 1, got {args.repeat}")
    bundled = bundled_pair()
    files = (args.source or bundled.source, args.target or bundled.target)
    counts = [load_mesh(file).n_vertices for file in files]
    if args.peer is not None:
        # Says how to install it, before the long work.
        _ = PyfmMethod().settings
    options = Options.preset(args.preset).replace(option_changes(args))
    terminal, machine = Terminal(quiet=args.quiet, as_json=args.json), this_machine()
    times = measure_pair(
        *files,
        options,
        args.repeat,
        args.peer is not None,
        lambda one: terminal.note(f"{one.label}: {one.seconds:.1f} s, {bytes_text(one.peak)}"),
    )
    heading = f"{files[0].stem} ({counts[0]:,} vertices) to {files[1].stem} ({counts[1]:,}) on {times[0].device}"
    document = {
        "source": str(files[0]),
        "target": str(files[1]),
        "vertices": counts,
        "options": options.as_dict(),
        "runs": [asdict(one) for one in times],
    }
    short = f"{heading}\n\n{pair_table(times, stages=False)}"
    deliver({heading: pair_table(times)}, document, machine, args, terminal, short)
    return 0
