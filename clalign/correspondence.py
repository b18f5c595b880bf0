"""The result of a match: both maps, R, C, the eigenfunctions, and how they were found.

On disk a result is a folder of two text files (the maps, for any other program), ``result.npz`` (every array, named by
its place in `Correspondence`) and ``result.json`` (everything else).
"""

from __future__ import annotations

import dataclasses
import json
import math
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.alternatives import (
    Alternative,
    alternative_arrays,
    alternative_facts,
    finite_or_none,
    number_of,
    numbered,
    stored_alternatives,
)
from clalign.errors import ClalignWarning, OptionError, ResultError
from clalign.geometry.spectra import Spectrum
from clalign.maps.file_maps import vertex_status
from clalign.maps.point_maps import check_map, write_map
from clalign.mesh.mesh import Mesh
from clalign.mesh.stored import mesh_arrays, mesh_facts, stored_mesh
from clalign.options import Options
from clalign.partial.partiality import Partiality
from clalign.storage.files import write_json
from clalign.storage.folders import atomic_folder, recover

RESULT_FORMAT = 1
METHOD_VERSION = 1
"""Counts changes of the method after which the same meshes and options give another map."""

FACTS_FILE = "result.json"
ARRAYS_FILE = "result.npz"
FORWARD_FILE = "target_of_source.txt"
BACKWARD_FILE = "source_of_target.txt"

_ARRAYS = ("target_of_source", "source_of_target", "functional_map", "rotation", "distortion")
_SPECTRA = ("source_basis", "target_basis", "source_scale_invariant", "target_scale_invariant")


@dataclass(frozen=True, eq=False)
class Correspondence:
    """Dense correspondence between a source mesh X and a target mesh Y.

    Maps are in the vertex numbering of the files; functions on vertices are in the compact order of the meshes
    (`Mesh.file_index` and `Mesh.vertex_of_file` translate; both agree where a file is one clean surface).

    source, target : the meshes, scaled to unit area.
    target_of_source : (file_count_x,) int64, the target vertex of every source vertex; -1 for one that is left out.
    source_of_target : (file_count_y,) int64, the source vertex of every target vertex; -1 for one that is left out.
    functional_map : (k_y, k_x) float64, C: coefficients of a function on X to those of its image on Y (Eq. 13).
    rotation : (d, d) float64, R, banded and nearly orthogonal (Eq. 20); (d_x, d_y) where one mesh is a part.
    source_basis, target_basis : LBO eigenfunctions of both meshes.
    source_scale_invariant, target_scale_invariant : scale-invariant eigenfunctions; the signs that the search found are
        already in those of the source.
    history : one entry an evaluation: outer_iteration, evaluation, total, align, unsup, cycle, unitarity.
    losses : the terms at the kept point.
    confidence : in [0, 1], by how much the chosen map beats the best different one; NaN where none was looked for.
    orientation : from -1 (mirrored) to 1 (orientation kept).
    distortion : (n_x,) float64, local metric distortion of the map at every source vertex.
    alternatives : the best different maps, best first.
    timings : seconds a stage.
    warnings : what a reader should know before trusting the maps.
    device : the device that computed, as it names itself.
    options, versions : what is needed to repeat the match.
    source_faces, source_barycentric : (file_count_x,) int64 and (file_count_x, 3) float64, the point of the target
        of every source vertex as a target face and weights of its corners; None without the sub-vertex read-out.
    score : of the chosen map, as `Alternative.score`; NaN where no search was made.
    xi : exponent ξ of the metric, as given or as chosen for the pair.
    status : how the optimisation of R ended: converged, noise floor, budget, failed, not run, or interrupted (Ctrl-C).
    landmarks : what became of each landmark that the user gave: its name, its vertices in both files ("source",
        "target"), the distance from the map's image in sqrt(area), and whether it was "used" and kept exactly.
    shown_map : which map this is, 0 for the chosen one; see `with_map`.
    equally_good : maps that are as good as the chosen one, as symmetries give them: the "relation" in words, whether it
        is "reversing", its "order" (or None), the share of the area "moved", and which "alternative" (or None) it is.
    part : which mesh was matched as a part of the other, and how; None for two wholes.
    method : version of the method, which counts changes after which the same input gives another map.

    Raises
    ------
    ResultError
        The sizes do not fit together, or a map names a vertex that its mesh does not have.
    """

    source: Mesh
    target: Mesh
    target_of_source: NDArray[np.int64]
    source_of_target: NDArray[np.int64]
    functional_map: NDArray[np.float64]
    rotation: NDArray[np.float64]
    source_basis: Spectrum
    target_basis: Spectrum
    source_scale_invariant: Spectrum
    target_scale_invariant: Spectrum
    history: tuple[dict[str, float], ...]
    losses: dict[str, float]
    confidence: float
    orientation: float
    distortion: NDArray[np.float64]
    alternatives: tuple[Alternative, ...]
    timings: dict[str, float]
    warnings: tuple[str, ...]
    device: str
    options: Options
    versions: dict[str, str]
    source_faces: NDArray[np.int64] | None = None
    source_barycentric: NDArray[np.float64] | None = None
    score: float = math.nan
    xi: float = math.nan
    status: str = ""
    method: int = METHOD_VERSION
    landmarks: tuple[dict[str, Any], ...] = ()
    equally_good: tuple[dict[str, Any], ...] = ()
    shown_map: int = 0
    part: Partiality | None = None

    def __post_init__(self) -> None:
        source, target = self.source, self.target
        every_map: tuple[Correspondence | Alternative, ...] = (self, *self.alternatives)
        for maps in every_map:
            check_map("target_of_source", maps.target_of_source, source.file_count, target.file_count)
            check_map("source_of_target", maps.source_of_target, target.file_count, source.file_count)
        for name, mesh in zip(_SPECTRA, (source, target, source, target), strict=True):
            if (rows := len(getattr(self, name).functions)) != mesh.n_vertices:
                raise ResultError(f"{name}: has {rows} rows, the mesh {mesh.name!r} has {mesh.n_vertices} vertices")
        if len(self.distortion) != source.n_vertices:
            raise ResultError(f"distortion: has {len(self.distortion)} values, not one a source vertex")

    @property
    def source_aligned(self) -> NDArray[np.float64]:
        """(n_x, d) scale-invariant eigenfunctions of the source turned towards the target's, Φ̃R (Eq. 20)."""
        return self.source_scale_invariant.functions[:, : len(self.rotation)] @ self.rotation

    @property
    def target_aligned(self) -> NDArray[np.float64]:
        """(n_y, d) those of the target turned towards the source's, Ψ̃Rᵀ; Ψ̃ as it is for a one-sided match (Eq. 18)."""
        functions = self.target_scale_invariant.functions[:, : self.rotation.shape[1]]
        return functions if self.options.alignment.sides == "one" else functions @ self.rotation.T

    @property
    def barycentric(self) -> tuple[NDArray[np.int64], NDArray[np.float64]] | None:
        """`source_faces` and `source_barycentric`, or None without the sub-vertex read-out."""
        faces, weights = self.source_faces, self.source_barycentric
        return None if faces is None or weights is None else (faces, weights)

    def __getattr__(self, name: str) -> Any:
        if name not in ("source_descriptors", "target_descriptors"):
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        now = name.replace("descriptors", "scale_invariant")
        warnings.warn(
            f"Correspondence.{name} is now {now}; the old name is accepted for one release",
            ClalignWarning,
            stacklevel=2,
        )
        return getattr(self, now)

    @property
    def source_status(self) -> NDArray[np.uint8]:
        """(file_count_x,) how each source vertex came to its match: `VertexStatus`."""
        return vertex_status(self.source, self.target_of_source)

    @property
    def target_status(self) -> NDArray[np.uint8]:
        """(file_count_y,) how each target vertex came to its match: `VertexStatus`."""
        return vertex_status(self.target, self.source_of_target)

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C cut the match short; `match` returns then, so a loop over many pairs should ask and end."""
        return self.status == "interrupted"

    def __repr__(self) -> str:
        source, target = self.source, self.target
        confidence = "" if math.isnan(self.confidence) else f", confidence {self.confidence:.2f}"
        orientation = "" if math.isnan(self.orientation) else f", orientation {self.orientation:+.2f}"
        counts = f"{source.n_vertices:,} -> {target.n_vertices:,} vertices"
        return f"<Correspondence {source.name} -> {target.name}: {counts}{confidence}{orientation}>"

    def _repr_html_(self) -> str:
        """Show the match in a notebook."""
        import clalign

        return str(clalign.notebook_html(self))

    def with_map(self, number: int) -> Correspondence:
        """Return the result with the maps of an alternative, from 1 for the best, in the place of the chosen ones.

        C, R and the distortion remain those of the chosen map; a match that starts from the alternative has its own,
        ``start=result.with_map(n)``. 0 returns the result itself; ResultError if there is no such alternative.
        """
        if number == 0:
            return self
        other = numbered(self.alternatives, number)
        return dataclasses.replace(
            self,
            target_of_source=other.target_of_source,
            source_of_target=other.source_of_target,
            orientation=other.orientation,
            score=other.score,
            source_faces=None,
            source_barycentric=None,
            shown_map=number,
        )

    def facts(self) -> dict[str, Any]:
        """Return everything but the arrays as plain values: the content of ``result.json``."""
        return {
            "format": RESULT_FORMAT,
            "source": mesh_facts(self.source),
            "target": mesh_facts(self.target),
            "device": self.device,
            "confidence": finite_or_none(self.confidence),
            "orientation": finite_or_none(self.orientation),
            "score": finite_or_none(self.score),
            "xi": finite_or_none(self.xi),
            "status": self.status,
            "method": self.method,
            "landmarks": [dict(each) for each in self.landmarks],
            "equally_good": [dict(each) for each in self.equally_good],
            "part": None if self.part is None else self.part.as_dict(),
            "losses": {name: finite_or_none(value) for name, value in self.losses.items()},
            "counts": self._counts(),
            "timings": {name: finite_or_none(value) for name, value in self.timings.items()},
            "warnings": list(self.warnings),
            "alternatives": [alternative_facts(each) for each in self.alternatives],
            "options": self.options.as_dict(),
            "versions": dict(self.versions),
        }

    def _counts(self) -> dict[str, int]:
        return {
            "basis_source": self.source_basis.functions.shape[1],
            "basis_target": self.target_basis.functions.shape[1],
            "functional_map_rows": self.functional_map.shape[0],
            "functional_map_columns": self.functional_map.shape[1],
            "scale_invariant": len(self.rotation),
            "evaluations": len(self.history),
            "alternatives": len(self.alternatives),
        }

    def save(
        self, folder: str | Path, *, force: bool = False, extra_files: Callable[[Path], None] | None = None
    ) -> None:
        """Write the result into a folder, all or nothing.

        Eigenfunctions are stored in single precision, everything else as it is.

        Parameters
        ----------
        folder : the folder to make; parents are made as needed.
        force : replace an earlier result in that folder (never a folder with other content).
        extra_files : called with the path of the unfinished folder, to add files that belong to the same whole.

        Raises
        ------
        ResultError
            The folder exists and may not be replaced, the disk refused (what was there before is untouched), or this is
            an alternative of another result.
        """
        if self.shown_map:
            raise ResultError(f"this is alternative {self.shown_map} of a result; save the result itself")
        with atomic_folder(Path(folder), FACTS_FILE, force=force) as unfinished:
            write_map(unfinished / FORWARD_FILE, self.target_of_source)
            write_map(unfinished / BACKWARD_FILE, self.source_of_target)
            arrays: dict[str, Any] = dict(_arrays(self))
            np.savez(unfinished / ARRAYS_FILE, **arrays)
            if extra_files is not None:
                extra_files(unfinished)
            write_json(unfinished / FACTS_FILE, self.facts())

    @staticmethod
    def load(folder: str | Path) -> Correspondence:
        """Read what `save` wrote.

        Raises
        ------
        ResultError
            The folder is not a result, a file of it is missing or damaged, or its parts do not fit together.
        """
        folder = Path(folder)
        recover(folder)
        facts = _read_facts(folder)
        arrays = _read_arrays(folder)
        try:
            return _assembled(facts, arrays)
        except ResultError as error:
            raise ResultError(f"{folder}: the result is damaged: {error}") from error
        except (KeyError, TypeError, ValueError, IndexError) as error:
            detail = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else str(error)
            raise ResultError(f"{folder}: the result is damaged: {detail}; match the meshes again") from error


def _arrays(result: Correspondence) -> Iterator[tuple[str, NDArray[Any]]]:
    for side in ("source", "target"):
        yield from ((f"{side}.{name}", values) for name, values in mesh_arrays(getattr(result, side)).items())
    for name in _SPECTRA:
        spectrum = getattr(result, name)
        yield f"{name}.eigenvalues", spectrum.eigenvalues
        yield f"{name}.functions", spectrum.functions.astype(np.float32)
        yield f"{name}.mass", spectrum.mass
    yield from ((name, getattr(result, name)) for name in _ARRAYS)
    for number, alternative in enumerate(result.alternatives):
        yield from alternative_arrays(number, alternative)
    columns = list(dict.fromkeys(name for entry in result.history for name in entry))
    yield "history.columns", np.array(columns, dtype=np.str_)
    values = [[entry.get(name, np.nan) for name in columns] for entry in result.history]
    yield "history.values", np.array(values, dtype=np.float64)
    if result.barycentric is not None:
        yield from zip(("source_faces", "source_barycentric"), result.barycentric, strict=True)


def _read_facts(folder: Path) -> dict[str, Any]:
    path = folder / FACTS_FILE
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ResultError(f"{folder}: is not a result folder of clalign, it has no {FACTS_FILE}") from error
    except (OSError, ValueError) as error:
        raise ResultError(f"{path}: cannot be read: {error}") from error
    found = facts.get("format") if isinstance(facts, dict) else None
    if found != RESULT_FORMAT:
        raise ResultError(f"{path}: has format {found!r}, this version of clalign reads format {RESULT_FORMAT}")
    return facts


def _read_arrays(folder: Path) -> dict[str, NDArray[Any]]:
    path = folder / ARRAYS_FILE
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            # Results of the release before call the scale-invariant eigenfunctions descriptors.
            return {name.replace("_descriptors.", "_scale_invariant."): stored[name] for name in stored.files}
    except FileNotFoundError as error:
        raise ResultError(f"{folder}: {ARRAYS_FILE} is missing; match the meshes again") from error
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise ResultError(f"{path}: cannot be read: {error}; match the meshes again") from error


def _assembled(facts: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Correspondence:
    try:
        options = Options.from_dict(facts["options"])
    except OptionError as error:
        raise ResultError(str(error)) from error
    plain: dict[str, Any] = {name: arrays[name] for name in _ARRAYS}
    plain |= {name: _spectrum(name, arrays) for name in _SPECTRA}
    columns = ["outer_iteration" if name == "round" else str(name) for name in arrays["history.columns"]]
    return Correspondence(
        source=stored_mesh(facts["source"], _within("source.", arrays)),
        target=stored_mesh(facts["target"], _within("target.", arrays)),
        **plain,
        history=tuple(
            {name: float(value) for name, value in zip(columns, row, strict=True) if not np.isnan(value)}
            for row in arrays["history.values"]
        ),
        losses={name: number_of(value) for name, value in facts["losses"].items()},
        confidence=number_of(facts["confidence"]),
        orientation=number_of(facts["orientation"]),
        alternatives=stored_alternatives(facts["alternatives"], arrays),
        timings={name: number_of(value) for name, value in facts["timings"].items()},
        warnings=tuple(facts["warnings"]),
        device=str(facts["device"]),
        options=options,
        versions=dict(facts["versions"]),
        source_faces=arrays.get("source_faces"),
        source_barycentric=arrays.get("source_barycentric"),
        # A result of an earlier version lacks what was not kept then.
        score=number_of(facts.get("score")),
        xi=number_of(facts.get("xi")),
        status=str(facts.get("status", "")),
        method=int(facts.get("method", 0)),
        landmarks=tuple(facts.get("landmarks", ())),
        equally_good=tuple(facts.get("equally_good", ())),
        part=Partiality(**facts["part"]) if facts.get("part") else None,
    )


def _within(prefix: str, arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the arrays whose names begin with a prefix, without it."""
    return {name.removeprefix(prefix): values for name, values in arrays.items() if name.startswith(prefix)}


def _spectrum(name: str, arrays: Mapping[str, NDArray[Any]]) -> Spectrum:
    return Spectrum(
        eigenvalues=arrays[f"{name}.eigenvalues"],
        functions=arrays[f"{name}.functions"].astype(np.float64),
        mass=arrays[f"{name}.mass"],
    )
