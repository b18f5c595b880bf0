"""What a user meets before any mesh is matched: help, versions, exit statuses and one-line errors."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
from pathlib import Path

import pytest

import clalign
from clalign.cli.main import build_parser, main
from clalign.option_values import leaves
from clalign.options import Options

COMMANDS = (
    *("match", "demo", "check", "collection", "show", "transfer", "export", "evaluate", "figures"),
    *("bench", "cache", "options", "doctor"),
)
PROGRAM = [sys.executable, "-m", "clalign.cli.main"]


def run(*arguments: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*PROGRAM, *(str(part) for part in arguments)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **environment},
        timeout=60,
    )


def assert_one_line_error(done: subprocess.CompletedProcess[str], status: int) -> None:
    assert done.returncode == status
    assert done.stdout == ""
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    assert "Traceback" not in done.stderr


def test_version() -> None:
    done = run("--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"clalign {clalign.__version__}\n", "")


def test_help_names_every_command_at_once() -> None:
    done = run("--help")
    assert done.returncode == 0
    assert done.stderr == ""
    for command in COMMANDS:
        assert f"\n    {command} " in done.stdout


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main([command, "--help"])
    assert stop.value.code == 0
    shown = capsys.readouterr()
    assert shown.err == ""
    assert shown.out.startswith(f"usage: clalign {command} ")


@pytest.mark.parametrize(
    "arguments", [[], ["mach"], ["match"], ["match", "a.ply"], ["match", "a", "b", "--seed", "x"], ["demo", "--fast"]]
)
def test_wrong_usage_is_status_2(arguments: list[str]) -> None:
    done = run(*arguments)
    assert done.returncode == 2
    assert done.stdout == ""
    assert "usage: clalign" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_program_alone_shows_its_help() -> None:
    done = run()
    assert done.stderr == run("--help").stdout


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (["match", "a", "b", "--alternative", "3"], "; did you mean --alternatives?"),
        (["match", "a", "b", "--devise=cpu"], "; did you mean --device?"),
        (["bench", "pair", "--jsn"], "; did you mean --json?"),
        (["match", "a", "b", "--qqqqqq"], "--qqqqqq"),
        (["match", "a", "b", "c"], "unrecognized arguments: c"),
    ],
)
def test_mistyped_options_get_the_usage_of_their_command(
    arguments: list[str], meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2
    errors = capsys.readouterr().err
    assert errors.startswith(f"usage: clalign {arguments[0]} ")
    assert errors.endswith(f"{meant}\n")


@pytest.mark.parametrize("preset", ["default", "paper"])
def test_options_lists_each_with_its_value_and_meaning(preset: str, capsys: pytest.CaptureFixture[str]) -> None:
    changes: dict[str, str] = {}
    for more in ([], ["--rules"]):
        assert main(["options", "--preset", preset, *more]) == 0
        lines = capsys.readouterr().out.splitlines()
        listed = dict(line.split("=", 1) for line in lines if not line.startswith(" "))
        assert all(name.startswith("rules.") == bool(more) for name in listed)
        assert all(after.startswith("    ") for line, after in itertools.pairwise(lines) if not line.startswith(" "))
        changes |= listed
    assert Options().replace(changes) == Options.preset(preset)
    assert sorted(changes) == sorted(name for name, _ in leaves(Options()))


@pytest.mark.parametrize("form", [["--truth", "A", "B"], ["--truth", "A", "--truth", "B"]])
def test_match_takes_two_truths_in_both_forms(form: list[str]) -> None:
    assert build_parser().parse_args(["match", "a", "b", *form, "--quiet"]).truth == ["A", "B"]


def test_options_are_not_abbreviated() -> None:
    parser = build_parser()
    with pytest.raises(SystemExit):
        parser.parse_args(["match", "a", "b", "--pre", "fast"])


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        (["--preset", "quick"], "default, fast, paper"),
        (["--set", "spectrum.basis"], "GROUP.NAME=VALUE"),
        (["--set", "spectrum.bass=4"], "unknown option 'spectrum.bass'; did you mean spectrum.basis?"),
        (["--set", "metric=auto"], "unknown option 'metric'; did you mean spectrum.metric?"),
        (["--set", "alignmnt.weight=4"], "did you mean alignment.weight or"),
        (["--set", "spectrum.foo=4"], "there are basis, refinement"),
        (["--set", "spectrum.basis=many"], "spectrum.basis must be int"),
        (["--metric", "riemann"], "spectrum.metric must be one of"),
        (["--orientation", "left"], "search.orientation must be one of"),
        (["--alternatives", "-1"], "search.alternatives"),
    ],
)
def test_bad_options_are_one_line_and_status_2(bumpy_files: tuple[Path, ...], extra: list[str], message: str) -> None:
    done = run("match", bumpy_files[0], bumpy_files[1], *extra)
    assert_one_line_error(done, 2)
    assert message in done.stderr


def test_missing_mesh_is_named(tmp_path: Path, bumpy_files: tuple[Path, ...]) -> None:
    done = run("match", bumpy_files[0], tmp_path / "gone.ply", "--out", tmp_path / "out")
    assert_one_line_error(done, 2)
    assert str(tmp_path / "gone.ply") in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "cannot be read"), ("0\n1\n", "has 2 lines"), ("0\nx\n", "line 2"), ("9999\n" * 642, "9999")],
)
def test_bad_truth_is_found_before_the_match(
    tmp_path: Path, bumpy_files: tuple[Path, ...], content: str | None, message: str
) -> None:
    truth = tmp_path / "bad-truth.txt"
    if content is not None:
        truth.write_text(content)
    done = run("match", *bumpy_files[:2], "--truth", truth, "--out", tmp_path / "out", "--quiet")
    assert_one_line_error(done, 2)
    assert message in done.stderr


@pytest.mark.usefixtures("opencl")
def test_existing_folders_are_refused_before_the_match(tmp_path: Path, bumpy_files: tuple[Path, ...]) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "notes.txt").write_text("mine")
    for extra in ([], ["--force"]):
        done = run("match", *bumpy_files[:2], "--out", tmp_path / "out", *extra)
        assert_one_line_error(done, 2)
        assert "choose another --out" in done.stderr
    (tmp_path / "out" / "result.json").write_text("{}")
    done = run("match", *bumpy_files[:2], "--out", tmp_path / "out", "--truth", tmp_path / "gone.txt")
    assert_one_line_error(done, 2)
    assert "gone.txt" in done.stderr
    done = run("match", *bumpy_files[:2], "--out", tmp_path / "out", "--device", "abacus")
    assert done.returncode == 1
    assert "abacus" in done.stderr
    done = run("match", *bumpy_files[:2], "--out", tmp_path / "out")
    assert_one_line_error(done, 2)
    assert "--force" in done.stderr


@pytest.mark.parametrize("name", ["x" * 250, "x" * 300])
@pytest.mark.usefixtures("opencl")
def test_folders_that_cannot_be_made_are_found_before_the_match(
    tmp_path: Path, bumpy_files: tuple[Path, ...], name: str
) -> None:
    # The folder for the unfinished result has a longer name than the result.
    done = run("match", *bumpy_files[:2], "--out", tmp_path / "new" / name)
    assert_one_line_error(done, 2)
    assert "cannot be written" in done.stderr
    assert "choose another --out" in done.stderr
    assert not [path for path in tmp_path.iterdir() if path.name.startswith((".", "new"))]


def test_debug_shows_the_trace(tmp_path: Path) -> None:
    done = run("match", tmp_path / "a.ply", tmp_path / "b.ply", CLALIGN_DEBUG="1")
    assert done.returncode == 2
    assert "Traceback" in done.stderr
    assert done.stderr.splitlines()[-1].startswith("error: ")


def test_closed_standard_output_is_no_disaster() -> None:
    process = subprocess.Popen([*PROGRAM, "match", "--help"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    process.stdout.close()
    assert process.stderr is not None
    errors = process.stderr.read()
    process.wait(timeout=60)
    process.stderr.close()
    assert "Traceback" not in errors
