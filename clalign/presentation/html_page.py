"""What the pages of a match and of a collection share: their head, how templates are filled, how a page is written."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from pathlib import Path

from clalign.storage.files import replaced_file


def head(title: str, style: str, images: str) -> str:
    """Return the head of a page that loads nothing from elsewhere.

    Parameters
    ----------
    title : as HTML.
    style : CSS.
    images : where images may come from, as in a content security policy.
    """
    return fill(file_text(__package__, "head.html"), {"title": title, "style": style, "images": images})


def fill(template: str, parts: Mapping[str, str]) -> str:
    """Return a template with ``{{name}}`` replaced by the part of that name; parts are not looked into."""
    first, *pieces = template.split("{{")
    filled = [first]
    for piece in pieces:
        name, rest = piece.split("}}", 1)
        filled += [parts[name], rest]
    return "".join(filled)


def file_text(package: str, name: str) -> str:
    """Return a text file of a package; `name` may hold folders."""
    return resources.files(package).joinpath(*name.split("/")).read_text(encoding="utf-8")


def write_page(path: Path, page: str) -> None:
    """Write a page; an earlier one is replaced only when the new one is complete."""
    with replaced_file(path) as stream:
        stream.write(page.encode())
