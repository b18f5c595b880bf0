"""Write the page of malformed meshes: what is wrong with each, and what the program says of it.

``python docs/malformed_page.py`` makes the collection of ``tests/malformed.py`` in a temporary folder, loads every
file, and writes ``docs/malformed.md`` anew.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

DOCS = Path(__file__).resolve().parent
PAGE = DOCS / "malformed.md"

_HEAD = """\
# Malformed meshes

Meshes with one defect each, and what the program says of them, word for word. A mesh that is *refused* ends a command
with that one line and the exit status 2, before anything long is begun; one that is *used* is matched, with the note
as a warning in the result; `--strict` refuses many of these, too. "Way out" says what to do. {doc}`troubleshooting`
explains the messages. This page is made by `python docs/malformed_page.py`; the tests match every one of these meshes.
"""


def page() -> str:
    """Return the page as Markdown."""
    sys.path.append(str(DOCS.parent / "tests"))
    import malformed

    with tempfile.TemporaryDirectory() as scratch:
        found = malformed.messages(Path(scratch))
    refused = [[name, message] for name, verdict, message in found if verdict == "refused"]
    used = [[name, message or "nothing to say"] for name, verdict, message in found if verdict == "loaded"]
    parts = [_HEAD, "## Refused\n", _table(refused, "message"), "## Used\n", _table(used, "note")]
    return "\n".join(parts)


def _table(rows: list[list[str]], what: str) -> str:
    lines = [f"| mesh | {what} |", "|---|---|", *(f"| {_cell(name)} | {_cell(text)} |" for name, text in rows)]
    return "\n".join(lines) + "\n"


def _cell(text: str) -> str:
    """Return text so that Markdown shows it as it is."""
    return "".join(f"\\{letter}" if letter in "\\|`*_<>[]" else letter for letter in text)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
