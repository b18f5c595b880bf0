"""``clalign bench humans|animals|faust|robustness``: errors of maps over all pairs of a data set."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clalign.cli.terminal import Terminal

if TYPE_CHECKING:
    from clalign.benchmark.records import Record
    from clalign.benchmark.runner import Run
    from clalign.evaluation.layouts import Layout

EXIT_INTERRUPTED = 130

_EPILOG = """\
The folder DIR gets pairs.csv (a row a pair, written as soon as it is known), curves.csv, summary.json, summary.md and
curve.png. Run the same command again to go on after an interruption; pairs that failed are tried again.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``humans``, ``animals``, ``faust`` and ``robustness``."""
    humans = _add(subparsers, "humans", "posed humans, or any folder in their layout", run_humans)
    humans.add_argument("path", metavar="PATH", type=Path, help="folder of meshes, or of such folders")
    humans.add_argument("--pairs", metavar="FILE", help="run this pairs file only (default: all pairs*.txt in PATH)")
    animals = _add(subparsers, "animals", "folders of frames with one connectivity, every pair of frames", run_animals)
    animals.add_argument("path", metavar="PATH", type=Path, help="folder of frames, or of such folders")
    faust = _add(subparsers, "faust", "your copy of FAUST, remeshed FAUST, SCAPE or TOSCA", run_faust)
    faust.add_argument("--root", metavar="DIR", type=Path, required=True, help="tr_reg_*.ply, or *.off (and corres/)")
    faust.add_argument(
        "--pairs",
        metavar="WORD",
        default="intra",
        help="'intra' (first pose of each subject with its others, default), 'inter', or a pairs file",
    )
    faust.set_defaults(methods="paper,paper-cycle,paper-isometric,paper-heat-kernel,default")
    robustness = _add(subparsers, "robustness", "meshes against changed copies of themselves", run_robustness)
    robustness.add_argument("path", metavar="PATH", type=Path, help="folder of meshes")
    robustness.add_argument(
        "--changes",
        dest="alterations",
        metavar="NAMES",
        default="noise,half,rotated,times-1000,times-0.001",
        help="comma-separated; also: normal-noise, subdivided (default: %(default)s)",
    )


def _add(
    subparsers: argparse._SubParsersAction[argparse.ArgumentParser],
    name: str,
    text: str,
    run: Callable[[argparse.Namespace], int],
) -> argparse.ArgumentParser:
    parser = subparsers.add_parser(
        name,
        help=text,
        description=f"Match all pairs of a data set and measure the errors: {text}.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--out", metavar="DIR", type=Path, default=Path(f"clalign-bench-{name}"), help="result folder")
    parser.add_argument(
        "--methods",
        "--variants",
        metavar="NAMES",
        default="default",
        help="comma-separated: default, fast, cycle, isometric, heat-kernel, euclidean, regularized, auto-metric, "
        "one-sided, unitarity, frozen, uniform, full-band, diagonal-band, no-band, search-only, up-sampled, pieces, "
        "aligned, closed-form, mirrored, paper, paper-searched, paper-cycle, paper-isometric, paper-heat-kernel, "
        "paper-one-sided, paper-mirrored, "
        "pyfm (default: %(default)s)",
    )
    parser.add_argument(
        "--set", metavar="GROUP.NAME=VALUE", action="append", default=[], dest="changes", help="change an option of all"
    )
    parser.add_argument("--device", metavar="SPEC", help="as of 'clalign match'")
    parser.add_argument("--limit", metavar="N", type=int, help="only the first N pairs of each suite")
    parser.add_argument("--jobs", metavar="N", type=int, default=1, help="processes with one thread each (default: 1)")
    parser.add_argument("--fresh", action="store_true", help="compute pairs again that pairs.csv has already")
    parser.add_argument("--points", metavar="N", type=int, help="points measured a pair (default: 500)")
    parser.add_argument("--distances", metavar="METHOD", default="heat", help="'heat' (default) or 'bounded'")
    parser.add_argument("--seed", metavar="N", type=int, default=0, help="seed of the match and the points")
    parser.add_argument(
        "--update", metavar="FILE", type=Path, help="put the table into the section of FILE named below"
    )
    parser.add_argument("--section", metavar="NAME", help=f"of <!-- table:NAME --> (default: {name}, for whole lists)")
    parser.add_argument("--quiet", action="store_true", help="show nothing but warnings and errors")
    parser.add_argument("--json", action="store_true", help="print the summary as one JSON document")
    parser.set_defaults(run=run, whole_section=name)
    return parser


def run_humans(args: argparse.Namespace) -> int:
    """Run the pairs of a folder in the layout of the humans."""
    from clalign.evaluation.layouts import humans

    return _bench(humans(args.path, args.pairs), args)


def run_animals(args: argparse.Namespace) -> int:
    """Run all pairs of frames."""
    from clalign.evaluation.layouts import animals

    return _bench(animals(args.path), args)


def run_faust(args: argparse.Namespace) -> int:
    """Run a user's copy of FAUST or of a data set like it."""
    from clalign.evaluation.layouts import faust

    return _bench(faust(args.root, args.pairs), args)


def run_robustness(args: argparse.Namespace) -> int:
    """Run all meshes of a folder against changed copies."""
    from clalign.benchmark.robustness import robustness

    return _bench(robustness(args.path, [change.strip() for change in args.alterations.split(",")]), args)


def _bench(layouts: Sequence[Layout], args: argparse.Namespace) -> int:
    """Run, show a line a pair, write the summary; 1 when a pair has no map."""
    from clalign.benchmark.methods import named_methods
    from clalign.benchmark.runner import Measurement, run
    from clalign.errors import OptionError
    from clalign.evaluation.distances import METHODS

    if args.distances not in METHODS:
        raise OptionError(f"--distances must be one of {', '.join(METHODS)}; got {args.distances!r}")
    if args.update is not None and args.limit is not None and args.section is None:
        raise OptionError(
            f"--limit with --update would put a part of the pairs into the section {args.whole_section!r}, which is "
            "for all of them: name another one with --section"
        )
    terminal = Terminal(quiet=args.quiet, as_json=args.json)
    limited = [layout.limited(args.limit) for layout in layouts]
    for layout in limited:
        for problem in layout.problems:
            terminal.warn(problem)
    try:
        finished = run(
            limited,
            named_methods([name.strip() for name in args.methods.split(",")], option_changes(args)),
            args.out,
            jobs=args.jobs,
            measurement=Measurement(args.points, args.seed, args.distances),
            resume=not args.fresh,
            progress=lambda count, total, record: terminal.note(f"{count}/{total} {progress_line(record)}"),
        )
    except KeyboardInterrupt:
        terminal.warn(f"interrupted: what is done is in {args.out}; the same command goes on from there")
        return EXIT_INTERRUPTED
    return _report(finished, args, terminal)


def option_changes(args: argparse.Namespace) -> dict[str, Any]:
    """Return the changes to options that ``--seed``, ``--device`` and every ``--set`` ask for.

    Raises
    ------
    OptionError
        A ``--set`` without a value.
    """
    from clalign.errors import OptionError

    changes: dict[str, Any] = {"seed": args.seed}
    if args.device == "reference":
        changes["engine.backend"] = "reference"
    elif args.device is not None:
        changes["engine.device"] = args.device
    for change in args.changes:
        name, equals, value = change.partition("=")
        if not equals:
            raise OptionError(f"--set {change}: expected GROUP.NAME=VALUE, such as alignment.weight=50")
        changes[name.strip()] = value.strip()
    return changes


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


def _report(finished: Run, args: argparse.Namespace, terminal: Terminal) -> int:
    from clalign.benchmark.table import as_json, failures, markdown, summarise, update_file

    summaries = summarise(finished.records)
    text = markdown(summaries)
    document = as_json(summaries, finished.problems)
    (args.out / "summary.md").write_text(text + "\n", encoding="utf-8")
    (args.out / "summary.json").write_text(document, encoding="utf-8")
    for failure in failures(finished.records):
        terminal.warn(failure)
    terminal.say(text)
    terminal.say("mean, median and worst pair: mean geodesic error x 100 / sqrt(area)")
    if args.json:
        print(document, end="")
    _draw_curves(finished.records, args.out, terminal)
    if args.update is not None:
        update_file(args.update, args.section or args.whole_section, text)
    return 1 if any(record.failed for record in finished.records) or not finished.records else 0


def _draw_curves(records: Sequence[Record], folder: Path, terminal: Terminal) -> None:
    """Draw the mean curve of each suite and method, per sqrt(area) and per diameter."""
    from clalign.benchmark.records import CURVES_FILE, read_curves
    from clalign.benchmark.table import mean_curve
    from clalign.errors import InputError
    from clalign.presentation.curves import AXIS_LABELS, save_error_curves

    groups: dict[str, list[Record]] = {}
    for record in records:
        groups.setdefault(f"{record.suite}, {record.method}", []).append(record)
    for unit in AXIS_LABELS:
        curves = read_curves(folder / CURVES_FILE, unit)
        drawn = {label: mean_curve(group, curves) for label, group in groups.items()}
        name = "curve.png" if unit == "sqrt_area" else f"curve_{unit}.png"
        if drawn:
            try:
                save_error_curves(drawn, folder / name, unit=unit)
            except InputError as error:
                terminal.warn(f"{name} was not drawn: {error}")
