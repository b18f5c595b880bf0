"""``clalign collection FOLDER|LIST``: match a whole set of shapes."""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from clalign.cli.match import add_job_arguments, options_from
from clalign.cli.terminal import EXIT_INTERRUPTED, Terminal, table
from clalign.errors import OptionError

if TYPE_CHECKING:
    from clalign.collection.result import Collection

DEFAULT_FOLDER = Path("clalign-collection")
PAGE_FILE = "index.html"

_DESCRIPTION = """\
Match the pairs of a set of shapes in parallel, each shape prepared once, find the maps that contradict the others and
replace them. SHAPES is a folder of meshes or a text file with one mesh a line. The folder DIR gets pairs.csv (a row a
pair), shapes.csv, pairs/SOURCE/TARGET/ (maps.npz and a page for each pair), consistent/ (maps made from the others) and
index.html (open it in a browser).
"""

_EPILOG = """\
pairs:
  all     every pair
  star    the shape in the middle with every other; all other maps follow from these
  tree    every shape with one that is like it; all other maps follow from these
  FILE    source and target a line, by name
examples:
  clalign collection scans/ --out scans-matched
  clalign collection scans/ --out scans-matched --resume
  clalign collection scans.txt --pairs star --preset fast --workers 4
  clalign collection scans/ --scheduler tcp://head:8786 --out /shared/scans-matched
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``collection`` to the program."""
    parser = subparsers.add_parser(
        "collection", help="match a whole set of shapes", description=_DESCRIPTION, epilog=_EPILOG
    )
    parser.add_argument("shapes", metavar="SHAPES", type=Path, help="folder of meshes, or a file that lists them")
    add_job_arguments(parser, DEFAULT_FOLDER)
    parser.add_argument(
        "--component",
        metavar="N",
        type=int,
        help="the piece to match of meshes with several, from 1 for the largest (default: the one that stands out)",
    )
    parser.add_argument("--pairs", metavar="WORD", default="all", help="'all' (default), 'star', 'tree' or a file")
    parser.add_argument(
        "--consistency",
        metavar="WORD",
        default="auto",
        help="'repair' replaces maps that contradict the others, 'all' also makes the maps of all pairs that were not "
        "matched, 'none' does neither (default: 'all' for a star and a tree, else 'repair')",
    )
    parser.add_argument("--resume", action="store_true", help="go on with the collection in DIR: do what is missing")
    parser.add_argument("--workers", metavar="N", type=int, help="worker processes (default: one a processor)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="use the workers of this Dask scheduler instead")
    parser.add_argument(
        "--keep", metavar="WORD", default="maps", help="'maps' (default): maps and C of a pair; 'full': whole results"
    )
    parser.add_argument(
        "--latent", metavar="N", type=int, default=60, help="eigenfunctions in the network (default: %(default)s)"
    )
    parser.add_argument("--cache", metavar="FOLDER", type=Path, help="prepared shapes (default: DIR/shapes)")
    parser.add_argument("--cache-limit", metavar="GB", type=float, help="largest size of the prepared shapes")
    # Not offered, but known, so that the answer can name --cache FOLDER.
    parser.add_argument("--no-cache", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--no-picture", action="store_true", help=f"do not draw the shapes in {PAGE_FILE}")
    parser.add_argument("--no-report", action="store_true", help=f"write neither {PAGE_FILE} nor a page for each pair")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Match the collection, show its failures, write its page; 1 when a shape or a pair failed."""
    options = options_from(args)
    if args.component is not None:
        options = options.replace({"surface.component": args.component})
    if args.no_cache:
        raise OptionError("a collection works from its prepared shapes: --cache FOLDER puts them elsewhere")
    terminal = Terminal(quiet=args.quiet, as_json=args.json)

    from clalign.collection.run import match_collection
    from clalign.presentation.collection_page import write_collection_page, write_pair_page

    try:
        with terminal.progress() as progress:
            collection = match_collection(
                args.shapes,
                args.out,
                options,
                pairs=args.pairs,
                consistency=args.consistency,
                scheduler=args.scheduler,
                workers=args.workers,
                resume=args.resume,
                keep=args.keep,
                latent=args.latent,
                cache=args.cache,
                cache_limit=None if args.cache_limit is None else round(args.cache_limit * 1e9),
                pages=None if args.no_report else write_pair_page,
                progress=progress,
            )
    except KeyboardInterrupt:
        terminal.warn(f"interrupted: what is done is in {args.out}; the same command with --resume goes on from there")
        return EXIT_INTERRUPTED
    if not args.no_report:
        try:
            write_collection_page(collection, collection.folder / PAGE_FILE, pictures=not args.no_picture)
        except OSError as error:
            terminal.warn(f"{PAGE_FILE} was not written: {error}")
    _show_summary(collection, terminal)
    return 1 if collection.failures else 0


def _show_summary(collection: Collection, terminal: Terminal) -> None:
    for failure in collection.failures:
        terminal.warn(failure)
    found = Counter(row.kind for row in collection.pairs if row.ok)
    kinds = {kind: found[kind] for kind in ("direct", "repaired", "derived")}
    done = sum(kinds.values())
    said = ", ".join(f"{count} {kind}" for kind, count in kinds.items() if count)
    shapes = sum(1 for row in collection.shapes if row.ok)
    seconds = sum(row.seconds or 0.0 for row in collection.pairs)
    rows = [
        ("shapes", f"{shapes}, {len(collection.shapes) - shapes} failed"),
        ("pairs", f"{done} ({said or 'none'}), {len(collection.pairs) - done} without a map"),
        ("work", f"{seconds:.0f} s on pairs, by all workers together"),
        ("result", str(collection.folder)),
    ]
    page = collection.folder / PAGE_FILE
    if page.is_file():
        rows[-1] = ("result", f"{collection.folder}, open {page} in a browser")
    for line in table(rows, indent=""):
        terminal.say(line)
    terminal.document(
        {
            "folder": str(collection.folder),
            "shapes": len(collection.shapes),
            "pairs": {**kinds, "without": len(collection.pairs) - done},
            "failures": list(collection.failures),
        }
    )
