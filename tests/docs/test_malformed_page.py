"""The page of malformed meshes is what its script makes, and every message on it can be acted on."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import malformed
import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"

Rows = list[tuple[str, str, str]]

#: What a user is told to do: these words, each in the imperative.
DEEDS = re.compile(
    r"Way out: (?:say which|export|check|scale|subdivide|with|without|cut open|a point cloud must be|`clalign check)"
    r"|[Ee]xport it again|export the mesh again|mend |give a file of the kind|name a mesh file|check the path"
    r"|extract its surface|give the surface|[Cc]opy (?:it|or pack it) again"
)


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> Rows:
    return malformed.messages(tmp_path_factory.mktemp("malformed"))


def test_page_is_up_to_date() -> None:
    made = runpy.run_path(str(DOCS / "malformed_page.py"))["page"]()
    kept = (DOCS / "malformed.md").read_text(encoding="utf-8")
    # What stands in these brackets is said by the release of trimesh that reads the file.
    ours, theirs = (re.sub(r"\(ValueError: [^)]*\)", "(ValueError: …)", text) for text in (made, kept))
    assert ours == theirs, "run: python docs/malformed_page.py"


def test_every_refusal_names_the_file_and_says_what_to_do(rows: Rows) -> None:
    refused = [(name, message) for name, verdict, message in rows if verdict == "refused"]
    assert len(refused) > 40
    for name, message in refused:
        assert re.match(r"[^:]+: ", message), message
        assert message.startswith((f"{name}: ", f"{name.replace(' ', '-')}.off: ", "folder.off: ")), message
        assert DEEDS.search(message), message


def test_every_defect_of_a_surface_says_how_much_and_where(rows: Rows) -> None:
    nowhere = {"no vertices", "point cloud", "one triangle", "hole", "inside out", "inside out with a hole"}
    surfaces = {case.name for case in malformed.surfaces()}
    for name, _, message in rows:
        if name in surfaces - nowhere:
            assert re.search(r"\((?:vertex|vertices|face|faces) \d+[^)]*\)|such as -?\d+ \(face \d+\)", message), (
                message
            )
