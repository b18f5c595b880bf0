"""What ``match`` and ``demo`` share: options, the match with its progress, the result folder and the summary."""

from __future__ import annotations

import argparse
import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clalign.cli.interrupts import Interrupts
from clalign.cli.terminal import Terminal, table
from clalign.ctrl_c import plain_interrupts
from clalign.errors import ClalignWarning, OptionError
from clalign.options import Options
from clalign.storage.folders import check_destination

if TYPE_CHECKING:
    from clalign.correspondence import Correspondence
    from clalign.evaluation.errors import Evaluation
    from clalign.evaluation.truth import Truth
    from clalign.mesh.mesh import Mesh

PICTURE_FILE = "match.png"
REPORT_FILE = "report.html"
EVALUATION_FILE = "evaluation.json"

#: Lengths are in sqrt(area); the literature prints them times 100.
_PERCENT = 100.0


@dataclass(frozen=True)
class Truths:
    """The true map, and that of the left-right confusion where it is known."""

    truth: Truth
    mirrored: Truth | None = None


def add_job_arguments(parser: argparse.ArgumentParser, default_folder: Path) -> None:
    """Add the arguments that every command has which matches one pair."""
    parser.add_argument(
        "--out", metavar="DIR", type=Path, default=default_folder, help="result folder (default: %(default)s)"
    )
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
        "--metric", metavar="NAME", help="'power' (default), 'regularized', 'euclidean', 'heat-kernel' or 'auto'"
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
    parser.add_argument("--no-cache", action="store_true", help="compute everything anew and store nothing for later")
    parser.add_argument("--no-picture", action="store_true", help="do not draw match.png")
    parser.add_argument("--no-report", action="store_true", help="do not write report.html")
    parser.add_argument("--quiet", action="store_true", help="show nothing but warnings and errors")
    parser.add_argument("--json", action="store_true", help="print the summary as one JSON document")


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


def run_job(
    source_path: Path,
    target_path: Path,
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

    from clalign.correspondence import FACTS_FILE
    from clalign.mesh.mesh import load_mesh

    with Interrupts() as interrupts:
        source, target = load_mesh(source_path), load_mesh(target_path)
        truths = truths_of(source, target)
        device = _device(options)
        # Last, so that no mistake elsewhere comes to light only after --force was added.
        check_destination(args.out, FACTS_FILE, force=force)
        terminal.note(f"device: {device}")
        for role, mesh in (("source", source), ("target", target)):
            terminal.note(f"{role}: {mesh.path}, {mesh.n_vertices:,} vertices, {mesh.n_faces:,} faces")
        result = _matched(source, target, options, args, terminal, interrupts)
    evaluation = None
    try:
        with plain_interrupts():
            if truths is not None:
                from clalign.evaluation.errors import evaluate

                evaluation = evaluate(result, truths.truth, mirrored=truths.mirrored, seed=options.seed)
            result.save(args.out, force=force, extra_files=_extra_files(result, evaluation, args, terminal))
    except KeyboardInterrupt:
        # What is in the folder by now, if anything, is this result.
        result.save(args.out, force=True)
        terminal.warn(f"interrupted: {args.out} has the maps, without picture, page and measured errors")
    _show_summary(result, evaluation, args.out, terminal)
    return 0


def _device(options: Options) -> str:
    """Return the device that the match will use, found before the long work so that a missing one is told at once."""
    if options.engine.backend == "reference":
        return "numpy, double precision"
    from clalign.engine.device_choice import choose_device, list_devices, wanted_device

    return choose_device(wanted_device(options.engine.device), list_devices()).label


def _matched(
    source: Mesh,
    target: Mesh,
    options: Options,
    args: argparse.Namespace,
    terminal: Terminal,
    interrupts: Interrupts,
) -> Correspondence:
    """Match, and show each warning once: those that a user should read are raised and kept in the result, too."""
    import clalign
    from clalign.geometry.cache import ShapeCache

    match = clalign.match
    interrupts.raise_missed()
    cache = None if args.no_cache else ShapeCache()
    with warnings.catch_warnings(record=True) as seen, terminal.progress() as progress:
        warnings.simplefilter("always", ClalignWarning)
        result = match(source, target, options, progress=progress, cache=cache)
    raised = [str(warning.message) for warning in seen if issubclass(warning.category, ClalignWarning)]
    for message in dict.fromkeys([*result.warnings, *raised]):
        terminal.warn(message)
    return result


def _extra_files(
    result: Correspondence, evaluation: Evaluation | None, args: argparse.Namespace, terminal: Terminal
) -> Callable[[Path], None]:
    def picture(path: Path) -> None:
        from clalign.presentation.picture import save_match_picture

        save_match_picture(result, path)

    def report(path: Path) -> None:
        from clalign.presentation.report import write_report

        write_report(result, path, evaluation=evaluation)

    def write(folder: Path) -> None:
        if evaluation is not None:
            evaluation.write_json(folder / EVALUATION_FILE)
        if not args.no_picture:
            _drawn(picture, folder / PICTURE_FILE, terminal)
        if not args.no_report:
            _drawn(report, folder / REPORT_FILE, terminal)

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
    rows = [
        ("device", result.device),
        ("timings", stages),
        ("losses", losses),
        ("confidence", f"{_confidence(result.confidence)}{_orientation(result.orientation)}"),
    ]
    if evaluation is not None:
        rows += _error_rows(evaluation)
    page = f", open {folder / REPORT_FILE} in a browser" if (folder / REPORT_FILE).is_file() else ""
    rows.append(("result", f"{folder}{page}"))
    for line in table(rows, indent=""):
        terminal.say(line)
    document = {"folder": str(folder), **result.facts()}
    if evaluation is not None:
        document["evaluation"] = evaluation.as_dict()
    terminal.document(document)


def _confidence(value: float) -> str:
    return "not known, as no other map was looked for" if math.isnan(value) else f"{value:.2f} of 1"


def _orientation(value: float) -> str:
    if math.isnan(value):
        return ""
    return f"; orientation {value:+.2f} (+1 kept everywhere, -1 mirrored)"


def _error_rows(evaluation: Evaluation) -> list[tuple[str, str]]:
    rows = [
        (
            "error",
            f"mean {_PERCENT * evaluation.mean:.3f}, median {_PERCENT * evaluation.median:.3f} (x100 / sqrt(area), "
            f"{evaluation.points.size} points), exact {evaluation.exact:.1%}",
        )
    ]
    if evaluation.mirrored_mean is not None:
        rows.append(("mirrored", f"mean {_PERCENT * evaluation.mirrored_mean:.3f} to the mirror image of the truth"))
    return rows
