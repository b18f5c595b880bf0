"""The troubleshooting page speaks of messages that the program gives, and of every reason to refuse a mesh."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import malformed
import pytest

PROJECT = Path(__file__).parents[2]
PAGE = PROJECT / "docs" / "troubleshooting.md"
GAP = "…"


def headings() -> list[str]:
    return re.findall(r"^### `(.*)`$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)


def templates() -> list[str]:
    """Every text in the program, with a gap for each value that is put into it."""
    found = []
    for path in (PROJECT / "clalign").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.JoinedStr):
                parts = [str(part.value) if isinstance(part, ast.Constant) else GAP for part in node.values]
                found.append("".join(parts))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.append(node.value.replace("%s", GAP))
    return found


def test_every_heading_is_made_of_texts_of_the_program() -> None:
    texts = templates()
    assert len(headings()) > 50
    for heading in headings():
        for piece in (part.strip(" :;,()") for part in heading.split(GAP)):
            assert len(piece) < 4 or any(piece in text for text in texts), f"{heading}: {piece!r} is no text of clalign"


@pytest.fixture(scope="module")
def refusals(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    rows = malformed.messages(tmp_path_factory.mktemp("malformed"))
    return [message for _, verdict, message in rows if verdict == "refused"]


def test_every_refusal_has_its_heading(refusals: list[str]) -> None:
    patterns = [re.compile(".*?".join(re.escape(part) for part in heading.split(GAP))) for heading in headings()]
    for message in refusals:
        assert any(pattern.search(message) for pattern in patterns), message
