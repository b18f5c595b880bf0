"""What the benchmarks share on the command line: arguments, and where results go."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clalign.cli.terminal import Terminal
from clalign.storage.files import write_text

if TYPE_CHECKING:
    from clalign.benchmark.performance import Machine


def add_option_arguments(parser: argparse.ArgumentParser, preset: bool = True) -> None:
    """Add ``--set``, ``--device``, ``--seed`` and, unless methods name theirs, ``--preset``."""
    if preset:
        parser.add_argument("--preset", metavar="NAME", default="default", help="'default', 'fast' or 'paper'")
    parser.add_argument(
        "--set", metavar="GROUP.NAME=VALUE", action="append", default=[], dest="changes", help="change an option of all"
    )
    parser.add_argument("--device", metavar="SPEC", help="as of 'clalign match'")
    parser.add_argument("--seed", metavar="N", type=int, default=0, help="seed of everything that is drawn")


def add_output_arguments(parser: argparse.ArgumentParser, section: str | None, text: str = "%(default)s") -> None:
    """Add ``--update``, ``--section``, ``--quiet`` and ``--json``; `text` says what the section is by default."""
    parser.add_argument(
        "--update",
        metavar="FILE",
        type=Path,
        action="append",
        default=[],
        help="put the table into the section of FILE named below; may be repeated",
    )
    parser.add_argument(
        "--section",
        metavar="NAME",
        default=section,
        help=f"of <!-- table:NAME -->, or of <!-- table:NAME-short --> for a short table (default: {text})",
    )
    parser.add_argument("--quiet", action="store_true", help="show nothing but warnings and errors")
    parser.add_argument("--json", action="store_true", help="print one JSON document instead of the table")


def deliver(
    tables: Mapping[str, str],
    document: Mapping[str, Any],
    machine: Machine,
    args: argparse.Namespace,
    terminal: Terminal,
    short: str | None = None,
) -> None:
    """Show tables of speed and write what was asked for.

    Parameters
    ----------
    tables : Markdown by heading.
    document : of plain values; the machine is added.
    machine : its facts, the load as it was before the measurement.
    short : what a page with a section ``NAME-short`` gets.

    Raises
    ------
    ResultError
        A file cannot be written, or has no section of that name.
    """
    from clalign.benchmark.table import update_file

    whole = {"machine": asdict(machine), **document}
    text = "\n\n".join([*(f"{heading}\n\n{table}" for heading, table in tables.items()), f"Measured on {machine}."])
    terminal.say(text)
    terminal.document(whole)
    if args.out is not None:
        write_text(args.out, json.dumps(whole, indent=2, ensure_ascii=False) + "\n")
    for page in args.update:
        update_file(page, args.section, text, short)
