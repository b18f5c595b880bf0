"""How far a map is from the truth: geodesic errors on the target, curves, flips, coverage and smoothness.

Lengths are in units of sqrt(area of the target); meshes are scaled to unit area on load.
"""

from __future__ import annotations

import csv
import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clalign.errors import ResultError
from clalign.evaluation.distances import METHODS, DistanceMethod, Distances
from clalign.evaluation.truth import Truth
from clalign.geometry.operators import lumped_mass, stiffness
from clalign.mesh.mesh import Mesh
from clalign.mesh.topology import edge_table
from clalign.storage.files import write_text

if TYPE_CHECKING:
    from clalign.correspondence import Correspondence

THRESHOLDS: NDArray[np.float64] = np.linspace(0.0, 0.25, 251)
QUANTILES = (0.25, 0.5, 0.75, 0.9, 0.95, 0.99)
DEFAULT_POINTS = 500


@dataclass(frozen=True)
class MapQuality:
    """Coverage and smoothness of a vertex map.

    covered_vertices : share of the target's vertices that are the match of some source vertex.
    covered_area : share of the target's area that belongs to those vertices.
    dirichlet : Dirichlet energy ½ Σ_k f_kᵀ W f_k of the map as a function into space, f = coordinates of the
        matches, divided by the source's area; 1 for an isometry, larger for a map that tears.
    stretch : mean over the source's edges of the distance between the matches of their ends, divided by the edge's
        length; 1 for an isometry up to the targets' vertices being discrete. Both are None where no face is matched
        as a whole.
    """

    covered_vertices: float
    covered_area: float
    dirichlet: float | None
    stretch: float | None


@dataclass(frozen=True)
class Evaluation:
    """Errors of one map.

    Attributes
    ----------
    name : of the pair.
    points : (p,) int64, the lines of the truth that were measured.
    errors : (p,) float64, geodesic distance on the target from the match to the truth, in sqrt(area).
    mirrored_errors : (p,) the same to the mirrored truth, or None.
    subvertex_errors : (p,) the same for the matches inside faces, or None.
    exact : share of the measured points matched to the very vertex of the truth.
    diameter : of the target, in sqrt(area): the largest distance seen from farthest points.
    unmatched : measured points that the map leaves without a match; they are in no error.
    skipped : lines of the truth at vertices that are not on the surface, between which there are no distances.
    quality : coverage and smoothness of the whole map.
    method : how distances were measured.
    """

    name: str
    points: NDArray[np.int64]
    errors: NDArray[np.float64]
    mirrored_errors: NDArray[np.float64] | None
    subvertex_errors: NDArray[np.float64] | None
    exact: float
    diameter: float
    unmatched: int
    skipped: int
    quality: MapQuality
    method: str

    @property
    def mean(self) -> float:
        """Mean error in sqrt(area); tables print it times 100."""
        return float(self.errors.mean())

    @property
    def median(self) -> float:
        """Median error in sqrt(area)."""
        return float(np.median(self.errors))

    @property
    def mirrored_mean(self) -> float | None:
        """Mean error to the mirrored truth in sqrt(area)."""
        return None if self.mirrored_errors is None else float(self.mirrored_errors.mean())

    @property
    def subvertex_mean(self) -> float | None:
        """Mean error of the matches inside faces in sqrt(area)."""
        return None if self.subvertex_errors is None else float(self.subvertex_errors.mean())

    @property
    def flipped(self) -> bool | None:
        """Whether the map is nearer to the mirrored truth than to the truth; None without a mirrored truth."""
        mirrored = self.mirrored_mean
        return None if mirrored is None else mirrored < self.mean

    def curve(self, *, per_diameter: bool = False) -> NDArray[np.float64]:
        """Share of the points with an error of at most each of `THRESHOLDS`.

        `per_diameter` divides errors by the diameter of the target, as Fig. 5 of the paper does.
        """
        return error_curve(self.errors / self.diameter if per_diameter else self.errors)

    def area_under_curve(self, *, per_diameter: bool = False) -> float:
        """Area under the curve over r in 0 … 0.25, divided by 0.25: 1 is a perfect map."""
        return area_under_curve(self.curve(per_diameter=per_diameter))

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers for JSON: everything but the error of each single point."""
        return {
            "name": self.name,
            "points": int(self.points.size),
            "unmatched": self.unmatched,
            "skipped": self.skipped,
            "distances": self.method,
            "diameter": self.diameter,
            "exact": self.exact,
            "flipped": self.flipped,
            "per_sqrt_area": _statistics(self.errors),
            "per_diameter": _statistics(self.errors / self.diameter),
            "mirrored_per_sqrt_area": None if self.mirrored_errors is None else _statistics(self.mirrored_errors),
            "subvertex_per_sqrt_area": None if self.subvertex_errors is None else _statistics(self.subvertex_errors),
            "coverage": {"vertices": self.quality.covered_vertices, "area": self.quality.covered_area},
            "smoothness": {"dirichlet": self.quality.dirichlet, "stretch": self.quality.stretch},
            "curve": {
                "threshold": THRESHOLDS.tolist(),
                "per_sqrt_area": self.curve().tolist(),
                "per_diameter": self.curve(per_diameter=True).tolist(),
            },
        }

    def write_json(self, path: str | Path) -> None:
        """Write `as_dict` to a file; raises `ResultError` when that fails."""
        write_text(path, json.dumps(self.as_dict(), indent=1) + "\n")

    def write_csv(self, path: str | Path) -> None:
        """Write one line a measured point: line of the truth, error, mirrored and sub-vertex error where known.

        Raises
        ------
        ResultError
            The file cannot be written.
        """
        columns: dict[str, NDArray[Any]] = {"point": self.points, "error": self.errors}
        if self.mirrored_errors is not None:
            columns["mirrored_error"] = self.mirrored_errors
        if self.subvertex_errors is not None:
            columns["subvertex_error"] = self.subvertex_errors
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))
        write_text(path, text.getvalue())


def error_curve(errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (251,) share of `errors` that are at most each of `THRESHOLDS`."""
    return np.searchsorted(np.sort(errors), THRESHOLDS, side="right") / errors.size


def area_under_curve(curve: NDArray[np.float64]) -> float:
    """Area under a curve sampled at `THRESHOLDS` by the trapezoidal rule, divided by 0.25."""
    return float(np.mean((curve[1:] + curve[:-1]) / 2))


def _statistics(errors: NDArray[np.float64]) -> dict[str, float]:
    quantiles = np.quantile(errors, QUANTILES)
    values = {"mean": float(errors.mean()), "median": float(np.median(errors)), "max": float(errors.max())}
    values |= {f"q{round(100 * q)}": float(value) for q, value in zip(QUANTILES, quantiles, strict=True)}
    return values | {"area_under_curve": area_under_curve(error_curve(errors))}


def evaluate(
    correspondence: Correspondence | ArrayLike,
    truth: Truth,
    *,
    source: Mesh | None = None,
    target: Mesh | None = None,
    mirrored: Truth | None = None,
    barycentric: tuple[NDArray[np.integer], NDArray[np.float64]] | None = None,
    points: int | ArrayLike | None = None,
    seed: int = 0,
    method: DistanceMethod = "heat",
    name: str | None = None,
) -> Evaluation:
    """Measure a map against the truth.

    Parameters
    ----------
    correspondence : a result of `clalign.match`, or (file vertices of X,) int, the target vertex of every source
        vertex in the numbering of the files, 0-based, -1 for vertices without a match.
    truth : the same points on both shapes.
    source, target : the meshes; taken from the result when that is given.
    mirrored : truth of the left–right confusion (`Truth.mirrored`), line by line beside `truth`.
    barycentric : faces of Y (file vertices of X,) and weights (file vertices of X, 3) of matches inside faces;
        taken from the result when it has them.
    points : which lines of the truth are measured: a number drawn with `seed`, or the lines themselves; None
        measures all lines of a truth of up to 500 and 500 drawn ones of a longer truth.
    method : "heat" (potpourri3d), or "bounded", the larger of that and the straight distance; the heat method
        underestimates distances of one edge by about a tenth.
    name : of the pair.

    Raises
    ------
    ResultError
        The map does not fit its meshes, the truth does not, or no point is left to measure.
    """
    if method not in METHODS:
        raise ResultError(f"unknown distance method {method!r}; there are {', '.join(METHODS)}")
    index, source, target, barycentric = _unpack(correspondence, source, target, barycentric)
    lines = _chosen_lines(truth, points, seed)
    target_of_source, on_surface, matched, ends = _measured_points(index, source, target, truth, mirrored, lines)
    distances = Distances(target, method)
    matches = target_of_source[ends[0]]
    errors, *mirrored_errors = distances.from_matches(matches, *ends[1:])
    return Evaluation(
        name=name if name is not None else f"{source.name} {target.name}",
        points=lines[matched],
        errors=errors,
        mirrored_errors=mirrored_errors[0] if mirrored_errors else None,
        subvertex_errors=_subvertex_errors(distances, target, ends[1], source.file_index[ends[0]], barycentric),
        exact=float(np.mean(matches == ends[1])),
        diameter=distances.diameter(),
        unmatched=int(np.sum(on_surface & ~matched)),
        skipped=int(np.sum(~on_surface)),
        quality=map_quality(source, target, target_of_source),
        method=METHODS[method],
    )


def _unpack(
    correspondence: Correspondence | ArrayLike,
    source: Mesh | None,
    target: Mesh | None,
    barycentric: tuple[NDArray[np.integer], NDArray[np.float64]] | None,
) -> tuple[NDArray[np.int64], Mesh, Mesh, tuple[NDArray[np.integer], NDArray[np.float64]] | None]:
    result: Any = correspondence
    if hasattr(result, "target_of_source"):
        source = source or result.source
        target = target or result.target
        barycentric = result.barycentric if barycentric is None else barycentric
        result = result.target_of_source
    if source is None or target is None:
        raise ResultError("a bare map needs both meshes: pass source= and target=")
    index = np.asarray(result)
    if index.ndim != 1 or index.dtype.kind not in "iu":
        raise ResultError(f"a map is one row of whole numbers, got {index.dtype} of shape {index.shape}")
    if index.size != source.file_count:
        raise ResultError(
            f"the map has {index.size} entries, but the source {source.name} has {source.file_count} vertices; were "
            "source and target exchanged?"
        )
    bad = np.flatnonzero((index < -1) | (index >= target.file_count))
    if bad.size:
        raise ResultError(
            f"source vertex {bad[0]} is matched to target vertex {index[bad[0]]}, but the target {target.name} has "
            f"{target.file_count} vertices (0-based numbers)"
        )
    return index.astype(np.int64), source, target, barycentric


def _chosen_lines(truth: Truth, points: int | ArrayLike | None, seed: int) -> NDArray[np.int64]:
    if points is None:
        points = DEFAULT_POINTS
    if isinstance(points, (int, np.integer)):
        if points < 1:
            raise ResultError(f"points must be at least 1, got {points}")
        if truth.count <= points:
            return np.arange(truth.count)
        return np.sort(np.random.default_rng(seed).choice(truth.count, int(points), replace=False))
    lines = np.asarray(points, dtype=np.int64)
    if lines.ndim != 1 or not lines.size or lines.min() < 0 or lines.max() >= truth.count:
        raise ResultError(f"points must be lines of the truth, 0 … {truth.count - 1}")
    return lines


def _measured_points(
    index: NDArray[np.int64],
    source: Mesh,
    target: Mesh,
    truth: Truth,
    mirrored: Truth | None,
    lines: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.bool_], list[NDArray[np.int64]]]:
    """Return what is measured, in the vertex numbers of `Mesh.vertices`.

    Returns
    -------
    The map (n,); which of the lines have all their points on the surfaces, and which of them a match too; and of the
    latter the source, target and, where known, mirrored points.
    """
    truth.check_against(source.file_count, target.file_count)
    if mirrored is not None:
        mirrored.check_against(source.file_count, target.file_count)
        if mirrored.count != truth.count:
            raise ResultError(f"the mirrored truth has {mirrored.count} lines and the truth {truth.count}")
    target_of_source = source.map_from_file(target, index)
    off = np.flatnonzero((source.from_file(index) >= 0) & (target_of_source < 0))
    if off.size:
        raise ResultError(
            f"source vertex {source.file_index[off[0]]} is matched to a target vertex that is not on the surface"
        )
    ends = [source.vertex_of_file[truth.source_points[lines]]]
    ends += [target.vertex_of_file[side.target_points[lines]] for side in (truth, mirrored) if side is not None]
    on_surface = np.logical_and.reduce([end >= 0 for end in ends])
    matched = on_surface & (target_of_source[ends[0]] >= 0)
    if not matched.any():
        raise ResultError("no point of the truth is left to measure: the map has no match at any of them")
    return target_of_source, on_surface, matched, [end[matched] for end in ends]


def _subvertex_errors(
    distances: Distances,
    target: Mesh,
    truth: NDArray[np.int64],
    file_vertices: NDArray[np.int64],
    barycentric: tuple[NDArray[np.integer], NDArray[np.float64]] | None,
) -> NDArray[np.float64] | None:
    if barycentric is None:
        return None
    faces, weights = (np.asarray(values)[file_vertices] for values in barycentric)
    if faces.min() < 0 or faces.max() >= target.n_faces:
        raise ResultError(f"the sub-vertex match of a measured point names a face outside 0 … {target.n_faces - 1}")
    return distances.to_face_points(truth, target.faces[faces], weights)


def map_quality(source: Mesh, target: Mesh, target_of_source: NDArray[np.int64]) -> MapQuality:
    """Return coverage and smoothness of a map between compact vertices, (n,) int64 with -1 for none."""
    hit = np.unique(target_of_source[target_of_source >= 0])
    mass = lumped_mass(target.vertices, target.faces)
    covered = hit.size / target.n_vertices, float(mass[hit].sum() / mass.sum())
    corners = source.faces[(target_of_source[source.faces] >= 0).all(axis=1)]
    if not corners.size:
        return MapQuality(*covered, None, None)
    used, local = np.unique(corners, return_inverse=True)
    faces = local.reshape(corners.shape).astype(np.int32)
    points = source.vertices[used]
    images = target.vertices[target_of_source[used]]
    area = float(lumped_mass(points, faces).sum())
    energy = 0.5 * float(np.sum(images * (stiffness(points, faces) @ images)))
    one, other = edge_table(faces, len(points)).edges.T
    lengths = np.linalg.norm(points[one] - points[other], axis=1)
    image_lengths = np.linalg.norm(images[one] - images[other], axis=1)
    return MapQuality(*covered, energy / area, float(np.mean(image_lengths / lengths)))
