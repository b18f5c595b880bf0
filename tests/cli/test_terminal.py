"""Progress suits its reader: bars on a terminal, few plain lines in a log, nothing when quiet."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from clalign.cli.terminal import Terminal, bars, lines, table
from clalign.matching.loop import Progress

DRIVER = """
from clalign.cli.terminal import Terminal
terminal = Terminal()
with terminal.progress() as progress:
    for stage in ("source", "alignment"):
        for part in range(5):
            progress(stage, part / 4, f"loss {9 - part}")
terminal.say("done")
"""


def drive(progress: Progress) -> None:
    for stage in ("source", "alignment"):
        for part in range(5):
            progress(stage, part / 4, f"loss {9 - part}")


def test_log_gets_one_line_a_stage(capsys: pytest.CaptureFixture[str]) -> None:
    drive(lines())
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err == "source: loss 9\nalignment: loss 9\n"


def test_log_gets_a_line_when_a_stage_takes_long(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = iter(range(0, 1000, 6))
    monkeypatch.setattr("clalign.cli.terminal.time.monotonic", lambda: float(next(clock)))
    drive(lines())
    shown = capsys.readouterr().err.splitlines()
    assert shown[:3] == ["source: loss 9", "source 50%: loss 7", "source 100%: loss 5"]


def test_terminal_gets_bars_on_stderr_only() -> None:
    pty = pytest.importorskip("pty")
    reader, writer = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "100"}
    with subprocess.Popen(
        [sys.executable, "-c", DRIVER], stdout=subprocess.PIPE, stderr=writer, env=environment
    ) as process:
        os.close(writer)
        shown = b""
        while True:
            try:
                part = os.read(reader, 4096)
            except OSError:  # Linux reports the end of a terminal's life so
                break
            if not part:
                break
            shown += part
        os.close(reader)
        assert process.stdout is not None
        assert process.stdout.read() == b"done\n"
    assert process.returncode == 0
    for word in (b"source", b"alignment", b"100%", b"loss 5"):
        assert word in shown


def test_quiet_and_json_choose_what_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    quiet = Terminal(quiet=True)
    quiet.say("result")
    quiet.note("progress")
    quiet.warn("careful")
    quiet.document({"a": 1})
    with quiet.progress() as progress:
        progress("source", 0.5, "loss")
    assert capsys.readouterr() == ("", "warning: careful\n")
    document = Terminal(as_json=True)
    document.say("result")
    document.document({"a": "ü"})
    assert capsys.readouterr() == ('{\n  "a": "ü"\n}\n', "")


def test_json_refuses_what_is_not_json() -> None:
    with pytest.raises(ValueError, match="JSON"):
        Terminal(as_json=True).document({"a": float("nan")})


@pytest.mark.parametrize(("fraction", "shown", "message"), [(-0.5, "0%", "[not markup]"), (1.5, "100%", "[/]")])
def test_bar_of_a_stage_that_fails_stays_where_it_was(
    capsys: pytest.CaptureFixture[str], fraction: float, shown: str, message: str
) -> None:
    def fail() -> None:
        with bars() as progress:
            progress("source", 0.3, "earlier")
            progress("alignment", fraction, message)
            raise KeyError

    with pytest.raises(KeyError):
        fail()
    captured = capsys.readouterr()
    first, last = captured.err.split("source", 1)[1].split("alignment", 1)
    assert "100%" in first.split()
    assert shown in last.split()
    assert last.rstrip().endswith(message)
    assert captured.out == ""


def test_table_aligns() -> None:
    assert table([("a", "1"), ("long", "2")], indent="") == ["a     1", "long  2"]
