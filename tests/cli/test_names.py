"""Names of files that are no UTF-8: every byte of them is kept in results, pages and messages."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapes
from quick import device
from shapes import Pair

import clalign
from clalign.cli.main import main
from clalign.correspondence import Correspondence
from clalign.evaluation.errors import THRESHOLDS
from clalign.mesh.mesh import Mesh
from clalign.presentation import exports
from clalign.presentation.curves import save_error_curves
from clalign.presentation.notebook import notebook_html
from clalign.storage.files import text_bytes, write_json
from clalign.storage.rows import append_rows, complete_rows

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="names of files are bytes on Linux only")

LATIN = os.fsdecode(b"K\xf6rper")
"""The name of a file from an old archive: Latin-1 in a file system that is UTF-8."""


@pytest.fixture
def files(tmp_path: Path, bumpy_pair: Pair) -> tuple[Path, Path]:
    source = shapes.write_off(tmp_path / f"{LATIN}.off", *bumpy_pair.source)
    return source, shapes.write_off(tmp_path / "b.off", *bumpy_pair.target)


@pytest.fixture
def perfect(monkeypatch: pytest.MonkeyPatch, true_correspondence: Correspondence) -> None:
    """A match that returns the truth at once."""

    def match(source: Mesh, target: Mesh, options: Any, **_: Any) -> Correspondence:
        return dataclasses.replace(true_correspondence, source=source, target=target, options=options)

    monkeypatch.setitem(vars(clalign), "match", match)


@pytest.mark.usefixtures("perfect")
def test_a_match_keeps_the_name(tmp_path: Path, files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / f"{LATIN}-to-b"
    assert main(["match", *map(str, files), "--out", str(out), *device(), "--json"]) == 0
    shown = capsys.readouterr()
    assert "not drawn" not in shown.err
    assert json.loads(shown.out)["source"]["name"] == LATIN
    assert {path.name for path in out.iterdir()} >= {"match.png", "report.html", "result.json"}
    text = (out / "result.json").read_bytes().decode()
    assert r"K\udcf6rper.off" in text
    loaded = Correspondence.load(out)
    assert loaded.source.name == LATIN
    assert loaded.source.path == str(files[0])
    page = (out / "report.html").read_bytes().decode()
    assert r"K\udcf6rper" in page
    assert r"K\udcf6rper" in notebook_html(loaded)
    for name, write in exports.FORMATS.items():
        assert write(loaded, tmp_path / "exported"), name


@pytest.mark.parametrize("command", [["check"], ["check", "--json"]])
def test_messages_show_the_name_in_any_locale(files: tuple[Path, Path], command: list[str]) -> None:
    ascii_only = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    for settings in ({"PYTHONUTF8": "1"}, ascii_only):
        done = subprocess.run(
            [sys.executable, "-m", "clalign.cli.main", *command, os.fsencode(files[0])],
            capture_output=True,
            env={**os.environ, **settings},
            timeout=120,
        )
        assert done.returncode == 0, done.stderr
        assert rb"K\udcf6rper.off" in done.stdout


def test_a_missing_file_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["match", str(tmp_path / f"{LATIN}.off"), "b.off"]) == 2
    assert re.search(r"error: .*K\\udcf6rper\.off: no such file", capsys.readouterr().err)


def test_a_curve_is_drawn_under_the_name(tmp_path: Path) -> None:
    save_error_curves({LATIN: np.linspace(0.0, 1.0, len(THRESHOLDS))}, tmp_path / "curve.png")
    assert (tmp_path / "curve.png").stat().st_size > 1000


def test_documents_and_tables_read_back_the_same_name(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"größe 形": LATIN})
    assert json.loads((tmp_path / "a.json").read_text(encoding="utf-8")) == {"größe 形": LATIN}
    assert "größe 形" in (tmp_path / "a.json").read_text(encoding="utf-8")
    assert text_bytes(f"ü {LATIN}") == "ü K\\udcf6rper".encode()
    append_rows(tmp_path / "a.csv", ["name"], [[LATIN], ["ü"]])
    assert complete_rows(tmp_path / "a.csv", ["name"]) == [[LATIN], ["ü"]]
    assert b"K\xf6rper" in (tmp_path / "a.csv").read_bytes()
