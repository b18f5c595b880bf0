"""``clalign show|transfer|export RESULT``: look at a saved match, carry something through it, write it for others."""

from __future__ import annotations

import argparse
import sys
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clalign.errors import InputError, ResultError
from clalign.presentation import PAGE_FILE, PICTURE_FILE

if TYPE_CHECKING:
    from clalign.correspondence import Correspondence

_SHOW = """\
Look at a saved match: both shapes side by side in a window, coloured alike where they match (needs the extra "view",
pip install 'clalign[view]'). With --page, the page report.html opens in the web browser instead.
"""


def add_show(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``show`` to the program."""
    parser = subparsers.add_parser("show", help="look at a saved match", description=_SHOW)
    parser.add_argument("result", metavar="RESULT", type=Path, help="folder that 'clalign match' wrote")
    parser.add_argument("--page", action="store_true", help="open the page in the web browser")
    parser.add_argument("--screenshot", metavar="FILE", type=Path, help="write a PNG instead of opening a window")
    parser.add_argument("--up", choices=("x", "y", "z"), help="axis of the target that points up")
    parser.set_defaults(run=run_show)


def run_show(args: argparse.Namespace) -> int:
    """Open the window, or the page in the browser."""
    from clalign.correspondence import Correspondence
    from clalign.presentation.report import write_report
    from clalign.presentation.viewer import show

    if not args.page:
        show(Correspondence.load(args.result), up=args.up, screenshot=args.screenshot)
        return 0
    page = args.result.resolve() / PAGE_FILE
    if not page.is_file():
        correspondence = Correspondence.load(args.result)
        with _writing(page):
            write_report(correspondence, page, up=args.up)
    print(page)
    if webbrowser.open(page.as_uri()):
        return 0
    print("no browser could be started; open this file yourself", file=sys.stderr)
    return 1


def add_map_argument(parser: argparse.ArgumentParser) -> None:
    """Add ``--map``."""
    parser.add_argument(
        "--map",
        metavar="N",
        type=int,
        default=0,
        help="an alternative of the result, from 1 for the best, instead of the chosen map (see match --alternatives)",
    )


def chosen_map(folder: Path, number: int) -> Correspondence:
    """Read a result, with one of its alternatives in the place of the chosen map unless the number is 0."""
    from clalign.correspondence import Correspondence

    return Correspondence.load(folder).with_map(number)


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Name the path when the operating system refuses to write."""
    try:
        yield
    except OSError as error:
        raise ResultError(f"{path}: cannot be written: {error.strerror or error}") from error


_TRANSFER = """\
Carry FILE from one shape of a saved match to the other. Rows of FILE belong to the vertices of the mesh file it is
for, in that file's order (numbers from 0). Vertices without a match get nan, or -1 for whole numbers.

kinds:
  scalars      numbers of vertices, one or more columns (.npy, or text with one row a line)
  colours      three columns, 0 to 1 or 0 to 255
  labels       one whole number a vertex, taken from the match, without the speckles that a map makes
  landmarks    a list of vertices; gives their matches
  texture      an OBJ file with texture coordinates; OUT is an OBJ of the other shape
  deformation  the same mesh in another pose; OUT is the other mesh deformed alike (both meshes should stand alike)
"""

_TRANSFER_EXAMPLES = """\
examples:
  clalign transfer result scalars thickness.txt --out thickness-on-target.txt
  clalign transfer result colours paint.npy --out painted-target.ply
  clalign transfer result labels parts.txt --from target --out parts-on-source.txt
  clalign transfer result texture source-with-uv.obj --out target-with-uv.obj
  clalign transfer result deformation source-waving.ply --out target-waving.ply
"""

KINDS = ("scalars", "colours", "labels", "landmarks", "texture", "deformation")


def add_transfer(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``transfer`` to the program."""
    parser = subparsers.add_parser(
        "transfer",
        help="carry values, labels, landmarks, a texture or a deformation through a saved match",
        description=_TRANSFER,
        epilog=_TRANSFER_EXAMPLES,
    )
    parser.add_argument("result", metavar="RESULT", type=Path, help="folder that 'clalign match' wrote")
    parser.add_argument("kind", metavar="KIND", choices=KINDS, help=", ".join(KINDS))
    parser.add_argument("file", metavar="FILE", type=Path, help="what to carry")
    parser.add_argument(
        "--out",
        metavar="OUT",
        type=Path,
        required=True,
        help="file to write; its suffix says how",
    )
    parser.add_argument("--force", action="store_true", help="replace OUT if it exists (never a mesh of the match)")
    parser.add_argument(
        "--from",
        dest="origin",
        choices=("source", "target"),
        default="source",
        help="the shape that FILE belongs to (default: source)",
    )
    parser.add_argument(
        "--route",
        choices=("points", "precise", "functional"),
        default="points",
        help="scalars and colours: through matched points (default), through points inside faces, or smoothly through "
        "the functional map",
    )
    parser.add_argument(
        "--speckles", action="store_true", help="labels: keep islands and frayed edges that the map has made"
    )
    add_map_argument(parser)
    parser.set_defaults(run=run_transfer)


def run_transfer(args: argparse.Namespace) -> int:
    """Carry one file and write what comes out."""
    from clalign.transfer.outputs import check_outputs

    correspondence = chosen_map(args.result, args.map)
    check_outputs(correspondence, [args.out], force=args.force)
    carry = {"texture": _texture, "deformation": _deformation}.get(args.kind, _values)
    with _writing(args.out):
        carry(correspondence, args)
    print(f"wrote {args.out}")
    return 0


def _values(correspondence: Correspondence, args: argparse.Namespace) -> None:
    from clalign.transfer import transfer
    from clalign.transfer.value_files import check_colours, read_values, write_values

    _, there = transfer.sides(correspondence, args.origin)
    values = read_values(args.file, whole=args.kind in ("labels", "landmarks"))
    if args.kind == "colours":
        check_colours(args.file, values)
    if args.kind == "labels":
        carried: Any
        carried, said = transfer.carried_labels(correspondence, values, origin=args.origin, speckles=args.speckles)
        print(said)
    elif args.kind == "landmarks":
        carried = transfer.carry_landmarks(correspondence, values, origin=args.origin)
    else:
        carried = transfer.carry_values(correspondence, values, origin=args.origin, route=args.route)
    write_values(args.out, carried, there)


def _texture(correspondence: Correspondence, args: argparse.Namespace) -> None:
    from clalign.transfer.texture import carry_texture, read_texture, write_textured_obj
    from clalign.transfer.transfer import sides

    if args.out.suffix.lower() != ".obj":
        raise InputError(f"{args.out}: a texture is written as .obj")
    _, there = sides(correspondence, args.origin)
    carried = carry_texture(correspondence, read_texture(args.file), origin=args.origin)
    write_textured_obj(args.out, there.file_positions(), carried)


def _deformation(correspondence: Correspondence, args: argparse.Namespace) -> None:
    import numpy as np

    from clalign.mesh.reading import read_mesh_file
    from clalign.mesh.writing import save_mesh
    from clalign.transfer.transfer import carry_deformation, sides
    from clalign.transfer.value_files import MESH_SUFFIXES, write_values

    _, there = sides(correspondence, args.origin)
    moved = carry_deformation(correspondence, read_mesh_file(args.file).vertices, origin=args.origin)
    if args.out.suffix.lower() in MESH_SUFFIXES:
        positions = np.where(np.isfinite(moved), moved, there.offset)
        save_mesh(args.out, positions, there.all_file_faces)
    else:
        write_values(args.out, moved, there)


MAP_FORMATS = ("ply", "obj", "vts", "map", "picture")
"""Formats that hold nothing but the maps, and so can be had of an alternative."""
FORMATS = ("ply", "obj", "vts", "map", "numpy", "matlab", "pyfm", "geomfum", "report", "picture")

_EXPORT = """\
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


def add_export(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``export`` to the program."""
    parser = subparsers.add_parser("export", help="write a saved match for other programs", description=_EXPORT)
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
        help="folder to write to (default: RESULT itself)",
    )
    parser.add_argument(
        "--force", action="store_true", help="replace existing files of the names above (never the meshes of the match)"
    )
    parser.add_argument("--up", choices=("x", "y", "z"), help="axis of the target that points up, where it is drawn")
    add_map_argument(parser)
    parser.set_defaults(run=run_export)


def run_export(args: argparse.Namespace) -> int:
    """Write every format that was asked for and print the files."""
    from clalign.presentation.exports import FILES
    from clalign.transfer.outputs import check_outputs

    correspondence = chosen_map(args.result, args.map)
    args.out = args.result if args.out is None else args.out
    formats = list(dict.fromkeys(args.format))
    check_outputs(correspondence, [args.out / file for name in formats for file in FILES[name]], force=args.force)
    for name in formats:
        with _writing(args.out):
            written = _export(correspondence, name, args)
        for path in written:
            print(path)
    return 0


def _export(correspondence: Correspondence, name: str, args: argparse.Namespace) -> list[Path]:
    from clalign.presentation import exports
    from clalign.presentation.picture import save_match_picture
    from clalign.presentation.report import write_report

    if args.map and name not in MAP_FORMATS:
        raise InputError(
            f"--format {name} holds C and R, which are those of the chosen map: match anew with --start {args.result} "
            f"--start-map {args.map}, or take {', '.join(MAP_FORMATS)}"
        )
    if name in ("report", "picture"):
        args.out.mkdir(parents=True, exist_ok=True)
        path = args.out / (PAGE_FILE if name == "report" else PICTURE_FILE)
        draw: Any = write_report if name == "report" else save_match_picture
        draw(correspondence, path, up=args.up)
        return [path]
    if name in ("ply", "obj"):
        write = exports.export_ply if name == "ply" else exports.export_obj
        return write(correspondence, args.out, up=args.up)
    return exports.FORMATS[name](correspondence, args.out)
