"""Configuration of the documentation: ``make docs`` builds it."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from sphinx.application import Sphinx

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import clalign

project = "clalign"
author = "the clalign maintainers"
version = release = clalign.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.mathjax", "numpydoc"]
myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 3
autosummary_generate = True
autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
exclude_patterns = ["_build"]
templates_path = ["templates"]
html_theme = "alabaster"
html_theme_options = {"description": "Shape correspondence by aligned eigenfunctions", "page_width": "1100px"}

_ENTRY = re.compile(r"^(\w[\w, ]*) : (.*)")
_RULE = re.compile(r"^-{3,}$")


def _readable(app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]) -> None:
    """Let Sphinx read docstrings as people do: entries "name : text" outside sections, and bars that are magnitudes."""
    rules = [number for number, line in enumerate(lines) if _RULE.match(line)]
    prose = rules[0] - 1 if rules else len(lines)
    changed: list[str] = []
    for number, line in enumerate(lines):
        entry = _ENTRY.match(line) if number < prose and what == "class" else None
        escaped = line.replace("|", "\\|")
        changed += ["", f"**{entry[1]}**", f"    {entry[2]}".replace("|", "\\|")] if entry else [escaped]
    lines[:] = changed


def setup(app: Sphinx) -> None:
    """Register the hook before that of numpydoc."""
    app.connect("autodoc-process-docstring", _readable, priority=100)
