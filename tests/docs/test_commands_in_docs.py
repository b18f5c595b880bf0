"""Commands and code in the documentation are such that the program and Python accept them."""

from __future__ import annotations

import ast
import importlib
import re
import shlex
from pathlib import Path

import pytest

from clalign.benchmark.study import STUDIES
from clalign.cli.main import build_parser

PROJECT = Path(__file__).resolve().parents[2]
PAGES = [PROJECT / "README.md", PROJECT / "CONTRIBUTING.md", *sorted((PROJECT / "docs").rglob("*.md"))]


def commands(page: Path) -> list[str]:
    """Every command line of clalign that follows a prompt."""
    text = page.read_text(encoding="utf-8").replace("\\\n", " ")
    return [line for line in re.findall(r"^\$ (?:\S*/)?(clalign .*)$", text, re.MULTILINE)]


def snippets(page: Path) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


LINES = [(page.name, line) for page in PAGES for line in commands(page)]


def test_the_tutorial_has_every_command_that_a_newcomer_needs() -> None:
    used = {shlex.split(line)[1] for page, line in LINES if page == "tutorial.md"}
    assert used >= {"doctor", "check", "match", "show", "evaluate", "transfer", "export"}


@pytest.mark.parametrize(("page", "line"), LINES)
def test_command_parses(page: str, line: str) -> None:
    words = shlex.split(line, comments=True)[1:]
    if "--help" in words or "--version" in words:
        with pytest.raises(SystemExit, match=r"^0$"):
            build_parser().parse_args(words)
    else:
        args = build_parser().parse_args(words)
        assert callable(args.run)
        assert {name for name in getattr(args, "of", "").split(",") if name} <= set(STUDIES)


@pytest.mark.parametrize("page", [page for page in PAGES if snippets(page)], ids=lambda page: page.name)
def test_code_compiles_and_what_it_takes_from_clalign_exists(page: Path) -> None:
    for code in snippets(page):
        for node in ast.walk(ast.parse(code)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "clalign":
                home = importlib.import_module(node.module or "")
                assert all(hasattr(home, alias.name) for alias in node.names)
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "clalign":
                assert hasattr(importlib.import_module("clalign"), node.attr), node.attr
