"""``clalign register SOURCE TARGET|RESULT``: the source's mesh lying on the target's surface."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clalign.cli.match import add_method_arguments, device_label, matched, missed_interrupts, options_from
from clalign.cli.pair_input import PairInput, add_input_arguments
from clalign.cli.saved import add_map_argument, chosen_map
from clalign.cli.terminal import Terminal, table
from clalign.errors import OptionError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clalign.correspondence import Correspondence
    from clalign.registration.register import Registration

_DESCRIPTION = """\
Lay the vertices and faces of SOURCE on the surface of TARGET: a template on a scan, one frame on another. Takes two
mesh files, which are matched first, or the result folder of a match. OUT is the source's own file with its vertices
moved, where both are PLY or OBJ: texture coordinates, materials, polygons, colours, weights and labels stay.
"""

_EPILOG = """\
examples:
  clalign register template.obj scan.ply --out template-on-scan.obj
  clalign register clalign-result --out registered.ply --values weight=skin-weights.txt
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``register`` to the program."""
    parser = subparsers.add_parser(
        "register",
        help="lay the source's mesh on the target's surface",
        description=_DESCRIPTION,
        epilog=_EPILOG,
    )
    parser.add_argument("source", metavar="SOURCE", type=Path, help="mesh to lay down, or the result folder of a match")
    parser.add_argument("target", metavar="TARGET", type=Path, nargs="?", help="mesh that it is laid on")
    parser.add_argument(
        "--out",
        metavar="OUT",
        type=Path,
        default=Path("registered.ply"),
        help="mesh to write, .ply, .obj or .off (default: %(default)s)",
    )
    parser.add_argument(
        "--values",
        metavar="NAME=FILE",
        action="append",
        default=[],
        help="numbers of the source's vertices (.npy or text) to write as a property of a .ply; may be repeated",
    )
    parser.add_argument("--keep", metavar="DIR", type=Path, help="keep the match of two files as a result folder")
    parser.add_argument("--force", action="store_true", help="replace OUT and DIR (never a mesh of the match)")
    add_map_argument(parser)
    add_method_arguments(parser)
    parser.add_argument("--no-cache", action="store_true", help="compute everything anew and store nothing for later")
    add_input_arguments(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Register, write the mesh and show what became of it."""
    terminal = Terminal(quiet=args.quiet, as_json=args.json)
    columns = _columns(args)
    if args.target is None:
        result = _saved(args, columns)
    else:
        result = _matched(args, columns, terminal)

    from clalign.registration.files import save_registration
    from clalign.registration.register import register

    registration = register(result)
    said = save_registration(registration, args.out, columns)
    if said:
        terminal.note(said)
    for line in table(_rows(registration, args.out), indent=""):
        terminal.say(line)
    terminal.document({"file": str(args.out), **registration.facts()})
    return 0


def _columns(args: argparse.Namespace) -> dict[str, NDArray]:
    from clalign.transfer.value_files import read_values

    columns: dict[str, Any] = {}
    for words in args.values:
        name, equals, file = words.partition("=")
        if not equals or not name or not file:
            raise OptionError(f"--values {words}: expected NAME=FILE, such as weight=weights.txt")
        values = read_values(file)
        whole = (values == values.round()).all()
        columns[name] = values.astype(int) if whole else values
    return columns


def _saved(args: argparse.Namespace, columns: dict[str, NDArray]) -> Correspondence:
    """Read the match of a result folder."""
    from clalign.registration.files import check_output
    from clalign.transfer.outputs import check_outputs

    if args.keep:
        raise OptionError("--keep DIR belongs to two mesh files; a result folder is kept already")
    result = chosen_map(args.source, args.map)
    check_outputs(result, [args.out], force=args.force)
    check_output(args.out, columns, result.source.file_count)
    return result


def _matched(args: argparse.Namespace, columns: dict[str, NDArray], terminal: Terminal) -> Correspondence:
    """Match the two files of the command line."""
    options = options_from(args).replace({"readout.subvertex": True})
    if args.map:
        raise OptionError("--map N belongs to a result folder")

    import clalign
    from clalign.correspondence import FACTS_FILE
    from clalign.registration.files import check_output
    from clalign.storage.folders import check_destination, check_files
    from clalign.transfer.outputs import keep_meshes

    given = PairInput.of(args)
    with missed_interrupts() as raise_missed:
        source, target = given.meshes(options.surface)
        known = given.known(source, target)
        keep_meshes((source, target), [args.out])
        check_files([args.out], force=args.force)
        check_output(args.out, columns, source.file_count)
        if args.keep:
            check_destination(args.keep, FACTS_FILE, force=args.force)
        terminal.note(f"device: {device_label(options)}")
        result = matched(partial(clalign.match, source, target, options, **known), args, terminal, raise_missed)
    if args.keep:
        result.save(args.keep, force=args.force)
    return result


def _rows(registration: Registration, path: Path) -> list[tuple[str, str]]:
    quality, source = registration.quality, registration.source
    faces = source.n_faces
    turned, collapsed = round(quality.flipped * faces), round(quality.collapsed * faces)
    return [
        ("faces", f"{faces:,}, of which {turned} turned over, {collapsed} collapsed"),
        (
            "distance",
            f"from the target's surface, in mean edges: vertices {quality.distance:.4f}, at most "
            f"{quality.largest_distance:.4f}; middles of the faces {quality.middles:.4f}",
        ),
        ("filled", f"{quality.filled:.1%} of the vertices continue the surface where the target has none"),
        ("distortion", f"shear {quality.shear:.3f} (1: none), change of area {quality.area_change:.3f} (0: none)"),
        ("result", str(path)),
    ]
