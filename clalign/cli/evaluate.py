"""``clalign evaluate RESULT|MAP``: measure a map against the truth."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from clalign.cli.terminal import Terminal, table
from clalign.data import bundled_pair
from clalign.errors import ResultError

if TYPE_CHECKING:
    from clalign.correspondence import Correspondence
    from clalign.evaluation.errors import Evaluation
    from clalign.evaluation.truth import Base, Truth
    from clalign.mesh.mesh import Mesh

_DESCRIPTION = """\
Measure a map against the truth: geodesic errors on the target in units of sqrt(area) and of the diameter, the error
curve and its area, the error to the mirrored truth, coverage and smoothness. MAP is a result folder of 'clalign match'
or a text file whose line i is the target vertex of source vertex i; a bare map needs --source and --target.
"""

_EPILOG = """\
truth:
  --truth identity            vertex i of the source is vertex i of the target
  --truth FILE                line i: target vertex of source vertex i
  --truth FILE FILE           line i of both files is the same point (X.vts Y.vts: counted from 1)
examples:
  clalign evaluate clalign-result --truth identity --mirror mirror.txt
  clalign evaluate map.txt --base 1 --source a.off --target b.off --truth a.vts b.vts --picture curve.png
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``evaluate`` to the program."""
    parser = subparsers.add_parser(
        "evaluate", help="measure a map against the truth", description=_DESCRIPTION, epilog=_EPILOG
    )
    parser.add_argument("map", metavar="MAP", type=Path, help="result folder, or text file of a map")
    parser.add_argument(
        "--map",
        dest="number",
        metavar="N",
        type=int,
        default=0,
        help="an alternative of the result, from 1 for the best",
    )
    parser.add_argument("--source", metavar="FILE", type=Path, help="source mesh, for a bare map")
    parser.add_argument("--target", metavar="FILE", type=Path, help="target mesh, for a bare map")
    parser.add_argument("--base", type=int, choices=(0, 1), default=0, help="first vertex number in MAP (default: 0)")
    parser.add_argument("--truth", metavar="FILE", nargs="+", required=True, help="see below")
    parser.add_argument(
        "--truth-base",
        type=int,
        choices=(0, 1),
        help="first vertex number in the truth (default: 1 where two files are .vts, else 0)",
    )
    parser.add_argument("--mirror", metavar="FILE", help="line i: number (from 0) of the mirror image of point i")
    parser.add_argument("--points", metavar="N", type=int, help="points measured (default: 500 drawn, or all if fewer)")
    parser.add_argument("--seed", metavar="N", type=int, default=0, help="seed of the drawn points (default: 0)")
    parser.add_argument(
        "--distances",
        metavar="METHOD",
        default="heat",
        help="'heat' (default), 'bounded': never below the straight distance, or 'marching': fast marching",
    )
    parser.add_argument(
        "--csv", metavar="FILE", type=Path, help="write the error of every measured point; an existing FILE is replaced"
    )
    parser.add_argument(
        "--picture",
        metavar="FILE",
        type=Path,
        help="draw the error curve (PNG, SVG or PDF); an existing FILE is replaced",
    )
    parser.add_argument("--json", action="store_true", help="print all figures and curves as one JSON document")
    parser.add_argument("--quiet", action="store_true", help="print nothing but warnings and errors")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Evaluate the map of the command line."""
    from clalign.evaluation.errors import evaluate
    from clalign.evaluation.truth import read_index, read_mirror

    terminal = Terminal(quiet=args.quiet, as_json=args.json)
    result, source, target = _result_and_meshes(args)
    truth = read_truth(args.truth, args.truth_base, source, target)
    mirrored = truth.mirrored(read_mirror(args.mirror)) if args.mirror else None
    evaluation = evaluate(
        result if result is not None else read_index(args.map, base=args.base, count=target.file_count),
        truth,
        source=source,
        target=target,
        mirrored=mirrored,
        points=args.points,
        seed=args.seed,
        method=args.distances,
    )
    for line in table(summary_rows(evaluation), indent=""):
        terminal.say(line)
    terminal.document(evaluation.as_dict())
    if args.csv:
        evaluation.write_csv(args.csv)
    if args.picture:
        from clalign.presentation.curves import save_error_curves

        save_error_curves({evaluation.name: evaluation.curve()}, args.picture)
    return 0


def _result_and_meshes(args: argparse.Namespace) -> tuple[Correspondence | None, Mesh, Mesh]:
    from clalign.mesh.mesh import load_mesh

    if args.map.is_dir():
        from clalign.correspondence import Correspondence

        result = Correspondence.load(args.map).with_map(args.number)
        return result, result.source, result.target
    if args.number:
        raise ResultError(f"{args.map}: --map N belongs to a result folder")
    if not args.map.is_file():
        raise ResultError(f"{args.map}: neither a result folder nor a map file")
    if args.source is None or args.target is None:
        raise ResultError(f"{args.map} is a bare map: name its meshes with --source FILE --target FILE")
    return None, load_mesh(args.source), load_mesh(args.target)


def read_truth(words: list[str], base: Base | None, source: Mesh, target: Mesh) -> Truth:
    """Read what ``--truth`` names and check it against the meshes.

    Raises
    ------
    ResultError
        A file cannot be read or does not fit the meshes, or there are more than two.
    """
    from clalign.evaluation.truth import Truth, read_index_truth, read_pair_truth

    counts = {"source_count": source.file_count, "target_count": target.file_count}
    if words == ["identity"]:
        if source.file_count != target.file_count:
            raise ResultError(
                f"--truth identity: the source has {source.file_count} vertices and the target {target.file_count}"
            )
        return Truth.identity(source.file_count)
    if len(words) == 1:
        return read_index_truth(words[0], base=base or 0, **counts)
    if len(words) == 2:
        return read_pair_truth(words[0], words[1], base=base, **counts)
    raise ResultError(f"--truth takes one file or two, not {len(words)}")


def bundled_truths(source: Mesh, target: Mesh) -> tuple[Truth, Truth]:
    """Return the true map of the bundled pair, and that of its mirror image."""
    from clalign.evaluation.truth import read_index_truth

    truth, mirrored = (
        read_index_truth(path, source_count=source.file_count, target_count=target.file_count)
        for path in (bundled_pair().truth, bundled_pair().mirrored)
    )
    return truth, mirrored


def summary_rows(evaluation: Evaluation) -> list[tuple[str, str]]:
    """Return name and value of the figures that a person wants to see first."""
    values = evaluation.as_dict()
    area, diameter = values["per_sqrt_area"], values["per_diameter"]
    measured, curves = evaluation.points.size, (area["area_under_curve"], diameter["area_under_curve"])
    rows = [
        ("points", f"{measured} measured, {evaluation.unmatched} unmatched, {evaluation.skipped} skipped"),
        ("distances", f"{evaluation.method}; diameter {evaluation.diameter:.3f} sqrt(area)"),
        ("mean error", f"{100 * area['mean']:.3f} x 100 / sqrt(area), {100 * diameter['mean']:.3f} % of the diameter"),
        ("quantiles", ", ".join(f"{q} % {100 * area[f'q{q}']:.3f}" for q in (50, 75, 90, 95, 99))),
        ("largest", f"{100 * area['max']:.3f}"),
        ("exact", f"{evaluation.exact:.1%}"),
        ("curve", f"area {curves[0]:.4f} of 1 per sqrt(area), {curves[1]:.4f} per diameter"),
    ]
    if evaluation.mirrored_mean is not None:
        flip = "FLIPPED" if evaluation.flipped else "not flipped"
        rows.append(("mirrored", f"mean {100 * evaluation.mirrored_mean:.3f} to the mirrored truth: {flip}"))
    if evaluation.subvertex_mean is not None:
        rows.append(("sub-vertex", f"mean {100 * evaluation.subvertex_mean:.3f}"))
    quality = evaluation.quality
    rows.append(("coverage", f"{quality.covered_vertices:.1%} of the vertices, {quality.covered_area:.1%} of the area"))
    if quality.dirichlet is not None and quality.stretch is not None:
        isometry = f"Dirichlet energy {quality.dirichlet:.3f}, edge stretch {quality.stretch:.3f} (1: isometry)"
        rows.append(("smoothness", isometry))
    return rows
