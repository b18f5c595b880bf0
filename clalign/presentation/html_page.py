"""Pages of a match and of a collection: Jinja templates beside their modules, and how a page is written."""

from __future__ import annotations

import os
from pathlib import Path
from urllib.parse import quote

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from clalign.storage.files import replaced_file, text_bytes


def file_url(*parts: str) -> str:
    """Return a link to a file below the page, byte for byte: Jinja and `quote` take nothing but UTF-8."""
    return "/".join(quote(os.fsencode(part)) for part in parts)


_LOADER = PackageLoader(__package__, ".")
_TEMPLATES = Environment(
    loader=_LOADER,
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)
_TEMPLATES.policies["json.dumps_kwargs"] = {"ensure_ascii": False, "allow_nan": False}
_TEMPLATES.filters["file_url"] = file_url
# A file of this package as it is: styles and programs hold braces that are not for Jinja.
_TEMPLATES.globals["raw"] = lambda name: Markup(_LOADER.get_source(_TEMPLATES, name)[0])


def rendered(template: str, **values: object) -> str:
    """Return a template (its file, from this package's folder on) with its names filled in; texts are escaped."""
    return _TEMPLATES.get_template(template).render(values)


def write_page(path: Path, template: str, **values: object) -> None:
    """Write a page that loads nothing from elsewhere; an earlier one is replaced only when the new one is complete."""
    page = rendered(template, **values)
    with replaced_file(path) as stream:
        stream.write(text_bytes(page))
