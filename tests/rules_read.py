"""Which rules a run reads."""

from __future__ import annotations

import dataclasses
from types import ModuleType
from typing import Any

import pytest


def rule_classes(module: ModuleType) -> list[type]:
    """Return the frozen groups of a module."""
    return [each for each in vars(module).values() if isinstance(each, type) and dataclasses.is_dataclass(each)]


def every_rule(classes: list[type]) -> set[str]:
    """Return "Class.field" of every rule."""
    return {f"{each.__name__}.{field.name}" for each in classes for field in dataclasses.fields(each)}


def watch(monkeypatch: pytest.MonkeyPatch, classes: list[type]) -> set[str]:
    """Return a set that gets "Class.field" of every rule that is read from now on."""
    seen: set[str] = set()
    for each in classes:
        fields = {field.name for field in dataclasses.fields(each)}

        def watched(self: Any, name: str, kind: type = each, fields: set[str] = fields) -> Any:
            if name in fields:
                seen.add(f"{kind.__name__}.{name}")
            return object.__getattribute__(self, name)

        monkeypatch.setattr(each, "__getattribute__", watched)
    return seen
