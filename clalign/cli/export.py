"""``clalign export RESULT --format FORMAT``: write a saved match for other programs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from clalign.errors import ResultError

if TYPE_CHECKING:
    from clalign.correspondence import Correspondence

FORMATS = ("ply", "obj", "vts", "map", "numpy", "matlab", "pyfm", "geomfum", "report", "picture")

_DESCRIPTION = """\
Write a saved match for other programs.

formats:
  ply      source.ply and target.ply, coloured alike where they match
  obj      both shapes with one checkered texture, laid on the target and carried to the source
  vts      source.vts and target.vts: line i of both is one point; vertices counted from 1
  map      source_target.map and target_source.map: line i is the match of vertex i; counted from 1, 0 for none
  numpy    match.npz: meshes, eigenfunctions, masses, C, R and both maps
  matlab   match.mat: the same as structs S1 and S2, C12, R, T12 and T21; counted from 1
  pyfm     pyfm.npz: FM_12, p2p_21, evects1, evects2, A1, A2, … as pyFM's functions take them
  geomfum  geomfum.npz: fmap_matrix, p2p, basis_a_vecs, … as geomfum's converters take them
  report   report.html, the page with both shapes in 3D
  picture  match.png
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``export`` to the program."""
    parser = subparsers.add_parser("export", help="write a saved match for other programs", description=_DESCRIPTION)
    parser.add_argument("result", metavar="RESULT", type=Path, help="folder that 'clalign match' wrote")
    parser.add_argument(
        "--format",
        metavar="FORMAT",
        action="append",
        choices=FORMATS,
        required=True,
        help="one of the formats above; may be repeated",
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        default=Path("."),
        help="folder to write to (default: here); existing files of the names above are replaced",
    )
    parser.add_argument("--up", choices=("x", "y", "z"), help="axis of the target that points up, where it is drawn")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write every format that was asked for and print the files."""
    from clalign.correspondence import Correspondence

    correspondence = Correspondence.load(args.result)
    for name in dict.fromkeys(args.format):
        try:
            written = _write(correspondence, name, args)
        except OSError as error:
            raise ResultError(f"{args.out}: cannot be written: {error.strerror or error}") from error
        for path in written:
            print(path)
    return 0


def _write(correspondence: Correspondence, name: str, args: argparse.Namespace) -> list[Path]:
    if name == "report":
        from clalign.presentation.report import write_report

        args.out.mkdir(parents=True, exist_ok=True)
        write_report(correspondence, args.out / "report.html", up=args.up)
        return [args.out / "report.html"]
    if name == "picture":
        from clalign.presentation.picture import save_match_picture

        args.out.mkdir(parents=True, exist_ok=True)
        save_match_picture(correspondence, args.out / "match.png", up=args.up)
        return [args.out / "match.png"]
    from clalign.presentation import exports

    if name in ("ply", "obj"):
        write = exports.export_ply if name == "ply" else exports.export_obj
        return write(correspondence, args.out, up=args.up)
    return exports.FORMATS[name](correspondence, args.out)
