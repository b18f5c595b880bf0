"""What the command line says of a pair before it is matched: the two files, their pieces, a start, landmarks."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clalign.errors import OptionError

if TYPE_CHECKING:
    from clalign.mesh.mesh import Mesh
    from clalign.options import SurfaceOptions


def add_input_arguments(parser: argparse.ArgumentParser) -> None:
    """Add ``--start``, ``--landmarks``, ``--descriptors`` with what belongs to them, and ``--component``."""
    parser.add_argument(
        "--start",
        metavar="MAP",
        help="start from a map instead of a search: a text file with the target vertex of every source vertex (-1: not "
        "known), a result folder, 'extrinsic' for shapes that lie on each other, or 'rigid' for nearly so",
    )
    parser.add_argument(
        "--start-map",
        metavar="N",
        type=int,
        default=0,
        help="with --start RESULT: from its alternative N, counted from 1 for the best",
    )
    parser.add_argument(
        "--landmarks",
        metavar="FILE",
        nargs="+",
        action="extend",
        default=[],
        help="after the meshes; points known to be the same: one file with a pair of vertex numbers or points a row "
        "(text or CSV), or one for each mesh (also of 3D Slicer, .mrk.json, and MeshLab, .pp)",
    )
    parser.add_argument(
        "--landmark-tolerance",
        metavar="T",
        type=float,
        default=0.0,
        help="how far landmarks may be off, in sqrt(area); above 0 none is kept exactly (default: %(default)s)",
    )
    parser.add_argument(
        "--descriptors",
        metavar="FILE",
        nargs=2,
        help="after the meshes; pointwise descriptors of source and target: .npy or text, one row a vertex, column i "
        "the same quantity on both",
    )
    parser.add_argument(
        "--descriptor-weight",
        metavar="W",
        type=float,
        help="what their squared distances count, relative to those of the eigenfunctions (default: 0.25)",
    )
    parser.add_argument(
        "--component",
        metavar="N[,N]",
        help="the piece to match of a mesh with several, numbered from 1 for the largest as 'clalign check' lists "
        "them: of both meshes, or of source and target; '-' for the one that stands out",
    )


def chosen_components(text: str | None) -> tuple[int | None, int | None]:
    """Return the pieces of source and target that ``--component`` names; None where none is named.

    Raises
    ------
    OptionError
        The text is something else than one or two numbers from 1.
    """
    words = (text or "-").split(",")
    if len(words) > 2 or not all(word == "-" or (word.isdecimal() and int(word) > 0) for word in words):
        raise OptionError(f"--component {text}: expected one number from 1 for both meshes or two, such as 1,2 or -,2")
    chosen = [None if word == "-" else int(word) for word in words]
    return chosen[0], chosen[-1]


@dataclass(frozen=True)
class PairInput:
    """Two mesh files, which piece of each is meant, and what is known of the map between them.

    start : what `clalign.matching.start.starting_map` takes as text; None for a search.
    start_map : an alternative of the result that `start` names; 0 for its chosen map.
    landmarks : files.
    tolerance : of the landmarks, in sqrt(area).
    descriptors : files of source and target, or none.
    weight : of the descriptors; None for the usual one.
    """

    source: Path
    target: Path
    source_component: int | None = None
    target_component: int | None = None
    start: str | None = None
    landmarks: tuple[str, ...] = ()
    tolerance: float = 0.0
    descriptors: tuple[str, ...] = ()
    weight: float | None = None
    start_map: int = 0

    @staticmethod
    def of(args: argparse.Namespace) -> PairInput:
        """Return the input of a command with the arguments of `add_input_arguments`.

        Raises
        ------
        OptionError
            ``--component`` is no number, a tolerance is given without landmarks, a weight without descriptors, or an
            alternative without a start.
        """
        if args.landmark_tolerance and not args.landmarks:
            raise OptionError("--landmark-tolerance belongs to --landmarks FILE")
        if args.descriptor_weight is not None and not args.descriptors:
            raise OptionError("--descriptor-weight belongs to --descriptors FILE FILE")
        if args.start_map and args.start is None:
            raise OptionError("--start-map N belongs to --start RESULT")
        return PairInput(
            args.source,
            args.target,
            *chosen_components(args.component),
            start=args.start,
            landmarks=tuple(args.landmarks),
            tolerance=args.landmark_tolerance,
            descriptors=tuple(args.descriptors or ()),
            weight=args.descriptor_weight,
            start_map=args.start_map,
        )

    def meshes(self, options: SurfaceOptions) -> tuple[Mesh, Mesh]:
        """Read both files; what ``--component`` says counts before the options."""
        from clalign.mesh.mesh import load_mesh

        of_all = options.component or None
        source = load_mesh(self.source, strict=options.strict, component=self.source_component or of_all)
        return source, load_mesh(self.target, strict=options.strict, component=self.target_component or of_all)

    def known(self, source: Mesh, target: Mesh) -> dict[str, Any]:
        """Return the arguments of `clalign.match` that say what is known, with their files read."""
        from clalign.mesh.landmarks import landmarks_of

        landmarks = landmarks_of(self.landmarks, source, target, self.tolerance) if self.landmarks else None
        known: dict[str, Any] = {"start": self.start, "landmarks": landmarks}
        if self.start_map:
            from clalign.correspondence import Correspondence

            known["start"] = Correspondence.load(self.start or "").with_map(self.start_map)
        if self.descriptors:
            from clalign.transfer.value_files import read_values

            known["descriptors"] = tuple(read_values(path) for path in self.descriptors)
        if self.weight is not None:
            known["descriptor_weight"] = self.weight
        return known
