"""``clalign match SOURCE TARGET`` and ``clalign demo``: match two meshes and write the result folder."""

from __future__ import annotations

import argparse
import math
import signal
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clalign.cli.evaluate import bundled_truths, read_truth
from clalign.cli.pair_input import PairInput, add_input_arguments
from clalign.cli.terminal import Terminal, table
from clalign.ctrl_c import plain_interrupts
from clalign.data import bundled_pair
from clalign.errors import ClalignWarning, OptionError
from clalign.options import Options
from clalign.presentation import PAGE_FILE, PICTURE_FILE
from clalign.storage.folders import check_destination

if TYPE_CHECKING:
    from clalign.correspondence import Correspondence
    from clalign.evaluation.errors import Evaluation
    from clalign.evaluation.truth import Truth
    from clalign.mesh.mesh import Mesh

    Truths = tuple[Truth, Truth | None]
    """The true map, and that of the left-right confusion where it is known."""

EVALUATION_FILE = "evaluation.json"

_DESCRIPTION = """\
Find for every vertex of SOURCE the corresponding vertex of TARGET, and the other way round. Meshes are files
of one body each: OFF, PLY, OBJ, STL, glTF, 3MF, VTK, GIFTI or FreeSurfer. The result folder gets both maps as text
(line i: 0-based vertex of the other file), result.npz, result.json, match.png and report.html (open it in a browser);
it is written wholly or not at all.
"""

_EPILOG = """\
examples:
  clalign match cat0.off cat7.off
  clalign match a.ply b.ply --out a-to-b --truth identity --seed 1
  clalign match a.ply b.ply --truth points-on-a.txt points-on-b.txt
  clalign match a.ply b.ply --preset fast --set spectrum.basis=80 --set alignment.weight=50
"""


def add_match(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``match`` to the program."""
    parser = subparsers.add_parser("match", help="match two mesh files", description=_DESCRIPTION, epilog=_EPILOG)
    parser.add_argument("source", metavar="SOURCE", type=Path, help="mesh whose vertices are mapped")
    parser.add_argument("target", metavar="TARGET", type=Path, help="mesh that they are mapped to")
    add_job_arguments(parser, Path("clalign-result"))
    _add_file_arguments(parser)
    parser.add_argument("--force", action="store_true", help="replace an earlier result in DIR")
    add_input_arguments(parser)
    parser.add_argument(
        "--truth",
        metavar="FILE",
        nargs="+",
        action="extend",
        default=[],
        help="after the meshes; measure the error: FILE holds the target vertex (0-based) of source vertex i in line "
        "i, or is the word 'identity'; with two files, line i of both names the same point on source and target",
    )
    parser.set_defaults(run=run_match)


def run_match(args: argparse.Namespace) -> int:
    """Match the two files of the command line."""

    def truths(source: Mesh, target: Mesh) -> Truths | None:
        return (read_truth(args.truth, None, source, target), None) if args.truth else None

    return _run(PairInput.of(args), args, truths, force=args.force)


def add_demo(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``demo`` to the program."""
    parser = subparsers.add_parser(
        "demo",
        help="match the bundled pair and compare it with the truth",
        description="Match one person in two poses, bundled with clalign, and compare the map with the truth and "
        "with its mirror image. An earlier result of the demo in DIR is replaced.",
    )
    add_job_arguments(parser, Path("clalign-demo"))
    _add_file_arguments(parser)
    parser.set_defaults(run=run_demo)


def run_demo(args: argparse.Namespace) -> int:
    """Match the bundled pair."""
    return _run(PairInput(bundled_pair().source, bundled_pair().target), args, bundled_truths, force=True)


def add_job_arguments(parser: argparse.ArgumentParser, default_folder: Path) -> None:
    """Add the arguments that every command has which matches: where to, how, and what it shows."""
    parser.add_argument(
        "--out", metavar="DIR", type=Path, default=default_folder, help="result folder (default: %(default)s)"
    )
    add_method_arguments(parser)


def add_method_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that say how to match, and what the command shows."""
    parser.add_argument(
        "--preset",
        metavar="NAME",
        default="default",
        help="'default', 'fast', or 'paper' for the method as printed (default: %(default)s)",
    )
    parser.add_argument(
        "--device",
        metavar="SPEC",
        help="'gpu', 'cpu', PLATFORM:DEVICE numbers or part of a name as 'clalign doctor' lists them, or 'reference' "
        "for plain numpy",
    )
    parser.add_argument("--seed", metavar="N", type=int, help="seed of everything that is drawn (default: 0)")
    parser.add_argument(
        "--orientation", metavar="WORD", help="'preserving' (default), 'reversing' for mirrored maps, or 'any'"
    )
    parser.add_argument(
        "--partial",
        metavar="WORD",
        nargs="?",
        const="source",
        help="after the meshes; which mesh is a part of the other: 'source' (also without a word), 'target', 'none' "
        "for two wholes, or 'auto' (default), by boundaries and areas",
    )
    parser.add_argument(
        "--scale", metavar="WORD", help="of a part: 'same' if both files have one unit, or 'auto' to find it (default)"
    )
    parser.add_argument(
        "--metric", metavar="NAME", help="'power' (default), 'regularized', 'euclidean', 'heat-kernel' or 'auto'"
    )
    parser.add_argument(
        "--strict",
        action="store_true",
        help="refuse a mesh that is no clean surface instead of reading it as the one that was most likely meant",
    )
    parser.add_argument("--alternatives", metavar="N", type=int, help="keep the N best different maps too")
    parser.add_argument(
        "--set",
        metavar="GROUP.NAME=VALUE",
        action="append",
        default=[],
        dest="changes",
        help="change any single option; may be repeated; 'clalign options' lists all of them",
    )
    parser.add_argument("--quiet", action="store_true", help="show nothing but warnings and errors")
    parser.add_argument("--json", action="store_true", help="print the summary as one JSON document")


def _add_file_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what says which files one match reads and writes beside its result."""
    parser.add_argument("--no-cache", action="store_true", help="compute everything anew and store nothing for later")
    parser.add_argument("--no-picture", action="store_true", help=f"do not draw {PICTURE_FILE}")
    parser.add_argument("--no-report", action="store_true", help=f"do not write {PAGE_FILE}")


def options_from(args: argparse.Namespace) -> Options:
    """Return the options of a command line: preset, then the named arguments, then every ``--set``.

    Raises
    ------
    OptionError
        An unknown preset or option, or a value outside its range.
    """
    named = {
        "search.orientation": args.orientation,
        "search.alternatives": args.alternatives,
        "spectrum.metric": args.metric,
        "partial.part": args.partial,
        "partial.scale": args.scale,
        "surface.strict": True if args.strict else None,
    }
    changes = {name: value for name, value in named.items() if value is not None}
    return Options.preset(args.preset).replace({**changes, **option_changes(args)})


def option_changes(args: argparse.Namespace) -> dict[str, Any]:
    """Return the changes to options that ``--seed``, ``--device`` and every ``--set`` ask for.

    Raises
    ------
    OptionError
        A ``--set`` without a value.
    """
    changes: dict[str, Any] = {} if args.seed is None else {"seed": args.seed}
    if args.device is not None:
        changes["engine.backend" if args.device == "reference" else "engine.device"] = args.device
    for change in args.changes:
        name, equals, value = change.partition("=")
        if not equals:
            raise OptionError(f"--set {change}: expected GROUP.NAME=VALUE, such as alignment.weight=50")
        changes[name.strip()] = value.strip()
    return changes


def _run(
    given: PairInput,
    args: argparse.Namespace,
    truths_of: Callable[[Mesh, Mesh], Truths | None],
    *,
    force: bool,
) -> int:
    """Match two files, write the result folder, show the summary, and return the exit status.

    Everything that can be wrong with the input is found before the long work starts.
    """
    options = options_from(args)
    terminal = Terminal(quiet=args.quiet, as_json=args.json)

    import clalign
    from clalign.correspondence import FACTS_FILE

    with missed_interrupts() as raise_missed:
        source, target = given.meshes(options.surface)
        known = given.known(source, target)
        truths = truths_of(source, target)
        device = device_label(options)
        # Last, so that no mistake elsewhere comes to light only after --force was added.
        check_destination(args.out, FACTS_FILE, force=force)
        terminal.note(f"device: {device}")
        for role, mesh in (("source", source), ("target", target)):
            terminal.note(f"{role}: {mesh.path}, {mesh.n_vertices:,} vertices, {mesh.n_faces:,} faces")
        result = matched(partial(clalign.match, source, target, options, **known), args, terminal, raise_missed)
    evaluation = None
    try:
        with plain_interrupts():
            if truths is not None:
                from clalign.evaluation.errors import evaluate

                evaluation = evaluate(result, truths[0], mirrored=truths[1], seed=options.seed)
            result.save(args.out, force=force, extra_files=_extra_files(result, evaluation, args, terminal))
    except KeyboardInterrupt:
        # What is in the folder by now, if anything, is this result.
        result.save(args.out, force=True)
        terminal.warn(f"interrupted: {args.out} has the maps, without picture, page and measured errors")
    _show_summary(result, evaluation, args.out, terminal)
    return 0


def device_label(options: Options) -> str:
    """Return the device that the match will use, found before the long work so that a missing one is told at once."""
    if options.engine.backend == "reference":
        return "numpy, double precision"
    from clalign.engine.device_choice import choose_device, list_devices, wanted_device

    return choose_device(wanted_device(options.engine.device), list_devices()).label


def matched(
    match: Callable[..., Correspondence],
    args: argparse.Namespace,
    terminal: Terminal,
    raise_missed: Callable[[], None],
) -> Correspondence:
    """Match, and show each warning once: those that a user should read are raised and kept in the result, too."""
    from clalign.geometry.cache import ShapeCache

    raise_missed()
    cache = None if args.no_cache else ShapeCache()
    with warnings.catch_warnings(record=True) as seen, terminal.progress() as progress:
        warnings.simplefilter("always", ClalignWarning)
        result = match(progress=progress, cache=cache)
    raised = [str(warning.message) for warning in seen if issubclass(warning.category, ClalignWarning)]
    for message in dict.fromkeys([*result.warnings, *raised]):
        terminal.warn(message)
    return result


def _extra_files(
    result: Correspondence, evaluation: Evaluation | None, args: argparse.Namespace, terminal: Terminal
) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        from clalign.presentation.picture import save_match_picture
        from clalign.presentation.report import write_report

        if evaluation is not None:
            evaluation.write_json(folder / EVALUATION_FILE)
        if not args.no_picture:
            _drawn(partial(save_match_picture, result), folder / PICTURE_FILE, terminal)
        if not args.no_report:
            _drawn(partial(write_report, result, evaluation=evaluation), folder / PAGE_FILE, terminal)

    return write


def _drawn(draw: Callable[[Path], None], path: Path, terminal: Terminal) -> None:
    """Draw one file; minutes of matching are not thrown away for a picture, but a full disk is for `save` to report."""
    try:
        draw(path)
    except OSError:
        raise
    except Exception as error:
        path.unlink(missing_ok=True)
        terminal.warn(f"{path.name} was not drawn: {type(error).__name__}: {error}")


def _show_summary(result: Correspondence, evaluation: Evaluation | None, folder: Path, terminal: Terminal) -> None:
    stages = ", ".join(f"{stage} {seconds:.1f} s" for stage, seconds in result.timings.items())
    losses = ", ".join(f"{name} {value:.4g}" for name, value in result.losses.items())
    confidence = "not known, as no other map was looked for"
    if not math.isnan(result.confidence):
        confidence = f"{result.confidence:.2f} of 1"
    if not math.isnan(result.orientation):
        confidence += f"; orientation {result.orientation:+.2f} (+1 kept everywhere, -1 mirrored)"
    rows = [("device", result.device), ("timings", stages), ("losses", losses or "none: R was not optimised")]
    rows.append(("confidence", confidence))
    if evaluation is not None:
        # Lengths are in sqrt(area); the literature prints them times 100.
        mean, median = 100 * evaluation.mean, 100 * evaluation.median
        measured = f"(x100 / sqrt(area), {evaluation.points.size} points), exact {evaluation.exact:.1%}"
        rows.append(("error", f"mean {mean:.3f}, median {median:.3f} {measured}"))
        if evaluation.mirrored_mean is not None:
            rows.append(("mirrored", f"mean {100 * evaluation.mirrored_mean:.3f} to the mirror image of the truth"))
    page = f", open {folder / PAGE_FILE} in a browser" if (folder / PAGE_FILE).is_file() else ""
    rows.append(("result", f"{folder}{page}"))
    for line in table(rows, indent=""):
        terminal.say(line)
    document = {"folder": str(folder), **result.facts()}
    if evaluation is not None:
        document["evaluation"] = evaluation.as_dict()
    terminal.document(document)


@contextmanager
def missed_interrupts() -> Iterator[Callable[[], None]]:
    """Yield a function that raises the KeyboardInterrupt which something has swallowed; to be called after imports.

    Around its optional imports trimesh catches even KeyboardInterrupt; a program that imports it lazily would run on
    for minutes after a Ctrl-C at the wrong moment. The KeyboardInterrupt itself is raised as ever.
    """
    seen = False

    def note(*arguments: Any) -> None:
        nonlocal seen
        seen = True
        signal.default_int_handler(*arguments)

    def raise_missed() -> None:
        if seen:
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield raise_missed
        return
    previous = signal.signal(signal.SIGINT, note)
    try:
        yield raise_missed
    finally:
        signal.signal(signal.SIGINT, previous)
