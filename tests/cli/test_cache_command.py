"""``clalign cache`` shows and removes what is ours, and nothing else."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from clalign.cli.main import main
from clalign.geometry.cache import ShapeCache, content_key
from clalign.storage.files import size_text


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("CLALIGN_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_info_and_clear(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for number in range(3):
        key = content_key("basis", {"vertices": np.full(4, number)}, {})
        assert ShapeCache().put(key, {"functions": np.zeros((1000, 10))})
    (folder / "thesis.npz").write_bytes(b"mine")
    assert main(["cache", "info", "--json"]) == 0
    info = json.loads(capsys.readouterr().out)
    assert info["folder"] == str(folder)
    assert info["entries"] == 3
    assert 240_000 <= info["bytes"] < 250_000
    assert main(["cache", "info"]) == 0
    assert f"{folder}: 3 entries, {size_text(info['bytes'])} of at most 2.0 GiB" in capsys.readouterr().out
    assert main(["cache", "clear"]) == 0
    assert "removed 3 entries" in capsys.readouterr().out
    assert [path.name for path in folder.iterdir()] == ["thesis.npz"]


def test_missing_folder_is_an_empty_cache(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["cache", "clear"]) == 0
    assert main(["cache", "info"]) == 0
    assert "removed 0 entries" in capsys.readouterr().out
    assert not folder.exists()


def test_action_is_required() -> None:
    with pytest.raises(SystemExit) as stop:
        main(["cache"])
    assert stop.value.code == 2
