"""What the benchmarks share on the command line: arguments, runs over pairs, and where results go."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clalign.benchmark.methods import Method
from clalign.cli.terminal import Terminal
from clalign.errors import ResultError

if TYPE_CHECKING:
    from clalign.benchmark.layouts import Layout
    from clalign.benchmark.performance import Machine
    from clalign.benchmark.records import Record
    from clalign.benchmark.runner import Measurement, Run

EXIT_INTERRUPTED = 130


def add_option_arguments(parser: argparse.ArgumentParser, preset: bool = True) -> None:
    """Add ``--set``, ``--device``, ``--seed`` and, unless methods name theirs, ``--preset``."""
    if preset:
        parser.add_argument("--preset", metavar="NAME", default="default", help="'default', 'fast' or 'paper'")
    parser.add_argument(
        "--set", metavar="GROUP.NAME=VALUE", action="append", default=[], dest="changes", help="change an option of all"
    )
    parser.add_argument("--device", metavar="SPEC", help="as of 'clalign match'")
    parser.add_argument("--seed", metavar="N", type=int, default=0, help="seed of everything that is drawn")


def add_run_arguments(parser: argparse.ArgumentParser, folder: str) -> None:
    """Add ``--out``, ``--limit``, ``--jobs`` and ``--fresh``: of runs over the pairs of a data set."""
    parser.add_argument(
        "--out", metavar="DIR", type=Path, default=Path(folder), help="result folder (default: %(default)s)"
    )
    parser.add_argument("--limit", metavar="N", type=int, help="only the first N pairs of each suite")
    parser.add_argument("--jobs", metavar="N", type=int, default=1, help="processes with one thread each (default: 1)")
    parser.add_argument("--fresh", action="store_true", help="compute pairs again that pairs.csv has already")


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


def limited(layouts: Sequence[Layout], args: argparse.Namespace, terminal: Terminal) -> list[Layout]:
    """Return the pairs that ``--limit`` leaves, and warn of what is missing from them."""
    kept = [layout.limited(args.limit) for layout in layouts]
    for layout in kept:
        for problem in layout.problems:
            terminal.warn(problem)
    return kept


def run_methods(
    layouts: Sequence[Layout],
    methods: Sequence[Method],
    measurement: Measurement,
    args: argparse.Namespace,
    terminal: Terminal,
) -> Run | None:
    """Run methods over all pairs and show a line a pair; None after Ctrl-C."""
    from clalign.benchmark.runner import run

    try:
        return run(
            layouts,
            methods,
            args.out,
            jobs=args.jobs,
            measurement=measurement,
            resume=not args.fresh,
            progress=lambda count, total, record: terminal.note(f"{count}/{total} {progress_line(record)}"),
        )
    except KeyboardInterrupt:
        terminal.warn(f"interrupted: what is done is in {args.out}; the same command goes on from there")
        return None


def progress_line(record: Record) -> str:
    """Return what one pair gave, in one line."""
    who = f"{record.suite} {record.pair} {record.method}:"
    if record.failed:
        return f"{who} FAILED, {record.message}"
    parts = [f"{who} mean {100 * (record.mean or 0.0):.3f}, exact {record.exact or 0.0:.0%}"]
    if record.mirrored_mean is not None:
        parts.append(f"mirrored {100 * record.mirrored_mean:.1f}{' FLIPPED' if record.flipped else ''}")
    if record.confidence is not None:
        parts.append(f"confidence {record.confidence:.2f}")
    parts.append(f"{record.seconds or 0.0:.1f} s")
    return ", ".join(parts)


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
        try:
            args.out.write_text(json.dumps(whole, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
        except OSError as error:
            raise ResultError(f"{args.out}: cannot be written ({error.strerror})") from error
    for page in args.update:
        update_file(page, args.section, text, short)
