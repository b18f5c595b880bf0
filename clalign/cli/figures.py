"""``clalign figures``: the paper's figures, drawn of any pair, with the numbers beside them."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from clalign.benchmark.methods import method_runs, split_list
from clalign.cli.bench.common import add_option_arguments
from clalign.cli.evaluate import bundled_truths, read_truth
from clalign.cli.match import option_changes
from clalign.cli.terminal import Terminal
from clalign.data import bundled_pair
from clalign.errors import OptionError, ResultError
from clalign.options import Options

if TYPE_CHECKING:
    from clalign.benchmark.pairs import LoadedPair
    from clalign.correspondence import Correspondence
    from clalign.matching.loop import Progress
    from clalign.presentation.figures.gallery import Subject

DEFAULT_FOLDER = Path("clalign-figures")

_DESCRIPTION = """\
Draw the paper's figures of a pair: a result folder of 'clalign match', two mesh files, or the bundled pair when nothing
is named. Each becomes figure-N.png, figure-N.svg and figure-N.csv with the numbers. Of a result that was matched with
options of its own, figures 5, 7, 8 and 9 are not drawn: they compare it with variants of the default. A folder of
'clalign bench' gives the error curves (--which 5) of all its pairs.
"""

_EPILOG = """\
figures:
  1  eigenfunctions 2-5, 12-15, 22-25 on both shapes, before and after alignment
  2  a rotation inside a pair of eigenfunctions, and the one recovered        (needs --truth)
  3  |C~| from the truth with its funnel, and the mask                        (needs --truth)
  5  error curves of the method as printed, its variants and this program     (needs --truth; matches 5 times)
  6  matched colours
  7  the paper's start, a mirrored result, and the search that avoids it      (needs --truth; matches 4 times)
  8  one eigenfunction under the variants                                     (needs --truth; matches 3 times)
  9  err(k) of every eigenfunction: unaligned, aligned, cycle term, isometry  (needs --truth; matches 3 times)
truth: as of 'clalign evaluate'; the bundled pair has its own
examples:
  clalign figures --which 1,2,3,6,9
  clalign figures a.ply b.ply --truth identity --mirror mirror.txt --which all
  clalign figures clalign-bench-faust --which 5
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``figures`` to the program."""
    parser = subparsers.add_parser("figures", help="draw the paper's figures", description=_DESCRIPTION, epilog=_EPILOG)
    parser.add_argument("paths", metavar="RESULT|SOURCE TARGET", nargs="*", type=Path, help="what figures are drawn of")
    parser.add_argument("--which", metavar="NUMBERS", default="all", help="comma-separated, or 'all' (default)")
    parser.add_argument("--out", metavar="DIR", type=Path, default=DEFAULT_FOLDER, help="folder (default: %(default)s)")
    parser.add_argument("--truth", metavar="FILE", nargs="+", help="the true map: 'identity', one file, or two")
    parser.add_argument("--truth-base", type=int, choices=(0, 1), help="first vertex number in the truth")
    parser.add_argument("--mirror", metavar="FILE", help="line i: number (from 0) of the mirror image of point i")
    parser.add_argument("--variants", metavar="METHODS", help="methods of 'clalign bench' in figures 5, 7, 8 and 9")
    parser.add_argument("--index", metavar="K", type=int, default=7, help="eigenfunction of figure 8 (default: 7)")
    parser.add_argument(
        "--pair-index", metavar="K", type=int, help="first eigenfunction of figure 2 (default: most turned)"
    )
    parser.add_argument(
        "--height", metavar="N", type=int, default=300, help="pixels of a panel of one shape (default: 300)"
    )
    add_option_arguments(parser, preset=False)
    parser.add_argument("--no-cache", action="store_true", help="compute everything anew and store nothing for later")
    parser.add_argument("--quiet", action="store_true", help="show nothing but warnings and errors")
    parser.add_argument("--json", action="store_true", help="print the names of the files as one JSON document")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Draw the figures of the command line; those that were asked for by number must be possible."""
    from clalign.benchmark.records import RECORDS_FILE
    from clalign.presentation.figures.gallery import PLANS, draw_recorded_curves
    from clalign.presentation.figures.sheet import save_drawing

    terminal = Terminal(quiet=args.quiet, as_json=args.json)
    wanted = _wanted(args.which, tuple(PLANS))
    written: dict[str, list[str]] = {}
    if len(args.paths) == 1 and (args.paths[0] / RECORDS_FILE).is_file():
        if args.which != "all" and wanted != ["5"]:
            raise OptionError("the folder of a benchmark has error curves only: ask for --which 5")
        paths = save_drawing(draw_recorded_curves(args.paths[0]), args.out, "figure-5")
        written["5"] = [str(path) for path in paths]
    else:
        with terminal.progress() as progress:
            subject = _subject(args, terminal, progress)
            for number in _possible(wanted, subject, explicit=args.which != "all", terminal=terminal):
                terminal.note(f"figure {number}: {PLANS[number].title}")
                paths = save_drawing(PLANS[number].draw(subject), args.out, f"figure-{number}")
                written[number] = [str(path) for path in paths]
    for number, names in written.items():
        terminal.say(f"figure {number}: {', '.join(names)}")
    terminal.document({"figures": written})
    return 0


def _wanted(text: str, known: tuple[str, ...]) -> list[str]:

    if text == "all":
        return list(known)
    numbers = [number.strip() for number in text.split(",") if number.strip()]
    unknown = [number for number in numbers if number not in known]
    if unknown or not numbers:
        raise OptionError(f"--which {text}: there are {', '.join(known)} and 'all'")
    return list(dict.fromkeys(numbers))


def _possible(wanted: list[str], subject: Subject, *, explicit: bool, terminal: Terminal) -> list[str]:
    from clalign.presentation.figures.gallery import PLANS

    untrue = [number for number in wanted if PLANS[number].needs_truth and not subject.has_truth]
    unlike = [number for number in wanted if PLANS[number].compares and not subject.comparable]
    unlike = [number for number in unlike if number not in untrue]
    for numbers, why in (
        (untrue, "without --truth"),
        (unlike, "of a result with options of its own: name its meshes"),
    ):
        if numbers and explicit:
            raise OptionError(f"figure {', '.join(numbers)} cannot be drawn {why}")
        if numbers:
            terminal.warn(f"there is no figure {', '.join(numbers)} {why}")
    return [number for number in wanted if number not in untrue + unlike]


def _subject(args: argparse.Namespace, terminal: Terminal, progress: Progress) -> Subject:
    """Read the pair, its truth and what is matched already."""
    from clalign.benchmark.pairs import LoadedPair
    from clalign.geometry.cache import ShapeCache
    from clalign.mesh.mesh import load_mesh
    from clalign.presentation.figures.gallery import MAIN, Subject

    if args.height < 20:
        raise OptionError(f"--height must be at least 20, got {args.height}")
    if len(args.paths) > 2:
        raise OptionError(f"name one result folder or two meshes, not {len(args.paths)} paths")
    known: Correspondence | None = None
    if not args.paths and (args.truth or args.mirror):
        raise OptionError("--truth and --mirror are of a pair that is named; the bundled pair has its own truth")
    if args.mirror and not args.truth:
        raise OptionError("--mirror is of the points of a truth: give --truth too")
    if not args.paths:
        source, target = (load_mesh(path) for path in bundled_pair()[:2])
        pair = LoadedPair("bundled humans", source, target, *bundled_truths(source, target))
    else:
        pair, known = _named(args)
    changes = option_changes(args)
    if known is not None and args.changes:
        raise OptionError("--set changes nothing of a result that is there: name the two meshes instead")
    default = Options()
    comparable = known is None or dataclasses.replace(known.options, engine=default.engine, seed=0) == default

    def watch(name: str) -> Progress:
        terminal.note(f"matching by {name}")
        return progress

    runs = method_runs(
        pair,
        changes,
        cache=None if args.no_cache else ShapeCache(),
        watch=watch,
        known={} if known is None else {MAIN: known},
    )
    names = tuple(split_list(args.variants)) if args.variants else ()
    return Subject(pair, runs, names, args.index, args.pair_index, args.height, comparable, args.seed)


def _named(args: argparse.Namespace) -> tuple[LoadedPair, Correspondence | None]:
    from clalign.benchmark.pairs import LoadedPair
    from clalign.correspondence import Correspondence
    from clalign.evaluation.truth import Truth, read_mirror
    from clalign.mesh.mesh import load_mesh

    known: Correspondence | None = None
    if len(args.paths) == 1:
        if not args.paths[0].is_dir():
            raise ResultError(f"{args.paths[0]}: no result folder; a pair is named by two meshes")
        known = Correspondence.load(args.paths[0])
        source, target = known.source, known.target
    else:
        source, target = (load_mesh(path) for path in args.paths)
    truth, mirrored = Truth.unknown(), None
    if args.truth:
        truth = read_truth(args.truth, args.truth_base, source, target)
        mirrored = truth.mirrored(read_mirror(args.mirror)) if args.mirror else None
    return LoadedPair(f"{source.name} {target.name}", source, target, truth, mirrored), known
