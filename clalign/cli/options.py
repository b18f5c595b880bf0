"""``clalign options``: every option with its value and what it means."""

from __future__ import annotations

import argparse
import inspect
import re
import textwrap

_DESCRIPTION = """\
List every option that --set changes, with its value in a preset and what it means.
"""
_WIDTH = 100


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``options`` to the program."""
    parser = subparsers.add_parser(
        "options",
        help="list every option that --set changes",
        description=_DESCRIPTION,
    )
    parser.add_argument(
        "--preset", metavar="NAME", default="default", help="preset whose values are shown (default: %(default)s)"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the list."""
    from clalign.options import Options

    chosen = Options.preset(args.preset)
    for group_name, values in chosen.as_dict().items():
        if not isinstance(values, dict):
            print(f"{group_name}={values}\n    fixes everything that is drawn")
            continue
        meanings = described(type(getattr(chosen, group_name)))
        for name, value in values.items():
            print(f"{group_name}.{name}={str(value).lower() if isinstance(value, bool) else value}")
            print(textwrap.fill(meanings[name], _WIDTH, initial_indent="    ", subsequent_indent="    "))
    return 0


def described(group: type) -> dict[str, str]:
    """Return what the docstring of an option group says of each option ("name, name : what", indented lines go on)."""
    meanings: dict[str, str] = {}
    for entry in re.finditer(r"^(\w+(?:, \w+)*) : (.*(?:\n +.*)*)", inspect.getdoc(group) or "", re.MULTILINE):
        meanings |= dict.fromkeys(entry[1].split(", "), " ".join(entry[2].split()))
    return meanings
