"""``clalign cache``: what is kept of shapes that were matched before, and how to remove it."""

from __future__ import annotations

import argparse

from clalign.cli.terminal import Terminal
from clalign.storage.files import size_text


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``cache`` to the program."""
    parser = subparsers.add_parser(
        "cache",
        help="show or empty the cache of spectra and distances",
        description="Eigenfunctions and distances of every mesh are kept, so that a second match with it starts at "
        "once. The folder is the user's cache folder, or CLALIGN_CACHE; what was used longest ago goes first.",
    )
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    info = actions.add_parser("info", help="show the folder and what it holds")
    info.add_argument("--json", action="store_true", help="print one JSON document")
    info.set_defaults(run=show_info)
    clear = actions.add_parser("clear", help="remove everything")
    clear.set_defaults(run=clear_all)


def show_info(args: argparse.Namespace) -> int:
    """Print folder, entries, size and limit."""
    from clalign.geometry.cache import ShapeCache

    info = ShapeCache().info()
    terminal = Terminal(as_json=args.json)
    terminal.say(f"{info.folder}: {info.entries} entries, {size_text(info.size)} of at most {size_text(info.limit)}")
    terminal.document({"folder": str(info.folder), "entries": info.entries, "bytes": info.size, "limit": info.limit})
    return 0


def clear_all(_: argparse.Namespace) -> int:
    """Remove every entry."""
    from clalign.geometry.cache import ShapeCache

    cache = ShapeCache()
    size = cache.info().size
    print(f"{cache.folder}: removed {cache.clear()} entries, {size_text(size)}")
    return 0
