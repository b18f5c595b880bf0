"""Skips fail on request, but for the reasons that are allowed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import skips

TESTS = f"""
import pytest

@pytest.mark.skipif(True, reason="no such program")
def test_marked():
    pass

def test_inside():
    pytest.skip("no such program")

def test_allowed():
    pytest.skip("pthread {skips.ALLOWED[2]}")

@pytest.mark.xfail(raises=KeyError, strict=True)
def test_expected_to_fail():
    raise KeyError
"""
MODULE = "import pytest; pytest.importorskip('no_such_module')"


@pytest.mark.parametrize(
    ("value", "status", "closing"),
    [("1", 1, "1 failed, 1 skipped, 1 xfailed, 2 errors"), ("", 0, "4 skipped, 1 xfailed")],
)
def test_a_skip_fails_unless_its_reason_is_allowed(tmp_path: Path, value: str, status: int, closing: str) -> None:
    (tmp_path / "conftest.py").write_text("from skips import *", encoding="utf-8")
    (tmp_path / "test_few.py").write_text(TESTS, encoding="utf-8")
    (tmp_path / "test_module.py").write_text(MODULE, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "--continue-on-collection-errors", "--rootdir", str(tmp_path), str(tmp_path)],
        env={**os.environ, skips.VARIABLE: value, "PYTHONPATH": str(Path(__file__).parent), "PYTEST_ADDOPTS": ""},
        capture_output=True,
        text=True,
        check=False,
    )
    last = done.stdout.splitlines()[-1].strip("= ")
    assert (done.returncode, last.partition(" in ")[0]) == (status, closing)
    assert (f"{skips.VARIABLE}=1" in done.stdout) == bool(value)
