"""Entry point of the ``clalign`` command.

A command is ``add_parser(subparsers)`` and ``run(args) -> int`` in a module of this folder. Modules are imported for
``--help``, so they import everything heavy inside ``run``.
"""

from __future__ import annotations

import argparse
import contextlib
import difflib
import errno
import io
import logging
import os
import sys
import traceback
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from clalign import __version__
from clalign.cli import bench, cache, check, collection, doctor, evaluate, figures, match, options, register, saved
from clalign.cli.terminal import EXIT_INTERRUPTED
from clalign.ctrl_c import plain_interrupts
from clalign.errors import ClalignError, ClalignWarning, DeviceError, InputError

EXIT_FAILED = 1
EXIT_USAGE = 2


#: Each adds its parser, with the function that runs it as the default of ``run``.
COMMANDS: tuple[Callable[[Any], None], ...] = (
    *(match.add_match, match.add_demo, check.add_parser, collection.add_parser),
    *(
        saved.add_show,
        saved.add_transfer,
        saved.add_export,
        register.add_parser,
        evaluate.add_parser,
        figures.add_parser,
    ),
    *(bench.add_parser, cache.add_parser, options.add_parser, doctor.add_parser),
)

_DESCRIPTION = "Dense correspondence between two non-rigid triangle meshes, computed with OpenCL."
_EPILOG = """\
exit status: 0 done, 1 failed, 2 bad input or usage, 130 interrupted with nothing to keep
environment: CLALIGN_DEVICE (default of --device), CLALIGN_CACHE (folder of the cache), CLALIGN_DEBUG=1 (full traces)
"""


class _WideHelp(argparse.RawDescriptionHelpFormatter):
    """Leaves room for the longest command beside its description."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=18)
        # argparse leaves the indentation of commands out of the width that it computes.
        self._action_max_length = 14


class _CommandParser(argparse.ArgumentParser):
    """Refuses what a command does not know itself; argparse leaves that to the program, whose usage says nothing.

    Descriptions and epilogues of several lines are shown as they stand.
    """

    def __init__(self, **settings: Any) -> None:
        whole = "\n" in f"{settings.get('description')}{settings.get('epilog') or ''}"
        formatter = argparse.RawDescriptionHelpFormatter if whole else argparse.HelpFormatter
        super().__init__(**{"allow_abbrev": False, "formatter_class": formatter, **settings})

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Return the namespace and no left-over words."""
        namespace, left = super().parse_known_args(args, namespace)
        if left:
            self.error(f"unrecognized arguments: {' '.join(left)}{self._meant(left)}")
        return namespace, left

    def _meant(self, words: Sequence[str]) -> str:
        wrong = next((word.partition("=")[0] for word in words if word.startswith("--")), "")
        known = [name for action in self._actions for name in action.option_strings]
        near = difflib.get_close_matches(wrong, known, 1)
        return f"; did you mean {near[0]}?" if near else ""


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the program with all commands."""
    parser = argparse.ArgumentParser(
        prog="clalign",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=_WideHelp,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"clalign {__version__}")
    subparsers = parser.add_subparsers(title="commands", metavar="COMMAND", required=True, parser_class=_CommandParser)
    for add in COMMANDS:
        add(subparsers)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status; no failure that clalign raises on purpose shows a stack trace."""
    parser = build_parser()
    words = sys.argv[1:] if arguments is None else arguments
    if not words:
        parser.print_help(sys.stderr)
        return EXIT_USAGE
    args = parser.parse_args(words)
    debug = os.environ.get("CLALIGN_DEBUG", "") not in ("", "0")
    _set_up_messages(debug)
    for stream in (sys.stdout, sys.stderr):
        # Names of files may be no UTF-8, and the terminal's encoding may lack letters of a message.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        with plain_interrupts():
            status: int = args.run(args)
        sys.stdout.flush()
        return status
    except BrokenPipeError:
        # The reader of standard output has gone; without this Python would complain once more while shutting down.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_FAILED
    except KeyboardInterrupt:
        print("interrupted: there was nothing to keep yet", file=sys.stderr)
        return EXIT_INTERRUPTED
    except ClalignError as error:
        if debug:
            traceback.print_exc()
        print(f"error: {error}", file=sys.stderr)
        if isinstance(error, DeviceError):
            for line in doctor.brief(str(error)):
                print(line, file=sys.stderr)
        return exit_status(error)
    except Exception as error:  # the last resort between a defect and a user
        if debug:
            raise
        print(f"error: {_unforeseen(error)}", file=sys.stderr)
        return EXIT_FAILED


def program() -> NoReturn:
    """Run the command line of this process and end it; after Ctrl-C no thread that still computes is waited for."""
    status = main()
    if status == EXIT_INTERRUPTED:
        for stream in (sys.stdout, sys.stderr):
            # The reader may have gone: Ctrl-C ends all the programs of a pipe.
            with contextlib.suppress(OSError):
                stream.flush()
        os._exit(status)
    sys.exit(status)


def exit_status(error: ClalignError) -> int:
    """Return 2 for input that cannot be used and 1 for a failure, which a full disk is however it is reported."""
    cause = error.__cause__
    if isinstance(cause, OSError) and cause.errno in (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG):
        return EXIT_FAILED
    return EXIT_USAGE if isinstance(error, InputError) else EXIT_FAILED


def _unforeseen(error: Exception) -> str:
    if isinstance(error, MemoryError):
        return "the machine has no memory left for this; 'clalign match --preset fast' needs less"
    what = f"{type(error).__name__}: {error}".rstrip(": ").replace("\n", " ")
    return f"{what} (not foreseen; please report it with the trace that CLALIGN_DEBUG=1 shows)"


def _set_up_messages(debug: bool) -> None:
    """Send the library's log and Python's warnings to standard error, one line each."""
    logging.basicConfig(
        stream=sys.stderr,
        level=logging.DEBUG if debug else logging.ERROR,
        format="%(levelname)s %(name)s: %(message)s",
    )
    logging.getLogger("clalign").setLevel(logging.DEBUG if debug else logging.WARNING)
    for noisy in ("matplotlib", "PIL", "pytools", "trimesh"):
        logging.getLogger(noisy).setLevel(logging.WARNING)
    if not debug:
        warnings.showwarning = _show_warning


def _show_warning(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
    # What other libraries warn of (deprecations, mostly) is nothing that a user of the command can act on.
    if issubclass(category, ClalignWarning):
        print(f"warning: {message}", file=sys.stderr)


if __name__ == "__main__":
    program()
