"""The one loop over the stages of a match: timing, progress, and what Ctrl-C keeps."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

from clalign.ctrl_c import is_interrupt
from clalign.engine.backend import Backend
from clalign.matching.stages import STAGES, Report, Stage
from clalign.matching.state import MatchState

Progress = Callable[[str, float, str], None]
"""Called as ``progress(stage, fraction, message)``: the stage is done to `fraction`, 0 to 1."""


@dataclass
class Clock:
    """Seconds spent in each stage, and a word to whoever watches."""

    progress: Progress | None = None
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[Report]:
        """Time a stage; yields a function that reports its fraction and a message."""
        started = time.perf_counter()

        def report(fraction: float, message: str = "") -> None:
            if self.progress is not None:
                self.progress(name, fraction, message)

        report(0.0, "")
        try:
            yield report
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - started
        report(1.0, "")


def run_stages(state: MatchState, backend: Backend, clock: Clock, stages: Sequence[Stage] = STAGES) -> MatchState:
    """Take a pair through the stages that it needs.

    Once there is a map, Ctrl-C cuts short what is left: the best so far is taken the shortest way to a whole result.
    Ctrl-C before, or once more, is raised as KeyboardInterrupt.
    """
    for stage in stages:
        while stage.needed(state):
            reached = state
            try:
                with clock.stage(stage.name) as report:
                    for step in stage.run(state, backend, report):
                        reached = step
                state = reached
                break
            except BaseException as error:
                if not is_interrupt(error):
                    raise
                if reached.interrupted or not reached.worth_keeping:
                    raise KeyboardInterrupt from error
                state = reached.cut_short()
            if clock.progress is not None:
                clock.progress("interrupted", 0.0, "ending with the best so far; Ctrl-C once more gives up")
    return state
