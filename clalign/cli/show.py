"""``clalign show RESULT``: look at a saved match."""

from __future__ import annotations

import argparse
import sys
import webbrowser
from pathlib import Path

from clalign.errors import ResultError

_DESCRIPTION = """\
Look at a saved match: both shapes side by side in a window, coloured alike where they match (needs the extra "view",
pip install 'clalign[view]'). With --page, the page report.html opens in the web browser instead.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``show`` to the program."""
    parser = subparsers.add_parser("show", help="look at a saved match", description=_DESCRIPTION)
    parser.add_argument("result", metavar="RESULT", type=Path, help="folder that 'clalign match' wrote")
    parser.add_argument("--page", action="store_true", help="open the page in the web browser")
    parser.add_argument("--screenshot", metavar="FILE", type=Path, help="write a PNG instead of opening a window")
    parser.add_argument("--up", choices=("x", "y", "z"), help="axis of the target that points up")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Open the window or the page."""
    from clalign.correspondence import Correspondence

    if args.page:
        return _open_page(args)
    from clalign.presentation.viewer import show

    show(Correspondence.load(args.result), up=args.up, screenshot=args.screenshot)
    return 0


def _open_page(args: argparse.Namespace) -> int:

    from clalign.correspondence import Correspondence
    from clalign.presentation.report import write_report

    page = args.result.resolve() / "report.html"
    if not page.is_file():
        correspondence = Correspondence.load(args.result)
        try:
            write_report(correspondence, page, up=args.up)
        except OSError as error:
            raise ResultError(f"{page}: cannot be written: {error.strerror or error}") from error
    print(page)
    if webbrowser.open(page.as_uri()):
        return 0
    print("no browser could be started; open this file yourself", file=sys.stderr)
    return 1
