"""From a part on a whole to the result of a match."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clalign.correspondence import Alternative, Correspondence
from clalign.engine.backend import Backend
from clalign.errors import ConfidenceWarning
from clalign.geometry.spectra import Spectrum
from clalign.maps.file_maps import file_maps
from clalign.maps.point_maps import PointMaps
from clalign.matching.result import doubts, mesh_notes, raise_warnings, versions
from clalign.matching.state import orientation_sign
from clalign.mesh.mesh import Mesh
from clalign.options import Options
from clalign.partial.find import PartMatch, Placement
from clalign.partial.partiality import Partiality
from clalign.partial.whole import Whole


def part_result(
    source: Mesh,
    target: Mesh,
    partiality: Partiality,
    whole: Whole,
    chosen: PartMatch,
    others: list[PartMatch],
    backend: Backend,
    options: Options,
    seconds: dict[str, float],
) -> Correspondence:
    """Return the result of a part on a whole, in the vertex numbering of the files.

    Parameters
    ----------
    whole : with its places.
    chosen, others : the map, and the best different ones.
    """
    placement, rotation = chosen.placement, chosen.grown.functional
    size, wide = rotation.shape
    bases = _unit_basis(placement, size), whole.surface.basis.head(wide)
    part_is_source = partiality.side == "source"
    # R turns functions of the source towards those of the target (Eq. 20): here Φ R ≈ Ψ on the part.
    if not part_is_source:
        bases, rotation = bases[::-1], rotation.T
    facing = orientation_of(placement, options)
    least = options.rules.parts.facing.least
    judged = doubts(facing, chosen.confidence, least, options, alternatives=bool(others))
    raise_warnings(judged, ConfidenceWarning)
    return Correspondence(
        source=source,
        target=target,
        **vars(file_maps(source, target, _maps(chosen, part_is_source=part_is_source))),
        functional_map=np.ascontiguousarray(rotation.T),
        rotation=np.ascontiguousarray(rotation),
        source_basis=bases[0],
        target_basis=bases[1],
        # With the Euclidean metric the scale-invariant eigenfunctions are those of Laplace and Beltrami (Eq. 3).
        source_scale_invariant=bases[0],
        target_scale_invariant=bases[1],
        history=(),
        losses={},
        confidence=chosen.confidence,
        orientation=facing,
        distortion=_distortion(chosen, whole, part_is_source=part_is_source),
        alternatives=tuple(
            _alternative(source, target, other, placement, whole, options, part_is_source=part_is_source)
            for other in others
        ),
        timings=seconds,
        warnings=(*judged, partiality.sentence(source.name, target.name), *mesh_notes(source, target)),
        device=backend.name,
        options=options,
        versions=versions(),
        score=placement.score,
        xi=0.0,
        status="not run",
        part=partiality,
    )


def orientation_of(placement: Placement, options: Options) -> float:
    """Return the orientation of the chosen candidate, −1 where it is mirrored."""
    sign = orientation_sign(options)
    return float(placement.facing[placement.chosen]) * (sign or 1.0)


def _maps(found: PartMatch, *, part_is_source: bool) -> PointMaps:
    maps = PointMaps(found.grown.whole_of_part, found.part_of_whole)
    return maps if part_is_source else maps.reversed


def _unit_basis(placement: Placement, size: int) -> Spectrum:
    """Return the part's functions in the unit of its own mesh, in which its area is 1."""
    basis, factor = placement.part.basis.head(size), placement.factor
    return Spectrum(basis.eigenvalues * factor**2, basis.functions * factor, basis.mass / factor**2)


def _distortion(found: PartMatch, whole: Whole, *, part_is_source: bool) -> NDArray[np.float64]:
    """Return for each source vertex by how much its distances to the samples miss those on the other surface.

    A distance on the part is an interval (see `intervals`). Vertices that the part does not cover have 0.
    """
    placement = found.placement
    rows, matches = whole.surface.rows[placement.places], found.grown.whole_of_part
    there = rows[:, matches]
    gap = np.maximum(placement.lower_rows - there, there - placement.part.rows)
    of_part = np.maximum(gap, 0.0).mean(axis=0, dtype=np.float64)
    if part_is_source:
        return np.asarray(of_part, dtype=np.float64)
    back = found.part_of_whole
    return np.where(back >= 0, of_part[np.maximum(back, 0)], 0.0)


def _alternative(
    source: Mesh,
    target: Mesh,
    other: PartMatch,
    chosen: Placement,
    whole: Whole,
    options: Options,
    *,
    part_is_source: bool,
) -> Alternative:
    return Alternative(
        **vars(file_maps(source, target, _maps(other, part_is_source=part_is_source))),
        score=other.placement.score,
        orientation=orientation_of(other.placement, options),
        distance=float(whole.bounds.upper[other.placement.places, chosen.places].mean()),
    )
