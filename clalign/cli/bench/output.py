"""What the benchmarks of speed share on the command line: arguments, and where their results go."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clalign.cli.terminal import Terminal

if TYPE_CHECKING:
    from clalign.benchmark.performance import Machine


def add_output_arguments(parser: argparse.ArgumentParser, section: str) -> None:
    """Add ``--json``, ``--out``, ``--update``, ``--section`` and ``--quiet``."""
    parser.add_argument("--json", action="store_true", help="print one JSON document instead of the table")
    parser.add_argument("--out", metavar="FILE", type=Path, help="write the JSON document to FILE as well")
    parser.add_argument(
        "--update", metavar="FILE", type=Path, help="put the table into the section of FILE named below"
    )
    parser.add_argument(
        "--section", metavar="NAME", default=section, help="of <!-- table:NAME --> (default: %(default)s)"
    )
    parser.add_argument("--quiet", action="store_true", help="show nothing but warnings and errors")


def deliver(
    tables: Mapping[str, str],
    document: Mapping[str, Any],
    machine: Machine,
    args: argparse.Namespace,
    terminal: Terminal,
) -> None:
    """Show the tables and write what was asked for.

    Parameters
    ----------
    tables : Markdown by heading; a heading may be empty.
    document : of plain values; the machine is added.
    machine : its facts, the load as it was before the measurement.

    Raises
    ------
    ResultError
        A file cannot be written, or has no section of that name.
    """
    from dataclasses import asdict

    from clalign.benchmark.table import update_file
    from clalign.errors import ResultError

    whole = {"machine": asdict(machine), **document}
    blocks = [f"{heading}\n\n{table}" if heading else table for heading, table in tables.items()]
    text = "\n\n".join([*blocks, f"Measured on {machine}."])
    terminal.say(text)
    terminal.document(whole)
    if args.out is not None:
        try:
            args.out.write_text(json.dumps(whole, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
        except OSError as error:
            raise ResultError(f"{args.out}: cannot be written ({error.strerror})") from error
    if args.update is not None:
        update_file(args.update, args.section, text)
