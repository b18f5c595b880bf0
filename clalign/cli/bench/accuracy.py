"""``clalign bench`` humans, animals, faust, robustness, damaged, warped, partial, study: errors of maps over pairs."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from clalign.benchmark.methods import NAMED, named_methods, split_list
from clalign.benchmark.study import STUDIES, methods_of, study_of, study_table
from clalign.cli.bench.common import add_option_arguments, add_output_arguments
from clalign.cli.match import option_changes
from clalign.cli.terminal import EXIT_INTERRUPTED, Terminal
from clalign.errors import InputError, OptionError
from clalign.options import Options
from clalign.storage.files import write_text

if TYPE_CHECKING:
    from clalign.benchmark.layouts import Layout
    from clalign.benchmark.methods import Method
    from clalign.benchmark.records import Record
    from clalign.benchmark.runner import Measurement, Run

_EPILOG = """\
The folder DIR gets pairs.csv (a row a pair, written as soon as it is known), curves.csv, summary.json, summary.md and
curve.png. Run the same command again to go on after an interruption; pairs that failed are tried again.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``humans``, ``animals``, ``faust``, ``robustness``, ``damaged``, ``warped`` and ``partial``."""
    humans = _add(subparsers, "humans", "posed humans, or any folder in their layout")
    humans.add_argument("path", metavar="PATH", type=Path, help="folder of meshes, or of such folders")
    humans.add_argument("--pairs", metavar="FILE", help="run this pairs file only (default: all pairs*.txt in PATH)")
    animals = _add(subparsers, "animals", "folders of frames with one connectivity, every pair of frames")
    animals.add_argument("path", metavar="PATH", type=Path, help="folder of frames, or of such folders")
    faust = _add(subparsers, "faust", "your copy of FAUST, remeshed FAUST, SCAPE or TOSCA")
    faust.add_argument("--root", metavar="DIR", type=Path, required=True, help="tr_reg_*.ply, or *.off (and corres/)")
    faust.add_argument(
        "--pairs",
        metavar="WORD",
        default="intra",
        help="'intra' (first pose of each subject with its others, default), 'inter', or a pairs file",
    )
    faust.set_defaults(methods="paper,paper-cycle,paper-isometric,paper-heat-kernel,default")
    robustness = _add(subparsers, "robustness", "meshes against changed copies of themselves")
    robustness.add_argument("path", metavar="PATH", type=Path, help="folder of meshes")
    robustness.add_argument(
        "--changes",
        dest="alterations",
        metavar="NAMES",
        default="noise,half,rotated,times-1000,times-0.001",
        help="comma-separated; also: normal-noise, subdivided (default: %(default)s)",
    )
    damaged = _add(subparsers, "damaged", "posed humans with damaged targets: as scans and exports are")
    damaged.add_argument("path", metavar="PATH", type=Path, help="folder in the layout of the humans")
    damaged.add_argument("--damages", metavar="NAMES", default="", help="comma-separated (default: all, and 'clean')")
    damaged.add_argument("--pairs", metavar="FILE", help="run this pairs file only (default: all pairs*.txt in PATH)")
    warped = _add(subparsers, "warped", "posed humans with other proportions or touching parts")
    warped.add_argument("path", metavar="PATH", type=Path, help="folder in the layout of the humans")
    warped.add_argument(
        "--warps", metavar="NAMES", default="waves,limbs,ape,trunk,touching", help="default: %(default)s"
    )
    warped.add_argument(
        "--share",
        metavar="PART",
        type=float,
        default=1.0,
        help="remesh each target, to this part of its faces (default: 1, its own triangles)",
    )
    warped.add_argument("--pairs", metavar="FILE", help="run this pairs file only (default: all pairs*.txt in PATH)")
    partial = _add(subparsers, "partial", "parts of posed humans or of animals on other poses of the whole")
    partial.add_argument("path", metavar="PATH", type=Path, help="folder in the layout of the humans or the animals")
    partial.add_argument("--kinds", metavar="NAMES", default="cuts,holes", help="default: %(default)s")
    partial.add_argument("--count", metavar="N", type=int, default=20, help="pairs of each kind (default: 20)")
    partial.add_argument(
        "--factor",
        metavar="F",
        type=float,
        default=1.0,
        help="scale the parts by this factor, as files of another unit would (default: %(default)s)",
    )


def _add(
    subparsers: argparse._SubParsersAction[argparse.ArgumentParser], name: str, text: str
) -> argparse.ArgumentParser:
    parser = subparsers.add_parser(
        name, help=text, description=f"Match all pairs of a data set and measure the errors: {text}.", epilog=_EPILOG
    )
    parser.add_argument(
        "--methods",
        "--variants",
        metavar="METHODS",
        default="default",
        help=f"comma-separated: {', '.join(NAMED)}, or [NAME=]METHOD+OPTION=VALUE+..., such as "
        "heavy=default+alignment.weight=1000 (default: %(default)s)",
    )
    add_option_arguments(parser, preset=False)
    add_run_arguments(parser, f"clalign-bench-{name}")
    parser.add_argument("--points", metavar="N", type=int, help="points measured a pair (default: 500)")
    parser.add_argument(
        "--distances", metavar="METHOD", default="heat", help="'heat' (default), 'bounded' or 'marching'"
    )
    add_output_arguments(parser, None, f"{name}, for whole lists")
    parser.set_defaults(run=run, suite=name)
    return parser


def run(args: argparse.Namespace) -> int:
    """Run the pairs of a suite, show a line a pair, write the summary; 1 when a pair has no map."""
    from clalign.benchmark.damaged import ALL_DAMAGES, damaged
    from clalign.benchmark.layouts import animals, faust, humans
    from clalign.benchmark.parts import parts
    from clalign.benchmark.robustness import robustness
    from clalign.benchmark.runner import Measurement
    from clalign.benchmark.warped import warped
    from clalign.evaluation.distances import METHODS

    layouts = {
        "humans": lambda: humans(args.path, args.pairs),
        "animals": lambda: animals(args.path),
        "faust": lambda: faust(args.root, args.pairs),
        "robustness": lambda: robustness(args.path, split_list(args.alterations)),
        "damaged": lambda: damaged(args.path, split_list(args.damages) if args.damages else ALL_DAMAGES, args.pairs),
        "warped": lambda: warped(args.path, split_list(args.warps), args.share, args.pairs),
        "partial": lambda: parts(args.path, split_list(args.kinds), args.count, args.factor),
    }[args.suite]()
    if args.distances not in METHODS:
        raise OptionError(f"--distances must be one of {', '.join(METHODS)}; got {args.distances!r}")
    if args.update and args.limit is not None and args.section is None:
        raise OptionError(
            f"--limit with --update would put a part of the pairs into the section {args.suite!r}, which is "
            "for all of them: name another one with --section"
        )
    terminal = Terminal(quiet=args.quiet, as_json=args.json)
    methods = named_methods(split_list(args.methods), option_changes(args))
    measurement = Measurement(args.points, args.seed, args.distances)
    finished = run_methods(limited(layouts, args, terminal), methods, measurement, args, terminal)
    return EXIT_INTERRUPTED if finished is None else _report(finished, args, terminal)


def _report(finished: Run, args: argparse.Namespace, terminal: Terminal) -> int:
    from clalign.benchmark.table import SHORT_COLUMNS, as_plain, failures, markdown, summarise, update_file

    summaries = summarise(finished.records)
    text = markdown(summaries)
    document = as_plain(summaries, finished.problems)
    write_text(args.out / "summary.md", text + "\n")
    write_text(args.out / "summary.json", json.dumps(document, indent=1) + "\n")
    for failure in failures(finished.records):
        terminal.warn(failure)
    terminal.say(text)
    terminal.say("mean, median and worst pair: mean geodesic error x 100 / sqrt(area)")
    terminal.document(document)
    _draw_curves(finished.records, args.out, terminal)
    for page in args.update:
        update_file(page, args.section or args.suite, text, markdown(summaries, SHORT_COLUMNS))
    return 1 if any(record.failed for record in finished.records) or not finished.records else 0


def _draw_curves(records: Sequence[Record], folder: Path, terminal: Terminal) -> None:
    """Draw the mean curve of each suite and method, per sqrt(area) and per diameter."""
    from clalign.benchmark.records import read_curves
    from clalign.benchmark.table import mean_curve
    from clalign.presentation.curves import AXIS_LABELS, save_error_curves

    groups: dict[str, list[Record]] = {}
    for record in records:
        groups.setdefault(f"{record.suite}, {record.method}", []).append(record)
    for unit in AXIS_LABELS:
        curves = read_curves(folder, unit)
        drawn = {label: mean_curve(group, curves) for label, group in groups.items()}
        name = "curve.png" if unit == "sqrt_area" else f"curve_{unit}.png"
        if drawn:
            try:
                save_error_curves(drawn, folder / name, unit=unit)
            except InputError as error:
                terminal.warn(f"{name} was not drawn: {error}")


_STUDY = """\
Vary one choice of the method over the pairs of a folder in the layout of the humans, all else as in the preset, and
write a table with the default in bold: weight (lambda), band (a, b and how the funnel is read), xi (the metric), sizes
(d and k), samples (N, and vertices of the losses), rounds, or any option by its name.
"""

_STUDY_EPILOG = """\
The folder DIR gets pairs.csv, curves.csv and study-NAME.md. The last step of the default read-out, two steps without
the mask, evens out much of what a choice does to R: --set readout.steps=0 shows R itself.
"""


def add_study(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``study``."""
    parser = subparsers.add_parser(
        "study",
        help="tables over one choice of the method: lambda, the funnel, xi, sizes, or any option",
        description=_STUDY,
        epilog=_STUDY_EPILOG,
    )
    parser.add_argument("path", metavar="PATH", nargs="?", type=Path, help="folder of meshes, or of such folders")
    parser.add_argument(
        "--root", metavar="DIR", type=Path, help="instead of PATH: a folder as of 'clalign bench faust'"
    )
    parser.add_argument("--of", metavar="NAMES", default="", help=f"comma-separated: {', '.join(STUDIES)}")
    parser.add_argument(
        "--vary",
        metavar="OPTION=VALUES",
        action="append",
        default=[],
        help="a table over any option: alignment.decay=0.1,0.2,0.5; values that hold commas stand in brackets",
    )
    parser.add_argument(
        "--pairs", metavar="FILE", help="a pairs file (default: all pairs*.txt in PATH), or as of 'bench faust'"
    )
    add_option_arguments(parser)
    add_run_arguments(parser, "clalign-bench-study")
    add_output_arguments(parser, "study", "%(default)s, with -STUDY added")
    parser.set_defaults(run=run_study)


def run_study(args: argparse.Namespace) -> int:
    """Run the studies of the command line; 1 when a pair has no map."""
    from clalign.benchmark.runner import Measurement
    from clalign.benchmark.table import summarise

    names = [word.strip() for word in args.of.split(",") if word.strip()] + args.vary
    if not names:
        raise OptionError("nothing to vary: name a study with --of, or an option with --vary OPTION=VALUES")
    terminal = Terminal(quiet=args.quiet, as_json=args.json)
    base = Options.preset(args.preset).replace(option_changes(args))
    studies = {name.partition("=")[0].strip(): study_of(name, base) for name in names}
    layouts = limited(_study_layouts(args), args, terminal)
    documents: dict[str, object] = {}
    failed = False
    for name, (title, rows) in studies.items():
        methods = methods_of(rows, base)
        finished = run_methods(layouts, methods, Measurement(seed=args.seed), args, terminal)
        if finished is None:
            return EXIT_INTERRUPTED
        text = study_table(title, rows, summarise(finished.records), base)
        documents[name] = _study_report(name, text, finished, args, terminal)
        failed |= any(record.failed for record in finished.records)
    terminal.document(documents)
    return 1 if failed else 0


def _study_layouts(args: argparse.Namespace) -> tuple[Layout, ...]:
    """Read the pairs of the command line."""
    from clalign.benchmark.layouts import faust, humans

    if (args.path is None) == (args.root is None):
        raise OptionError("name either a folder in the layout of the humans, or with --root one of FAUST's")
    return humans(args.path, args.pairs) if args.root is None else faust(args.root, args.pairs or "intra")


def _study_report(
    name: str, text: str, finished: Run, args: argparse.Namespace, terminal: Terminal
) -> list[dict[str, object]]:
    """Write and show the table of one study, and return its summaries as plain values."""
    from clalign.benchmark.table import failures, summarise, update_file

    write_text(args.out / f"study-{name}.md", text + "\n")
    for failure in failures(finished.records):
        terminal.warn(failure)
    terminal.say(text)
    for page in args.update:
        update_file(page, f"{args.section}-{name}", text)
    return [asdict(summary) for summary in summarise(finished.records)]


def add_run_arguments(parser: argparse.ArgumentParser, folder: str) -> None:
    """Add ``--out``, ``--limit``, ``--jobs`` and ``--fresh``: of runs over the pairs of a data set."""
    parser.add_argument(
        "--out", metavar="DIR", type=Path, default=Path(folder), help="result folder (default: %(default)s)"
    )
    parser.add_argument("--limit", metavar="N", type=int, help="only the first N pairs of each suite")
    parser.add_argument("--jobs", metavar="N", type=int, default=1, help="processes with one thread each (default: 1)")
    parser.add_argument("--fresh", action="store_true", help="compute pairs again that pairs.csv has already")


def limited(layouts: Sequence[Layout], args: argparse.Namespace, terminal: Terminal) -> list[Layout]:
    """Return the pairs that ``--limit`` leaves, and warn of what is missing from them."""
    kept = [layout.limited(args.limit) for layout in layouts]
    for layout in kept:
        for problem in layout.problems:
            terminal.warn(problem)
    return kept


def run_methods(
    layouts: Sequence[Layout],
    methods: Sequence[Method],
    measurement: Measurement,
    args: argparse.Namespace,
    terminal: Terminal,
) -> Run | None:
    """Run methods over all pairs and show a line a pair; None after Ctrl-C."""
    from clalign.benchmark.runner import run

    try:
        return run(
            layouts,
            methods,
            args.out,
            jobs=args.jobs,
            measurement=measurement,
            resume=not args.fresh,
            progress=lambda count, total, record: terminal.note(f"{count}/{total} {progress_line(record)}"),
        )
    except KeyboardInterrupt:
        terminal.warn(f"interrupted: what is done is in {args.out}; the same command goes on from there")
        return None


def progress_line(record: Record) -> str:
    """Return what one pair gave, in one line."""
    who = f"{record.suite} {record.pair} {record.method}:"
    if record.failed:
        return f"{who} FAILED, {record.message}"
    parts = [f"{who} mean {100 * (record.mean or 0.0):.3f}, exact {record.exact or 0.0:.0%}"]
    if record.mirrored_mean is not None:
        parts.append(f"mirrored {100 * record.mirrored_mean:.1f}{' FLIPPED' if record.flipped else ''}")
    if record.confidence is not None:
        parts.append(f"confidence {record.confidence:.2f}")
    parts.append(f"{record.seconds or 0.0:.1f} s")
    return ", ".join(parts)
