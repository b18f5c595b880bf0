"""Which files may be written for a match: never those of its own meshes, and others only where that was asked for."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from clalign.correspondence import Correspondence
from clalign.errors import ResultError
from clalign.mesh.mesh import Mesh
from clalign.storage.folders import check_files


def check_outputs(correspondence: Correspondence, paths: Sequence[Path], *, force: bool) -> None:
    """Refuse to replace a mesh of the match, and any other file unless `force`, before work is done for them.

    Raises
    ------
    ResultError
        Naming the first such file.
    """
    keep_originals(correspondence, paths)
    check_files(paths, force=force)


def keep_originals(correspondence: Correspondence, paths: Sequence[Path]) -> None:
    """Refuse to replace the files that the source and the target were read from.

    Raises
    ------
    ResultError
        Naming the first such file.
    """
    keep_meshes((correspondence.source, correspondence.target), paths)


def keep_meshes(meshes: tuple[Mesh, Mesh], paths: Sequence[Path]) -> None:
    """Do what `keep_originals` does for a source and a target that are still to be matched."""
    for path in paths:
        for role, mesh in zip(("source", "target"), meshes, strict=True):
            own = mesh.path
            if own is not None and _same(path, Path(own)):
                raise ResultError(
                    f"{path}: is the {role} of this match, and the original is worth keeping; choose another --out"
                )


def _same(one: Path, other: Path) -> bool:
    """Whether two paths name one file, through links, too."""
    try:
        return os.path.samefile(one, other)
    except OSError:
        return one.absolute() == other.absolute()
