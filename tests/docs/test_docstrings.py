"""Docstrings of dataclasses that list attributes list those that there are."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import pkgutil
import re

import pytest

import clalign


def described() -> dict[str, type]:
    """Return the dataclasses of the package whose docstring has a section of attributes."""
    found = {}
    for module in pkgutil.walk_packages(clalign.__path__, "clalign."):
        for _, each in inspect.getmembers(importlib.import_module(module.name), inspect.isclass):
            here = each.__module__ == module.name and dataclasses.is_dataclass(each)
            if here and re.search(r"^Attributes\n-+$", inspect.getdoc(each) or "", re.MULTILINE):
                found[f"{each.__module__}.{each.__name__}"] = each
    return found


DESCRIBED = described()


def test_there_are_such_classes() -> None:
    assert len(DESCRIBED) > 20


@pytest.mark.parametrize("name", sorted(DESCRIBED))
def test_every_attribute_is_described_and_nothing_else(name: str) -> None:
    section = re.split(r"^Attributes\n-+$", inspect.getdoc(DESCRIBED[name]) or "", maxsplit=1, flags=re.MULTILINE)[1]
    lines = re.findall(r"^(\w+(?:, \w+)*) : ", section, re.MULTILINE)
    listed = [attribute for line in lines for attribute in line.split(", ")]
    assert listed == [field.name for field in dataclasses.fields(DESCRIBED[name])]
