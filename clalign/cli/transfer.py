"""``clalign transfer RESULT KIND FILE``: carry something through a saved match."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from clalign.errors import InputError, ResultError

if TYPE_CHECKING:
    from clalign.correspondence import Correspondence

_DESCRIPTION = """\
Carry FILE from one shape of a saved match to the other. Rows of FILE belong to the vertices of the mesh file it is
for, in that file's order (numbers from 0). Vertices without a match get nan, or -1 for whole numbers.

kinds:
  scalars      numbers of vertices, one or more columns (.npy, or text with one row a line)
  colours      three columns, 0 to 1 or 0 to 255
  labels       one whole number a vertex, taken from the nearest match
  landmarks    a list of vertices; gives their matches
  texture      an OBJ file with texture coordinates; OUT is an OBJ of the other shape
  deformation  the same mesh in another pose; OUT is the other mesh deformed alike (both meshes should stand alike)
"""

_EPILOG = """\
examples:
  clalign transfer result scalars thickness.txt --out thickness-on-target.txt
  clalign transfer result colours paint.npy --out painted-target.ply
  clalign transfer result labels parts.txt --from target --out parts-on-source.txt
  clalign transfer result texture source-with-uv.obj --out target-with-uv.obj
  clalign transfer result deformation source-waving.ply --out target-waving.ply
"""

KINDS = ("scalars", "colours", "labels", "landmarks", "texture", "deformation")


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``transfer`` to the program."""
    parser = subparsers.add_parser(
        "transfer",
        help="carry values, labels, landmarks, a texture or a deformation through a saved match",
        description=_DESCRIPTION,
        epilog=_EPILOG,
    )
    parser.add_argument("result", metavar="RESULT", type=Path, help="folder that 'clalign match' wrote")
    parser.add_argument("kind", metavar="KIND", choices=KINDS, help=", ".join(KINDS))
    parser.add_argument("file", metavar="FILE", type=Path, help="what to carry")
    parser.add_argument(
        "--out",
        metavar="OUT",
        type=Path,
        required=True,
        help="file to write; its suffix says how; an existing OUT is replaced",
    )
    parser.add_argument(
        "--from",
        dest="origin",
        choices=("source", "target"),
        default="source",
        help="the shape that FILE belongs to (default: source)",
    )
    parser.add_argument(
        "--route",
        choices=("points", "functional"),
        default="points",
        help="scalars and colours: through matched points (default), or smoothly through the functional map",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Carry one file and write what comes out."""
    from clalign.correspondence import Correspondence

    correspondence = Correspondence.load(args.result)
    carry = {"texture": _texture, "deformation": _deformation}.get(args.kind, _values)
    try:
        carry(correspondence, args)
    except OSError as error:
        raise ResultError(f"{args.out}: cannot be written: {error.strerror or error}") from error
    print(f"wrote {args.out}")
    return 0


def _values(correspondence: Correspondence, args: argparse.Namespace) -> None:
    from clalign.transfer import transfer
    from clalign.transfer.value_files import read_values, write_values

    origin, (_, there) = args.origin, transfer.sides(correspondence, args.origin)
    whole = args.kind in ("labels", "landmarks")
    values = read_values(args.file, whole=whole)
    if args.kind == "labels":
        write_values(args.out, transfer.carry_labels(correspondence, values, origin=origin), there)
    elif args.kind == "landmarks":
        write_values(args.out, transfer.carry_landmarks(correspondence, values, origin=origin), there)
    else:
        write_values(args.out, transfer.carry_values(correspondence, values, origin=origin, route=args.route), there)


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
        save_mesh(args.out, positions, there.file_faces)
    else:
        write_values(args.out, moved, there)
