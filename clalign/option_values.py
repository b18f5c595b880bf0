"""Changing values of nested frozen dataclasses by dotted names: conversion, old names, and what a wrong one meant."""

from __future__ import annotations

import dataclasses
import difflib
import functools
import json
import types
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from clalign.errors import ClalignWarning, OptionError

Group = TypeVar("Group")

RENAMED: Mapping[str, str] = {
    "alignment.rounds": "alignment.outer_iterations",
    "spectrum.descriptors": "spectrum.scale_invariant",
}
"""Options by their names of the release before."""

RENAMED_VALUES: Mapping[tuple[str, Any], Any] = {
    ("readout.refine", "pieces"): "patches",
    ("readout.refine", "upsample"): "zoomout",
    ("alignment.denominator", "frozen"): "fixed",
}

REMOVED: Mapping[str, tuple[Any, ...]] = {
    "alignment.distances": ("factors",),
    "geodesics.dense_below": (1500, "1500"),
    "spectrum.solver": ("block",),
}
"""Options that are gone, with the values that are what is done now."""


type_hints: Callable[[Any], Mapping[str, Any]] = functools.cache(get_type_hints)
"""Types of the fields of a dataclass by name, evaluated once: every change of an option asks for those of all."""


def translated(changes: Mapping[str, Any], *, warn: bool) -> dict[str, Any]:
    """Return changes with the names and values of the release before replaced by today's.

    Raises
    ------
    OptionError
        A removed option with a value that nothing does any more.
    """
    result: dict[str, Any] = {}
    for key, value in changes.items():
        if key in REMOVED:
            if value not in REMOVED[key]:
                raise OptionError(f"{key}={value}: this option was removed; only {REMOVED[key][0]} is left, without it")
            note = f"option {key} was removed and has no effect"
        else:
            name = RENAMED.get(key, key)
            now = RENAMED_VALUES.get((name, value), value) if isinstance(value, str) else value
            result[name] = now
            note = "" if (name, now) == (key, value) else f"option {key}={value} is now {name}={now}"
        if note and warn:
            warnings.warn(f"{note}; the old form is accepted for one release", ClalignWarning, stacklevel=3)
    return result


def flattened(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested mappings as one with dotted names."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        key = f"{prefix}{name}"
        flat.update(flattened(value, f"{key}.") if isinstance(value, Mapping) else {key: value})
    return flat


def replaced(options: Group, changes: Mapping[str, Any]) -> Group:
    """Return a copy of a nested dataclass with the values of dotted names changed.

    Raises
    ------
    OptionError
        Unknown name, or a value that cannot be converted or lies outside its range.
    """
    known = dict(leaves(options))
    for key in changes:
        if key not in known:
            raise OptionError(_unknown(key, options, known))
    return _replaced(options, changes, "")


def leaves(options: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the dotted name and the type of every value of a nested dataclass."""
    hints = type_hints(type(options))
    for entry in dataclasses.fields(options):
        value, key = getattr(options, entry.name), f"{prefix}{entry.name}"
        if dataclasses.is_dataclass(value):
            yield from leaves(value, f"{key}.")
        else:
            yield key, hints[entry.name]


def _replaced(options: Any, changes: Mapping[str, Any], prefix: str) -> Any:
    hints, values = type_hints(type(options)), {}
    for entry in dataclasses.fields(options):
        key, current = f"{prefix}{entry.name}", getattr(options, entry.name)
        if dataclasses.is_dataclass(current):
            inner = _replaced(current, changes, f"{key}.")
            if inner is not current:
                values[entry.name] = inner
        elif key in changes:
            values[entry.name] = converted(changes[key], hints[entry.name], key)
    return dataclasses.replace(options, **values) if values else options


def converted(value: Any, kind: Any, key: str) -> Any:
    """Return a value, or its text, as one of a type: a number, text, truth value, tuple or dataclass.

    Raises
    ------
    OptionError
        It is none; the message begins with `key`.
    """
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        if value is None or (isinstance(value, str) and value.lower() == "none"):
            return None
        return converted(value, next(each for each in arguments if each is not types.NoneType), key)
    if origin is Literal:
        return str(value)
    if origin is tuple:
        return tuple(converted(each, arguments[0], key) for each in _items(value, key))
    if dataclasses.is_dataclass(kind):
        return _built(value, kind, key)
    return _scalar(value, kind, key)


def _items(value: Any, key: str) -> Sequence[Any]:
    if isinstance(value, str):
        text = value.strip()
        inner = text[1:-1] if text[:1] + text[-1:] in ("()", "[]") else text
        try:
            value = json.loads(f"[{inner.rstrip(', ')}]")
        except ValueError as error:
            raise OptionError(f"{key} must be values with commas between them, got {value!r}") from error
    if not isinstance(value, Sequence):
        raise OptionError(f"{key} must be a list of values, got {value!r}")
    return value


def _built(value: Any, kind: Any, key: str) -> Any:
    if isinstance(value, kind):
        return value
    hints = type_hints(kind)
    if not isinstance(value, Mapping) or value.keys() - hints.keys():
        raise OptionError(f"{key} must hold values of {', '.join(hints)}, got {value!r}")
    try:
        return kind(**{name: converted(inner, hints[name], f"{key}.{name}") for name, inner in value.items()})
    except TypeError as error:
        raise OptionError(f"{key}: {error}") from error


def _scalar(value: Any, kind: type[Any], key: str) -> Any:
    if kind is bool and isinstance(value, str):
        words = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
        if value.lower() not in words:
            raise OptionError(f"{key} must be true or false, got {value!r}")
        return words[value.lower()]
    if kind is bool and not isinstance(value, bool):
        raise OptionError(f"{key} must be true or false, got {value!r}")
    try:
        result = kind(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise OptionError(f"{key} must be {kind.__name__}, got {value!r}") from error
    if kind is int and not isinstance(value, str) and result != value:
        raise OptionError(f"{key} must be a whole number, got {value!r}")
    return result


def _unknown(key: str, options: Any, known: Mapping[str, Any]) -> str:
    """Return what is wrong with a name: its group, or the name in it, with what may have been meant."""
    group, _, name = key.rpartition(".")
    inside = [option.rpartition(".")[2] for option in known if option.rpartition(".")[0] == group]
    same = [option for option in known if option.rpartition(".")[2] == name]
    if inside and group:
        found = same or [f"{group}.{near}" for near in difflib.get_close_matches(name, inside, 1)]
    else:
        found = same or difflib.get_close_matches(key, known, 1, 0.75)
    meant = f"did you mean {' or '.join(found)}?" if found else ""
    if group and not inside:
        groups = ", ".join(entry.name for entry in dataclasses.fields(options) if entry.name not in known)
        return f"unknown option group {group!r} in {key!r}; {meant or f'there are {groups}'}"
    inside = inside if group else [entry.name for entry in dataclasses.fields(options)]
    return f"unknown option {key!r}; {meant or 'there are ' + ', '.join(inside)}"
