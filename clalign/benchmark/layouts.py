"""The folders that data sets come in, read into pairs. Missing files are named and the rest is kept."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from itertools import combinations, groupby
from pathlib import Path

from clalign.benchmark.pairs import TRUTH_SUFFIX, BenchmarkPair, Pair, TruthFiles, mirror_file, truth_file
from clalign.collection.members import read_pairs_file
from clalign.errors import ResultError
from clalign.mesh.reading import SUFFIXES, is_mesh_name, mesh_stem

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
    layouts = []
    for folder in folders:
        first, *others = list(_meshes(folder)) or [""]
        if first:
            layouts.append(_human_layout(folder, folder.name, [(first, other) for other in others]))
    if not layouts:
        raise ResultError(f"{root}: no mesh file here or one folder below ({', '.join(SUFFIXES)})")
    return tuple(layouts)


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
        if len(meshes) > 1:
            layouts.append(_layout(folder, folder.name, meshes, combinations(meshes, 2)))
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
    places = [base / name for base in (mesh_folder, folder) for name in VTS_FOLDERS]
    corres = next((place for place in places if place.is_dir()), None)
    names, label = _faust_names(folder, meshes, pairs)
    points_of = None if corres is None else lambda mesh: corres / f"{mesh}.vts"
    layout = _layout(folder, f"{folder.name}/{label}", meshes, names, points_of)
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
        if pairs == "inter":
            raise ResultError(
                "classes of one connectivity have no truth between them: use --pairs intra or a pairs file"
            )
        classes = groupby(sorted(meshes, key=_class_and_number), key=lambda name: _class_and_number(name)[0])
        firsts = [(next(members), list(members)) for _, members in classes]
        return [(first, other) for first, others in firsts for other in others], str(pairs)
    subjects = sorted({int(name[-3:]) // 10 for name in meshes if re.fullmatch(r"tr_reg_\d{3}", name)})
    if pairs == "intra":
        numbers = [(10 * s, 10 * s + pose) for s in subjects for pose in range(1, 10)]
    else:
        numbers = [(10 * s, 10 * t + (s + t) % 10) for s in subjects for t in subjects if s < t]
    return [(f"tr_reg_{a:03d}", f"tr_reg_{b:03d}") for a, b in numbers], str(pairs)


def _absent_registrations(meshes: Iterable[str]) -> tuple[str, ...]:
    """Say how many of FAUST's 100 meshes are not there; other data sets have no fixed number."""
    absent = sorted({f"tr_reg_{number:03d}" for number in range(FAUST_MESHES)}.difference(meshes))
    if not 0 < len(absent) < FAUST_MESHES:
        return ()
    return (f"{len(absent)} of FAUST's {FAUST_MESHES} meshes are absent ({absent[0]} … {absent[-1]})",)


def _class_and_number(name: str) -> tuple[str, int]:
    stem = name.rstrip("0123456789")
    return stem, int(name[len(stem) :] or 0)


def _mesh_name(word: str) -> str:
    """Return the stem of a mesh named by its stem, its file or its FAUST number."""
    stem = mesh_stem(word)
    return f"tr_reg_{int(stem):03d}" if stem.isdigit() else stem


def _human_layout(folder: Path, name: str, names: Iterable[tuple[str, str]]) -> Layout:
    if any(folder.glob(f"*{TRUTH_SUFFIX}")):
        return _layout(folder, name, _meshes(folder), names, partial(truth_file, folder))
    if (folder / "corres").is_dir():
        raise ResultError(f"{folder}: the truth is in corres/*.vts, which 'clalign bench faust --root' reads")
    return _layout(folder, name, _meshes(folder), names)


def _listed_layout(folder: Path, listing: Path) -> Layout:
    names = [(mesh_stem(a), mesh_stem(b)) for a, b in read_pairs_file(listing)]
    return _human_layout(folder, f"{folder.name}/{listing.stem}", names)


def _layout(
    folder: Path,
    name: str,
    meshes: dict[str, Path],
    names: Iterable[tuple[str, str]],
    points_of: Callable[[str], Path] | None = None,
) -> Layout:
    """Make the pairs of a folder, whose ``mirror.txt`` counts.

    `points_of` gives the file of points of a mesh. Without it vertex i is vertex i of all, and targets are shuffled.
    """
    mirror = mirror_file(folder)
    pairs: list[Pair] = []
    left_out: dict[str, list[str]] = {}
    for number, (a, b) in enumerate(names):
        missing = [f"no mesh {mesh}" for mesh in (a, b) if mesh not in meshes]
        if not missing:
            if points_of is None:
                truth, seed = TruthFiles(mirror=mirror), SHUFFLE_SEED + number
            else:
                truth, seed = TruthFiles(points_of(a), points_of(b), mirror), None
            pair = Pair(f"{a} {b}", meshes[a], meshes[b], truth, seed)
            missing = [f"no file {path.name}" for path in pair.missing()]
        if not missing:
            pairs.append(pair)
        for reason in missing:
            left_out.setdefault(reason, []).append(f"{a} {b}")
    problems = tuple(
        f"{name}: {reason}, so {len(skipped)} pair{'s' if len(skipped) > 1 else ''} left out "
        f"({', '.join(skipped[:3])}{', …' if len(skipped) > 3 else ''})"
        for reason, skipped in left_out.items()
    )
    return Layout(name, tuple(pairs), problems)


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
    return _by_stem(path for path in folder.iterdir() if is_mesh_name(path) and path.is_file())


def _first_meshes(folder: Path, suffix: str, pattern: str) -> dict[str, Path]:
    """Return the meshes of the first of the usual folders that has any."""
    found = (_by_stem(sorted((folder / name).glob(pattern + suffix))) for name in MESH_FOLDERS)
    return next(filter(None, found), {})


def _by_stem(files: Iterable[Path]) -> dict[str, Path]:
    stems = sorted(((mesh_stem(path.name), path) for path in files), key=lambda pair: _class_and_number(pair[0]))
    return dict(stems)
