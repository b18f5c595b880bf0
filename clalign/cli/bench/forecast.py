"""``clalign bench forecast``: measure memory and time of matches, and fit what ``clalign check`` predicts to them."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from clalign.cli.terminal import Terminal
from clalign.errors import ResultError

_DESCRIPTION = """\
Match generated pairs of growing size, one of them with other options too, and the bundled pair, each in a process of
its own; fit the coefficients of the forecast to peak memory and processor time; and write them with the measurements
to a file, by default the one that this installation reads. It takes some six minutes on two processors. Other
programs meanwhile change the memory not at all and the processor time little.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``forecast``."""
    parser = subparsers.add_parser(
        "forecast", help="calibrate the forecast of memory and time", description=_DESCRIPTION
    )
    parser.add_argument("--out", metavar="FILE", type=Path, help="write the coefficients to FILE instead")
    parser.add_argument("--quiet", action="store_true", help="show nothing but warnings and errors")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure, fit and write."""
    from clalign import resources
    from clalign.benchmark.calibration import Measured, measurements, table
    from clalign.benchmark.performance import bytes_text, this_machine

    terminal, machine = Terminal(quiet=args.quiet), this_machine()
    out = args.out or resources.TABLE

    def watch(one: Measured) -> None:
        changes = ", ".join(f"{name}={value}" for name, value in one.changes.items()) or "default options"
        label = f"{one.name}, {one.vertices[0]:,} vertices, {changes}"
        terminal.note(f"{label}: {bytes_text(one.memory)}, {sum(one.work.values()):.1f} s of a processor")

    found = measurements(draw, watch)
    text = json.dumps(table(found, machine), indent=1)
    try:
        out.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise ResultError(f"{out}: cannot be written ({error.strerror})") from error
    terminal.say(f"wrote {out}")
    return 0


def draw(result: Any, folder: Path) -> None:
    """Draw what ``clalign match`` draws."""
    from clalign.presentation.picture import save_match_picture
    from clalign.presentation.report import write_report

    save_match_picture(result, folder / "match.png")
    write_report(result, folder / "report.html")
