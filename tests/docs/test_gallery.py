"""The gallery on a small pair, and the pages that show it."""

from __future__ import annotations

import csv
import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
OLD_NAMES = "## Renamed and removed options\n"


@pytest.fixture(scope="module")
def gallery() -> ModuleType:
    specification = importlib.util.spec_from_file_location("gallery", DOCS / "gallery.py")
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def test_gallery_draws_every_figure_once(
    gallery: ModuleType, bumpy_files: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    source, target, truth = (str(path) for path in bumpy_files)
    images = tmp_path / "images"
    command = [source, target, "--truth", truth, "--out", str(images), "--quick"]
    assert gallery.main(command) == 0
    names = {f"figure-{number}.{ending}" for number in gallery.PLANS for ending in ("png", "svg", "csv")}
    assert {path.name for path in images.iterdir()} == names
    with (images / "figure-9.csv").open(encoding="utf-8") as stream:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(stream)]
    low = rows[1:20]
    assert sum(row["this program"] for row in low) < 0.6 * sum(row["unaligned"] for row in low)
    times = {path.name: path.stat().st_mtime_ns for path in images.iterdir()}
    assert gallery.main(command) == 0
    assert {path.name: path.stat().st_mtime_ns for path in images.iterdir()} == times


def test_every_figure_has_a_page_that_shows_it(gallery: ModuleType) -> None:
    listed = (DOCS / "figures" / "index.md").read_text(encoding="utf-8")
    for number in gallery.PLANS:
        page = (DOCS / "figures" / f"figure-{number}.md").read_text(encoding="utf-8")
        assert f"images/figure-{number}.png" in page
        assert f"--which {number}" in page
        assert f"\nfigure-{number}\n" in listed


def test_pages_name_options_and_methods_that_exist() -> None:
    from clalign.benchmark.methods import NAMED
    from clalign.option_values import flattened
    from clalign.options import Options

    texts = [path.read_text(encoding="utf-8").partition(OLD_NAMES)[0] for path in DOCS.rglob("*.md")]
    known = flattened(Options().as_dict())
    groups = "spectrum|geodesics|search|alignment|readout|engine|rules"
    for name, value in re.findall(rf"`(?:--set )?((?:{groups})\.[\w.]+)(?:=([a-z\d][\w.-]*))?", "".join(texts)):
        Options().replace({name: value or known[name]})
    table = (DOCS / "variants.md").read_text(encoding="utf-8").split("|---|---|---|\n")[1].split("\n\n")[0]
    for row in table.splitlines():
        for method in re.findall(r"`([\w-]+)`", row.split(" | ")[-1]):
            assert method in NAMED


def test_the_page_of_options_lists_every_old_name_that_is_still_taken() -> None:
    from clalign.option_values import REMOVED, RENAMED, RENAMED_VALUES

    section = (DOCS / "options.md").read_text(encoding="utf-8").partition(OLD_NAMES)[2]
    values = {(f"{name}={old}", f"{name}={new}") for (name, old), new in RENAMED_VALUES.items()}
    assert set(re.findall(r"^\| `([^`]+)` \| `([^`]+)` \|$", section, re.MULTILINE)) == values | set(RENAMED.items())
    assert all(f"`{name}`" in section for name in REMOVED)


def test_documentation_builds_without_a_warning(tmp_path: Path) -> None:
    import numpy as np

    from clalign.presentation.raster import write_png

    pages = tmp_path / "clalign" / "docs"
    shutil.copytree(DOCS, pages, ignore=shutil.ignore_patterns("_build", "generated", "images", "__pycache__"))
    shutil.copytree(DOCS / "images", pages / "images")
    (pages / "figures" / "images").mkdir()
    for number in range(1, 10):
        write_png(pages / "figures" / "images" / f"figure-{number}.png", np.zeros((4, 4, 3), np.uint8))
    build = [
        sys.executable,
        "-m",
        "sphinx",
        "-q",
        "-W",
        "--keep-going",
        "-b",
        "html",
        str(pages),
        str(tmp_path / "html"),
    ]
    done = subprocess.run(build, capture_output=True, text=True, check=False, timeout=240)
    assert (done.returncode, done.stderr) == (0, "")
    assert "alignment_errors" in (tmp_path / "html" / "api.html").read_text(encoding="utf-8")
