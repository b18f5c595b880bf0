"""``clalign options``: every option with its value and what it means."""

from __future__ import annotations

import argparse
import dataclasses
import inspect
import json
import operator
import re
import textwrap

from clalign.option_values import leaves
from clalign.options import Options

_DESCRIPTION = """\
List every option that --set changes, with its value in a preset and what it means.
"""
_WIDTH = 100


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``options`` to the program."""
    parser = subparsers.add_parser("options", help="list every option that --set changes", description=_DESCRIPTION)
    parser.add_argument(
        "--preset", metavar="NAME", default="default", help="preset whose values are shown (default: %(default)s)"
    )
    parser.add_argument(
        "--rules", action="store_true", help="list the numbers inside the method instead, which --set changes, too"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the list."""
    chosen = Options.preset(args.preset)
    for name, _ in leaves(chosen):
        if name.startswith("rules.") != args.rules:
            continue
        group, _, option = name.rpartition(".")
        value = operator.attrgetter(name)(chosen)
        print(f"{name}={_text(value)}")
        meanings = described(type(operator.attrgetter(group)(chosen))) if group else {"seed": "fixes everything drawn"}
        print(textwrap.fill(meanings[option], _WIDTH, initial_indent="    ", subsequent_indent="    "))
    return 0


def _text(value: object) -> object:
    """Return a value as --set takes it."""
    if isinstance(value, tuple):
        return json.dumps(value, default=dataclasses.asdict, separators=(",", ":"))[1:-1]
    return str(value).lower() if isinstance(value, bool) else value


def described(group: type) -> dict[str, str]:
    """Return what the docstring of an option group says of each option ("name, name : what", indented lines go on)."""
    meanings: dict[str, str] = {}
    for entry in re.finditer(r"^(\w+(?:, \w+)*) : (.*(?:\n +.*)*)", inspect.getdoc(group) or "", re.MULTILINE):
        meanings |= dict.fromkeys(entry[1].split(", "), " ".join(entry[2].split()))
    return meanings
