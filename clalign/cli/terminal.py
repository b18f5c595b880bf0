"""What a command shows: progress and warnings on standard error, results on standard output."""

from __future__ import annotations

import json
import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

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

    def progress(self) -> ProgressView:
        """Return a progress view that suits the terminal: a bar, plain lines in a log, or nothing."""
        if self.quiet:
            return ProgressView()
        if sys.stderr.isatty():
            return BarView()
        return LineView()


class ProgressView:
    """Takes ``(stage, fraction, message)`` and shows nothing: the base of the two that do."""

    def __enter__(self) -> ProgressView:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def __call__(self, stage: str, fraction: float, message: str = "") -> None:
        """Report that `stage` is done to `fraction` (0 to 1), with a message such as the loss."""


class LineView(ProgressView):
    """Plain lines for logs: one when a stage starts, then one every few seconds."""

    def __init__(self) -> None:
        self._stage = ""
        self._shown = 0.0

    def __call__(self, stage: str, fraction: float, message: str = "") -> None:
        """Print a line if the stage is new or the last line is old."""
        now = time.monotonic()
        if stage == self._stage and now - self._shown < _PLAIN_SECONDS:
            return
        progress = f" {fraction:.0%}" if stage == self._stage else ""
        print(f"{stage}{progress}" + (f": {message}" if message else ""), file=sys.stderr, flush=True)
        self._stage, self._shown = stage, now


class BarView(ProgressView):
    """One bar a stage, with the loss and an estimate of the time that remains."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

        self._progress: Progress = Progress(
            TextColumn("{task.description:<12}"),
            BarColumn(bar_width=30),
            TextColumn("{task.percentage:>3.0f}%"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[message]}", markup=False),
            console=Console(stderr=True),
        )
        self._stage = ""
        self._task: TaskID | None = None

    def __enter__(self) -> ProgressView:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None and self._task is not None:
            self._progress.update(self._task, completed=1.0)
        self._progress.stop()

    def __call__(self, stage: str, fraction: float, message: str = "") -> None:
        """Move the bar of `stage`; a new stage completes the bar before it."""
        if stage != self._stage or self._task is None:
            if self._task is not None:
                self._progress.update(self._task, completed=1.0)
            self._stage = stage
            self._task = self._progress.add_task(stage, total=1.0, message=message)
        self._progress.update(self._task, completed=min(max(fraction, 0.0), 1.0), message=message)


def table(rows: list[tuple[str, str]], *, indent: str = "  ") -> list[str]:
    """Return lines with two aligned columns."""
    width = max((len(name) for name, _ in rows), default=0)
    return [f"{indent}{name:<{width}}  {value}" for name, value in rows]
