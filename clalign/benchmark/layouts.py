"""The folders that data sets come in, read into pairs. Missing files are named and the rest is kept."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from clalign.benchmark.pairs import BenchmarkPair, Pair, TruthFiles
from clalign.collection.members import mesh_stem, read_pairs_file
from clalign.errors import ResultError
from clalign.mesh.reading import SUFFIXES

FAUST_MESHES = 100
SHUFFLE_SEED = 20200
MESH_FOLDERS = ("", "off", "offs", "shapes", "meshes", "training/registrations")
VTS_FOLDERS = ("corres", "../corres", "off/corres", "offs/corres")


@dataclass(frozen=True)
class Layout:
    """The pairs of one suite of a data set.

    name : of the suite, "remeshed/pairs_same".
    pairs : those whose files are all there.
    problems : one sentence for each thing that is missing; those pairs are left out.
    """

    name: str
    pairs: tuple[BenchmarkPair, ...]
    problems: tuple[str, ...]

    def limited(self, limit: int | None) -> Layout:
        """Return the first `limit` pairs only."""
        return self if limit is None else Layout(self.name, self.pairs[:limit], self.problems)


def humans(path: str | Path, pairs: str | Path | None = None) -> tuple[Layout, ...]:
    """Read a folder in the layout of the humans: one suite for every pairs file.

    A folder holds meshes, and optionally ``mirror.txt`` (line i is the mirror image of line i), ``X.truth.txt``
    beside every mesh X (line i of any two is the same point; without them vertex i ↔ vertex i) and ``pairs*.txt``
    (source and target a line). Without a pairs file the first mesh meets all others.

    Parameters
    ----------
    path : such a folder, or a folder of such folders, of which those with a pairs file are read.
    pairs : a pairs file, by its path or by its place under `path`; only that is run.

    Raises
    ------
    ResultError
        There is no such folder or pairs file, or no mesh in it.
    """
    root = _existing_folder(path)
    if pairs is not None:
        listing = _find_pairs_file(root, Path(pairs))
        folder = listing.parent if _meshes(listing.parent) else root
        return (_listed_layout(folder, listing),)
    folders = [root] if _meshes(root) else sorted(child for child in root.iterdir() if child.is_dir())
    listings = [(folder, listing) for folder in folders for listing in sorted(folder.glob("pairs*.txt"), reverse=True)]
    if listings:
        return tuple(_listed_layout(folder, listing) for folder, listing in listings)
    layouts = tuple(_first_against_others(folder, folder.name) for folder in folders if _meshes(folder))
    if not layouts:
        raise ResultError(f"{root}: no mesh file here or one folder below ({', '.join(SUFFIXES)})")
    return layouts


def animals(path: str | Path) -> tuple[Layout, ...]:
    """Read folders of frames with one connectivity, vertex i ↔ vertex i: every pair of frames of each folder.

    Raises
    ------
    ResultError
        There is no such folder, or no mesh in it or one folder below.
    """
    root = _existing_folder(path)
    folders = [root] if _meshes(root) else sorted(child for child in root.iterdir() if child.is_dir())
    layouts = []
    for folder in folders:
        meshes = _meshes(folder)
        names = [(a, b) for i, a in enumerate(meshes) for b in list(meshes)[i + 1 :]]
        if names:
            layouts.append(_layout(folder.name, meshes, names, _identity_truth(folder), shuffle=True))
    if not layouts:
        raise ResultError(f"{root}: no folder with two or more frames ({', '.join(SUFFIXES)})")
    return tuple(layouts)


def faust(root: str | Path, pairs: str | Path = "intra") -> tuple[Layout, ...]:
    """Read a user's copy of FAUST, its remeshed version, SCAPE or TOSCA, by what lies in the folder.

    ``tr_reg_*.ply`` are the registrations (identity truth), ``*.off`` with ``corres/*.vts`` a remeshed set (1-based
    lines of the template) and ``*.off`` or ``*.ply`` alone classes of one connectivity (``cat0.off``, ``cat1.off``: one
    class).

    Parameters
    ----------
    root : the folder.
    pairs : "intra", each subject's (or class's) first pose against its others; "inter", the first pose of each
        subject against another pose of every later subject, pose (s + t) mod 10 of subject t for s < t; or a pairs
        file with two names or numbers a line.

    Raises
    ------
    ResultError
        No such folder or pairs file, or no mesh of a known layout.
    """
    folder = _existing_folder(root)
    meshes: dict[str, Path] = {}
    for suffix, pattern in ((".ply", "tr_reg_*"), (".off", "*"), (".ply", "*")):
        meshes = meshes or _first_meshes(folder, suffix, pattern)
    if not meshes:
        raise ResultError(f"{folder}: no tr_reg_*.ply, *.off or *.ply here or in {', '.join(MESH_FOLDERS[1:])}")
    mesh_folder = next(iter(meshes.values())).parent
    corres = next((found for name in VTS_FOLDERS if (found := mesh_folder / name).is_dir()), None)
    corres = corres or next((found for name in VTS_FOLDERS if (found := folder / name).is_dir()), None)
    names, label = _faust_names(folder, meshes, pairs)
    truths: TruthFiles | dict[str, TruthFiles] = _identity_truth(folder)
    if corres is not None:
        truths = {name: TruthFiles("lines", corres / f"{name}.vts", None, _mirror_file(folder)) for name in meshes}
    layout = _layout(f"{folder.name}/{label}", meshes, names, truths, shuffle=corres is None)
    return (dataclasses.replace(layout, problems=_absent_registrations(meshes) + layout.problems),)


def mesh_files(path: str | Path) -> tuple[Path, dict[str, Path]]:
    """Return a folder and the mesh files in it by stem.

    Raises
    ------
    ResultError
        There is no such folder, or no mesh in it.
    """
    folder = _existing_folder(path)
    meshes = _meshes(folder)
    if not meshes:
        raise ResultError(f"{folder}: no mesh file here ({', '.join(SUFFIXES)})")
    return folder, meshes


def _faust_names(folder: Path, meshes: dict[str, Path], pairs: str | Path) -> tuple[list[tuple[str, str]], str]:
    if str(pairs) not in ("intra", "inter"):
        listing = _find_pairs_file(folder, Path(pairs))
        return [(_mesh_name(a), _mesh_name(b)) for a, b in read_pairs_file(listing)], listing.stem
    if not any(re.fullmatch(r"tr_reg_\d{3}", name) for name in meshes):
        return _class_names(sorted(meshes, key=_class_and_number), str(pairs)), str(pairs)
    subjects = sorted({int(name[-3:]) // 10 for name in meshes if re.fullmatch(r"tr_reg_\d{3}", name)})
    if pairs == "intra":
        numbers = [(10 * s, 10 * s + pose) for s in subjects for pose in range(1, 10)]
    else:
        numbers = [(10 * s, 10 * t + (s + t) % 10) for s in subjects for t in subjects if s < t]
    return [(f"tr_reg_{a:03d}", f"tr_reg_{b:03d}") for a, b in numbers], str(pairs)


def _absent_registrations(meshes: Iterable[str]) -> tuple[str, ...]:
    """Say how many of FAUST's 100 meshes are not there; other data sets have no fixed number."""
    present = set(meshes)
    absent = [name for number in range(FAUST_MESHES) if (name := f"tr_reg_{number:03d}") not in present]
    if len(absent) == FAUST_MESHES or not absent:
        return ()
    return (f"{len(absent)} of FAUST's {FAUST_MESHES} meshes are absent ({absent[0]} … {absent[-1]})",)


def _class_names(ordered: Sequence[str], pairs: str) -> list[tuple[str, str]]:
    classes = [list(members) for _, members in groupby(ordered, key=lambda name: _class_and_number(name)[0])]
    if pairs == "inter":
        raise ResultError("classes of one connectivity have no truth between them: use --pairs intra or a pairs file")
    return [(members[0], other) for members in classes for other in members[1:]]


def _class_and_number(name: str) -> tuple[str, int]:
    stem = name.rstrip("0123456789")
    return stem, int(name[len(stem) :] or 0)


def _mesh_name(word: str) -> str:
    """Return the stem of a mesh named by its stem, its file or its FAUST number."""
    stem = mesh_stem(word)
    return f"tr_reg_{int(stem):03d}" if stem.isdigit() else stem


def _listed_layout(folder: Path, listing: Path) -> Layout:
    names = [(mesh_stem(a), mesh_stem(b)) for a, b in read_pairs_file(listing)]
    meshes = _meshes(folder)
    truths = _human_truth(folder, meshes)
    return _layout(f"{folder.name}/{listing.stem}", meshes, names, truths, shuffle=isinstance(truths, TruthFiles))


def _first_against_others(folder: Path, name: str) -> Layout:
    meshes = _meshes(folder)
    truths = _human_truth(folder, meshes)
    first = next(iter(meshes))
    names = [(first, other) for other in meshes if other != first]
    return _layout(name, meshes, names, truths, shuffle=isinstance(truths, TruthFiles))


def _human_truth(folder: Path, meshes: Iterable[str]) -> TruthFiles | dict[str, TruthFiles]:
    if not any(folder.glob("*.truth.txt")):
        if (folder / "corres").is_dir():
            raise ResultError(f"{folder}: the truth is in corres/*.vts, which 'clalign bench faust --root' reads")
        return _identity_truth(folder)
    mirror = _mirror_file(folder)
    return {name: TruthFiles("lines", folder / f"{name}.truth.txt", None, mirror) for name in meshes}


def _identity_truth(folder: Path) -> TruthFiles:
    return TruthFiles("identity", mirror=_mirror_file(folder))


def _mirror_file(folder: Path) -> Path | None:
    mirror = folder / "mirror.txt"
    return mirror if mirror.is_file() else None


def _layout(
    name: str,
    meshes: dict[str, Path],
    names: Iterable[tuple[str, str]],
    truths: TruthFiles | dict[str, TruthFiles],
    *,
    shuffle: bool,
) -> Layout:
    """Make the pairs; `truths` is one for all, or has the truth file of each mesh in its `source`."""
    pairs: list[Pair] = []
    left_out: dict[str, list[str]] = {}
    for number, (a, b) in enumerate(names):
        missing = [f"no mesh {mesh}" for mesh in (a, b) if mesh not in meshes]
        if not missing:
            pair = Pair(
                name=f"{a} {b}",
                source_path=meshes[a],
                target_path=meshes[b],
                truth=truths if isinstance(truths, TruthFiles) else _joined(truths[a], truths[b]),
                shuffle_seed=SHUFFLE_SEED + number if shuffle else None,
            )
            missing = [f"no file {path.name}" for path in pair.missing()]
        if missing:
            for reason in missing:
                left_out.setdefault(reason, []).append(f"{a} {b}")
        else:
            pairs.append(pair)
    problems = tuple(
        f"{name}: {reason}, so {len(skipped)} pair{'s' if len(skipped) > 1 else ''} left out "
        f"({', '.join(skipped[:3])}{', …' if len(skipped) > 3 else ''})"
        for reason, skipped in left_out.items()
    )
    return Layout(name, tuple(pairs), problems)


def _joined(source: TruthFiles, target: TruthFiles) -> TruthFiles:
    return TruthFiles("lines", source.source, target.source, source.mirror)


def _existing_folder(path: str | Path) -> Path:
    folder = Path(path).resolve()
    if not folder.is_dir():
        raise ResultError(f"{path} is not a folder")
    return folder


def _find_pairs_file(root: Path, pairs: Path) -> Path:
    tried = [pairs, root / pairs, *(child / pairs.name for child in sorted(root.iterdir()) if child.is_dir())]
    found = next((candidate for candidate in tried if candidate.is_file()), None)
    if found is None:
        raise ResultError(f"no pairs file {pairs}, neither as given nor in {root}")
    return found.resolve()


def _meshes(folder: Path) -> dict[str, Path]:
    """Return the mesh files of a folder by stem, in natural order (pose 2 before pose 10)."""
    files = [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.is_file()]
    return {path.stem: path for path in sorted(files, key=lambda path: _class_and_number(path.stem))}


def _first_meshes(folder: Path, suffix: str, pattern: str) -> dict[str, Path]:
    """Return the meshes of the first of the usual folders that has any."""
    for name in MESH_FOLDERS:
        files = sorted((folder / name).glob(pattern + suffix)) if (folder / name).is_dir() else []
        if files:
            return {path.stem: path for path in sorted(files, key=lambda path: _class_and_number(path.stem))}
    return {}
