"""``clalign check MESH…``: what is wrong with a mesh, what the program does about it, and what a match would cost."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clalign.cli.terminal import Terminal, table
from clalign.errors import MeshError, OptionError
from clalign.options import Options
from clalign.storage.files import duration_text, size_text
from clalign.storage.folders import atomic_files, check_files

if TYPE_CHECKING:
    from clalign.mesh.defects import Diagnosis
    from clalign.resources import Forecast

EXIT_UNUSABLE = 2
INDEX_SUFFIX = ".index.txt"
LITTLE_AREA = 0.5
"""A repaired mesh with less of the area than this is hardly what was meant."""

_DESCRIPTION = """\
Examine mesh files: what is wrong with each, what the program does about it when it loads the mesh, and the time and
memory that a match with a mesh of the same size will take (with two meshes: a match of the two).

--repair OUT writes a cleaned copy of one mesh (.ply, .off or .obj), and beside it OUT.index.txt, whose line i holds
the vertex of MESH (counted from 0) that vertex i of OUT was. A number can appear twice where the surface was cut.
"""

_EPILOG = """\
examples:
  clalign check cat0.off cat7.off
  clalign check scan.ply --repair clean.ply
  clalign check cut-at-seams.obj --repair clean.ply --merge
  clalign check two-people.ply --component 2 --repair second.ply

exit status: 0 every mesh can be used as it is (with --repair: the copy was written), 2 not
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``check`` to the program."""
    parser = subparsers.add_parser(
        "check", help="examine meshes, and repair them", description=_DESCRIPTION, epilog=_EPILOG
    )
    parser.add_argument(
        "meshes",
        metavar="MESH",
        nargs="+",
        type=Path,
        help="mesh file: OFF, PLY, OBJ, STL, glTF, 3MF, VTK, GIFTI, FreeSurfer",
    )
    parser.add_argument("--repair", metavar="OUT", type=Path, help="write a cleaned copy of the one MESH")
    parser.add_argument("--merge", action="store_true", help="with --repair: first join vertices at equal positions")
    parser.add_argument("--strict", action="store_true", help="call a mesh unusable that is no surface as it stands")
    parser.add_argument(
        "--component", metavar="N", type=int, help="the piece to use or to repair, from 1 for the largest"
    )
    parser.add_argument("--force", action="store_true", help="replace OUT and OUT.index.txt if they exist")
    parser.add_argument("--preset", metavar="NAME", default="default", help="preset that the forecast is for")
    parser.add_argument("--json", action="store_true", help="print the findings as one JSON document")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Examine every mesh, repair one if asked to, and return 0 if all of it can be used."""
    _check_usage(args)
    options = Options.preset(args.preset)
    found = [examine(path, options, strict=args.strict, component=args.component) for path in args.meshes]
    document: dict[str, Any] = {"meshes": found, "usable": all(mesh["usable"] for mesh in found)}
    if len(found) == 2 and document["usable"]:
        document["match"] = _forecast([mesh["used"]["vertices"] for mesh in found], options)
    usable = document["usable"]
    if args.repair is not None:
        document["repaired"] = repair_file(
            args.meshes[0], args.repair, merge=args.merge, force=args.force, component=args.component or 1
        )
        usable = True
    terminal = Terminal(as_json=args.json)
    # Who asks for one piece does not expect the area of the others.
    if "repaired" in document and args.component is None and document["repaired"]["area_share"] < LITTLE_AREA:
        terminal.warn(_little_left(document["repaired"]))
    for line in report(document):
        terminal.say(line)
    terminal.document(document)
    return 0 if usable else EXIT_UNUSABLE


def _check_usage(args: argparse.Namespace) -> None:
    """Find every mistake in the arguments before any mesh is read."""
    from clalign.mesh.writing import require_format

    if args.component is not None and args.component < 1:
        raise OptionError(f"--component {args.component}: pieces are numbered from 1, the largest")
    if args.repair is None:
        if args.merge or args.force:
            raise OptionError("--merge and --force belong to --repair OUT")
        return
    if len(args.meshes) != 1:
        raise OptionError(f"--repair writes one file; give one MESH, not {len(args.meshes)}")
    mesh = args.meshes[0]
    if args.repair.absolute() == mesh.absolute() or (
        args.repair.exists() and mesh.exists() and args.repair.samefile(mesh)
    ):
        raise OptionError(
            f"--repair {args.repair}: is the mesh itself; give another name, the original is worth keeping"
        )
    require_format(args.repair)
    check_files(repaired_paths(args.repair), force=args.force)


def repaired_paths(out: Path) -> list[Path]:
    """Return the files that ``--repair`` writes: the mesh and its index map."""
    return [out, out.with_name(out.name + INDEX_SUFFIX)]


def examine(path: Path, options: Options, *, strict: bool = False, component: int | None = None) -> dict[str, Any]:
    """Return every finding about one file as plain values.

    Parameters
    ----------
    path : a mesh file; that it cannot be read is a finding, too.
    options : what the forecast is for.
    strict, component : how the mesh is read; see `clalign.mesh.mesh.load_mesh`.
    """
    from clalign.mesh.checks import diagnose
    from clalign.mesh.reading import read_mesh_file

    try:
        raw = read_mesh_file(path)
        diagnosis = diagnose(
            raw.vertices, raw.faces, str(path), strict=strict, component=component, normals=raw.normals
        )
    except MeshError as error:
        return {"path": str(path), "usable": False, "error": str(error).removeprefix(f"{path}: ")}
    found: dict[str, Any] = {
        "path": str(path),
        "usable": not diagnosis.refused,
        "file": {"vertices": diagnosis.n_vertices, "triangles": diagnosis.n_faces},
        "notes": list(raw.notes),
        "findings": _findings(diagnosis, str(path)),
    }
    if found["usable"]:
        found |= _surface_facts(diagnosis, str(path))
        found["forecast"] = _forecast([found["used"]["vertices"]] * 2, options)
    return found


def _findings(diagnosis: Diagnosis, path: str) -> list[dict[str, Any]]:
    return [
        {
            **{name: getattr(defect, name) for name in ("kind", "severity", "count", "vertices", "faces", "action")},
            "sentence": defect.sentence(),
            "way_out": defect.way_out(path),
        }
        for defect in diagnosis.defects
    ]


def _surface_facts(diagnosis: Diagnosis, path: str) -> dict[str, Any]:
    """Return counts, topology and size of a surface that can be used; lengths in the file's unit."""
    import numpy as np

    from clalign.mesh.mesh import unit_area

    surface = diagnosis.usable_surface(path, path)
    _, scale, _ = unit_area(surface.vertices, surface.faces)
    return {
        "used": {"vertices": len(surface.vertices), "triangles": len(surface.faces)},
        "pieces": diagnosis.components,
        "boundaries": diagnosis.boundary_loops,
        "euler_characteristic": diagnosis.euler_characteristic,
        "genus": diagnosis.genus,
        "area": scale**2,
        "scale": scale,
        "extent": [float(length) for length in np.ptp(surface.vertices, axis=0)],
    }


def _forecast(counts: list[int], options: Options) -> dict[str, Any]:
    from clalign.resources import available_memory, forecast

    predicted: Forecast = forecast(counts[0], counts[1], options)
    return {
        "seconds": predicted.seconds,
        "doubt": predicted.stages["choice"],
        "memory": predicted.memory,
        "available": available_memory(),
    }


def repair_file(path: Path, out: Path, *, merge: bool, force: bool, component: int = 1) -> dict[str, Any]:
    """Write a repaired copy of one piece of a mesh file with the index map beside it, both or neither.

    Raises
    ------
    MeshError
        The file cannot be read or nothing usable is left of it.
    ResultError
        The copy cannot be written.
    """
    from clalign.maps.point_maps import write_map
    from clalign.mesh.reading import read_mesh_file
    from clalign.mesh.repair import repair
    from clalign.mesh.writing import save_mesh

    raw = read_mesh_file(path)
    try:
        repaired = repair(raw.vertices, raw.faces, merge=merge, component=component, normals=raw.normals)
    except MeshError as error:
        raise MeshError(f"{path}: {error}") from error
    paths = repaired_paths(out)
    with atomic_files(paths, force=force) as (mesh_path, index_path):
        save_mesh(mesh_path, repaired.vertices, repaired.faces)
        write_map(index_path, repaired.file_index)
    return {
        "mesh": str(paths[0]),
        "index": str(paths[1]),
        "vertices": len(repaired.vertices),
        "triangles": len(repaired.faces),
        "area_share": repaired.area_share,
        "way_out": repaired.merge_advice,
        "notes": [*raw.notes, *repaired.notes],
    }


def report(document: dict[str, Any]) -> list[str]:
    """Return the document as lines for a person."""
    lines: list[str] = []
    for mesh in document["meshes"]:
        lines += _mesh_lines(mesh)
    if "match" in document:
        lines.append(f"matching the two: {_cost(document['match'])}")
    if "repaired" in document:
        lines += _repair_lines(document["repaired"])
    return lines


def _mesh_lines(mesh: dict[str, Any]) -> list[str]:
    from clalign.mesh.defects import distinct

    if "error" in mesh:
        return [f"{mesh['path']}: not usable", *table([("refused", mesh["error"])])]
    file, used = mesh["file"], mesh.get("used")
    rows = [("file", _counts(file))]
    if used is not None:
        if used != file:
            rows.append(("used", _counts(used)))
        extent = " x ".join(f"{length:.4g}" for length in mesh["extent"])
        rows += [
            ("surface", f"one piece, {_boundaries(mesh['boundaries'])}, genus {mesh['genus']}"),
            ("size", f"area {mesh['area']:.4g}, box {extent}; one unit of the results is {mesh['scale']:.4g}"),
        ]
    rows += [("note", note) for note in mesh["notes"]]
    rows += [(finding["severity"], finding["sentence"]) for finding in mesh["findings"]]
    rows += [("way out", way) for way in distinct([finding["way_out"] for finding in mesh["findings"]])]
    if used is not None:
        rows.append(("match", f"{_cost(mesh['forecast'])}, with a mesh of this size"))
    return [f"{mesh['path']}: {'usable' if mesh['usable'] else 'not usable'}", *table(rows)]


def _counts(sizes: dict[str, Any]) -> str:
    triangles = "1 triangle" if sizes["triangles"] == 1 else f"{sizes['triangles']:,} triangles"
    return f"{sizes['vertices']:,} vertices, {triangles}"


def _boundaries(count: int) -> str:
    return "closed" if not count else "1 boundary" if count == 1 else f"{count} boundaries"


def _cost(predicted: dict[str, Any]) -> str:
    available = predicted["available"]
    free = "" if available is None else f" of {size_text(available)} that are free"
    too_much = " (TOO MUCH)" if available is not None and predicted["memory"] > available else ""
    more = f" ({duration_text(predicted['doubt'])} more if in doubt)"
    return f"about {duration_text(predicted['seconds'])}{more}, {size_text(predicted['memory'])}{free}{too_much}"


def _little_left(repaired: dict[str, Any]) -> str:
    way_out = f", or {repaired['way_out']}" if repaired["way_out"] else ""
    share = f"{100 * repaired['area_share']:.2g} %"
    return f"{repaired['mesh']}: only {share} of the area is left; look at it before use{way_out}"


def _repair_lines(repaired: dict[str, Any]) -> list[str]:
    rows = [("changed", note) for note in repaired["notes"]] or [("changed", "nothing; the mesh needed no repair")]
    rows.append(("index", f"{repaired['index']}: line i holds the vertex of the original that vertex i was"))
    return [f"wrote {repaired['mesh']}: {_counts(repaired)}", *table(rows)]
