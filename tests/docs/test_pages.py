"""The README is short, and pages name files, pages and sections that exist."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]
DOCS = PROJECT / "docs"
FRONT = [PROJECT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
PAGES = [*FRONT, *sorted(path for path in DOCS.rglob("*.md") if "_build" not in path.parts)]
ROOMS = ["clalign", *sorted(f"clalign/{path.parent.name}" for path in (PROJECT / "clalign").glob("*/__init__.py"))]


def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def tables(page: Path) -> Iterator[list[str]]:
    """Yield the rows of every Markdown table, without header and rule."""
    for block in re.findall(r"(?:^\|.*\n)+", text_of(page), re.MULTILINE):
        yield block.splitlines()[2:]


def test_the_readme_is_a_screen_and_a_half_without_a_long_table() -> None:
    assert len(text_of(PROJECT / "README.md").splitlines()) <= 95
    found = [len(rows) for rows in tables(PROJECT / "README.md")]
    assert len(found) == 2
    assert max(found) <= 6


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_between_files_resolve(page: Path) -> None:
    links = re.findall(r"\]\(([^)\s#]+)[^)\s]*\)", text_of(page))
    missing = [link for link in links if "://" not in link and not (page.parent / link).exists()]
    drawn = [link for link in missing if re.fullmatch(r"images/figure-\d\.png", link)]
    assert missing == drawn
    documents = re.findall(r"\{doc\}`([^`]+)`", text_of(page))
    assert [name for name in documents if not (page.parent / f"{name}.md").is_file()] == []


@pytest.mark.parametrize("page", [page for page in PAGES if page.name != "CHANGELOG.md"], ids=lambda page: page.name)
def test_files_of_the_project_that_pages_name_exist(page: Path) -> None:
    names = set(re.findall(r"`((?:\w[\w-]*/)*\w[\w-]*\.(?:py|cl|md))(?:: \w+)?`", text_of(page)))
    homes = [PROJECT, DOCS, *(PROJECT / room for room in ROOMS)]
    unknown = [name for name in names if "NAME" not in name and not any((home / name).is_file() for home in homes)]
    assert unknown == []


def test_the_table_of_rooms_is_the_one_that_the_linter_checks() -> None:
    settings = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))
    layers = settings["tool"]["importlinter"]["contracts"][0]["layers"]
    height = {room.strip(): -number for number, layer in enumerate(layers) for room in layer.split("|")}
    (table,) = re.findall(r"^\| room \|.*\n\|.*\n((?:\|.*\n)+)", text_of(PROJECT / "CONTRIBUTING.md"), re.MULTILINE)
    cells = [row.split(" | ")[0] for row in table.splitlines()]
    written = [name.rstrip("/") for cell in cells for name in re.findall(r"`([\w/]+)`", cell)]
    heights = [height[f"clalign.{name}"] for name in written if name != "kernels"]
    assert heights == sorted(heights)
    packages = {room.partition("/")[2] for room in ROOMS} - {"", "data"}
    assert packages <= set(written)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_table_of_a_benchmark_has_a_command_that_writes_it(page: Path) -> None:
    text = text_of(page)
    sections = re.findall(r"<!-- table:([\w-]+) -->", text)
    assert sections == re.findall(r"<!-- /table:([\w-]+) -->", text)
    assert len(set(sections)) == len(sections)
    home = page.relative_to(PROJECT).as_posix()
    commands = [line for each in PAGES for line in re.findall(r"^\$ (clalign bench .*)$", text_of(each), re.MULTILINE)]
    updating = [line for line in commands if f"--update {home}" in line] + re.findall(r"`(clalign bench [^`]*)`", text)
    tools = re.findall(rf"^\$ python tools/gpu_(\w+)\.py --update {re.escape(home)}$", text, re.MULTILINE)
    for section in sections:
        assert section in tools or any(writes(line, section) for line in updating), section


def writes(command: str, section: str) -> bool:
    """Tell whether a command of ``clalign bench`` writes that section."""
    named = re.search(r"--section ([\w-]+)", command)
    studies = re.search(r"--of ([\w,]+)", command)
    if studies is not None:
        first = named[1] if named else "study"
        return section in [f"{first}-{name}" for name in studies[1].split(",")]
    return section.removesuffix("-short") == (named[1] if named else command.split()[2])
