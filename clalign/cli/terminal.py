"""What a command shows: progress and warnings on standard error, results on standard output."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.progress import TaskID

    from clalign.matching.loop import Progress

EXIT_INTERRUPTED = 130
"""Exit status after Ctrl-C."""

_PLAIN_SECONDS = 10.0


class Terminal:
    """Where a command's lines go, by ``--quiet`` and ``--json``.

    quiet : no progress and no summary; warnings and errors remain.
    as_json : standard output carries one JSON document and nothing else.
    """

    def __init__(self, *, quiet: bool = False, as_json: bool = False) -> None:
        self.quiet = quiet
        self.as_json = as_json

    def say(self, line: str = "") -> None:
        """Show one line of the result to a person."""
        if not self.quiet and not self.as_json:
            print(line, flush=True)

    def note(self, line: str) -> None:
        """Show one line of what is going on."""
        if not self.quiet:
            print(line, file=sys.stderr, flush=True)

    def warn(self, line: str) -> None:
        """Show a warning, also when quiet."""
        print(f"warning: {line}", file=sys.stderr, flush=True)

    def document(self, value: Any) -> None:
        """Print the JSON document, if that was asked for."""
        if self.as_json:
            print(json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False), flush=True)

    @contextmanager
    def progress(self) -> Iterator[Progress]:
        """Yield what shows the progress: as bars on a terminal, as plain lines in a log, or not at all."""
        if self.quiet:
            yield lambda stage, fraction, message: None
        elif sys.stderr.isatty():
            with bars() as progress:
                yield progress
        else:
            yield lines()


def lines() -> Progress:
    """Return a progress for logs: a line when a stage starts, then one every few seconds."""
    shown = ("", 0.0)

    def show(stage: str, fraction: float, message: str = "") -> None:
        nonlocal shown
        now = time.monotonic()
        if stage == shown[0] and now - shown[1] < _PLAIN_SECONDS:
            return
        part = f" {fraction:.0%}" if stage == shown[0] else ""
        print(f"{stage}{part}" + (f": {message}" if message else ""), file=sys.stderr, flush=True)
        shown = stage, now

    return show


@contextmanager
def bars() -> Iterator[Progress]:
    """Yield a progress with one bar a stage, the loss and an estimate of the time that remains.

    A new stage completes the bar before it; the last is completed by the end of the block, unless that is an error.
    """
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bars

    columns = (
        TextColumn("{task.description:<12}"),
        BarColumn(bar_width=30),
        TextColumn("{task.percentage:>3.0f}%"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[message]}", markup=False),
    )
    bar_of: dict[str, TaskID] = {}

    def complete() -> None:
        for bar in bar_of.values():
            shown.update(bar, completed=1.0)
        bar_of.clear()

    def show(stage: str, fraction: float, message: str = "") -> None:
        if stage not in bar_of:
            complete()
            bar_of[stage] = shown.add_task(stage, total=1.0, message=message)
        shown.update(bar_of[stage], completed=min(max(fraction, 0.0), 1.0), message=message)

    with Bars(*columns, console=Console(stderr=True)) as shown:
        yield show
        complete()


def table(rows: list[tuple[str, str]], *, indent: str = "  ") -> list[str]:
    """Return lines with two aligned columns."""
    width = max((len(name) for name, _ in rows), default=0)
    return [f"{indent}{name:<{width}}  {value}" for name, value in rows]
