"""Kernel sources: found in both layouts, complete, and within the rules that keep them portable."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from clalign.engine import programs
from clalign.engine.programs import INCLUDE, kernel_folder, kernel_source, program_names
from clalign.engine.reference import Reference
from clalign.engine.reference_arrays import ReferenceArrays
from clalign.errors import DeviceError

FILES = sorted(kernel_folder().glob("*.cl"))


def test_options_are_part_of_the_text():
    """PoCL's cache may return a program that was built with other options if the text is the same."""
    one, two = (kernel_source("product", {"PRECISION": 32, "WG": 1, "KB": block}) for block in (128, 256))
    assert one.text != two.text
    assert one.text.split("\n", 1)[1] == two.text.split("\n", 1)[1]


def test_signatures_are_read_from_the_source():
    source = kernel_source("elementwise", {})
    assert source.signatures["add"] == ("int", "real", "real", "buffer", "buffer", "buffer")
    assert source.signatures["band_gather"] == ("int", "buffer", "buffer", "buffer", "buffer")
    assert kernel_source("product", {}).signatures["product"].count("long") == 2
    assert "factorise" in kernel_source("cholesky", {}).signatures


def test_every_file_is_a_program_or_part_of_one():
    included = {part for file in FILES for part in INCLUDE.findall(file.read_text(encoding="utf-8"))}
    assert included | {programs.PRELUDE} | {f"{name}.cl" for name in program_names()} == {file.name for file in FILES}
    assert not included & {f"{name}.cl" for name in program_names()}
    for name in program_names():
        assert "#include" not in kernel_source(name, {}).text


def test_heads_and_the_page_of_the_kernels_name_files_and_twins_that_exist():
    page = (kernel_folder() / "README.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `(\w+\.cl)` \|.*\| (.*) \|$", page, flags=re.M))
    assert set(rows) == {file.name for file in FILES}
    listed = {twin for row in rows.values() for twin in re.findall(r"`(\w+)`", row)}
    operations = {name for name in vars(Reference) | vars(ReferenceArrays) if not name.startswith("_")}
    assert listed == operations - {"name", "describe", "array", "zeros", "numpy", "read"}
    for file in FILES:
        head = file.read_text(encoding="utf-8").split("*/")[0]
        named = re.findall(r"twins?: clalign\.engine\.reference\.Reference\.(\w+(?:,(?:\n \*)? \w+)*)", head)
        twins = {twin for names in named for twin in re.findall(r"\w+", names)}
        assert twins == set(re.findall(r"`(\w+)`", rows[file.name])), file.name


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_files_keep_the_rules(file: Path):
    text = file.read_text(encoding="utf-8")
    code = re.sub(r"/\*.*?\*/", "", text, flags=re.S)
    assert text.startswith("/*")
    assert len(text.splitlines()) < 250
    assert not re.search(r"\b(fma|vload\d|vstore\d|atomic\w*)\s*\(", code)
    assert not re.search(r"\b\d+\.\d*\b", code), "a literal with a decimal point is a double"
    assert not re.search(r"^inline\b", code, flags=re.M), "a function of its own is compiled for shorter vectors"
    for signature in programs.SIGNATURE.findall(text):
        assert signature[0] in text.split("*/")[0], f"{signature[0]} is not described at the head of the file"


@pytest.mark.parametrize("inside", [True, False])
def test_found_in_a_wheel_and_beside_the_package(tmp_path, monkeypatch, inside):
    package = tmp_path / "clalign"
    (package / "engine").mkdir(parents=True)
    place = package / "kernels" if inside else tmp_path / "kernels"
    shutil.copytree(kernel_folder(), place)
    monkeypatch.setattr(programs, "__file__", str(package / "engine" / "programs.py"))
    assert kernel_folder.__wrapped__() == place


def test_an_incomplete_installation_says_where_it_looked(tmp_path, monkeypatch):
    monkeypatch.setattr(programs, "__file__", str(tmp_path / "clalign" / "engine" / "programs.py"))
    with pytest.raises(DeviceError, match="kernels are missing"):
        kernel_folder.__wrapped__()


def test_helpers_and_long_sums_are_written_once():
    """A sum of lanes or a compensated sum outside ``sums.cl`` would round in a way of its own."""
    texts = {file.name: file.read_text(encoding="utf-8") for file in FILES}
    helpers = [name for text in texts.values() for name in re.findall(r"^INLINE\s+\w+\s+(\w+)\(", text, flags=re.M)]
    assert len(helpers) == len(set(helpers))
    assert {"lane_sum", "dot_rows", "compensated_sum"} <= set(helpers)
    for name, text in texts.items():
        if name != "sums.cl":
            assert not re.search(r"\blost\b|\+= lanes\[", text), f"{name} has a sum of its own"
