"""Maps that a match considered beside the one that it chose, and how they are kept within its result."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.errors import ResultError
from clalign.maps.point_maps import PointMaps

_SCORES = ("score", "orientation", "distance")


@dataclass(frozen=True, eq=False)
class Alternative(PointMaps):
    """A map that the search considered and that differs from the chosen one, in file numbering, -1 for no match.

    score : product of five unit-free ones, the lower the better; comparable between the maps of one match. They are the
        distortion of distances, the differences of mean curvature, Gaussian curvature and heat kernel signatures, and
        how far the functional map is from commuting with the Laplacian.
    orientation : from -1 (mirrored everywhere) to 1 (orientation kept everywhere).
    distance : mean geodesic distance on the source between the images of a target point under this map and under the
        chosen one, as the search had them, in units of sqrt(area).
    relation : in words, what it does that the chosen map does not: "mirror image: left and right are exchanged".
    """

    score: float
    orientation: float
    distance: float
    relation: str = ""


def numbered(alternatives: Sequence[Alternative], number: int) -> Alternative:
    """Return an alternative by its number, from 1 for the best.

    Raises
    ------
    ResultError
        There is none of that number.
    """
    if 1 <= number <= len(alternatives):
        return alternatives[number - 1]
    count = len(alternatives)
    kept = f"alternatives 1 to {count}" if count > 1 else ("alternative 1 alone" if count else "none")
    raise ResultError(f"there is no map {number}: the result keeps {kept} (match with --alternatives N to keep more)")


def alternative_facts(alternative: Alternative) -> dict[str, Any]:
    """Return everything but the maps as plain values."""
    scores = {name: finite_or_none(getattr(alternative, name)) for name in _SCORES}
    return scores | {"relation": alternative.relation}


def alternative_arrays(number: int, alternative: Alternative) -> Iterator[tuple[str, NDArray[np.int64]]]:
    """Yield the maps by the names under which a result keeps them; numbers count from 0 there."""
    yield f"alternatives.{number}.target_of_source", alternative.target_of_source
    yield f"alternatives.{number}.source_of_target", alternative.source_of_target


def stored_alternatives(
    facts: Sequence[Mapping[str, Any]], arrays: Mapping[str, NDArray[Any]]
) -> tuple[Alternative, ...]:
    """Return the alternatives of a stored result; one of an earlier version has no words on them."""
    return tuple(
        Alternative(
            target_of_source=arrays[f"alternatives.{number}.target_of_source"],
            source_of_target=arrays[f"alternatives.{number}.source_of_target"],
            **{name: number_of(values[name]) for name in _SCORES},
            relation=str(values.get("relation", "")),
        )
        for number, values in enumerate(facts)
    )


def finite_or_none(value: float | None) -> float | None:
    """Return None for what is not a finite number: JSON and tables have no NaN."""
    return None if value is None or not math.isfinite(value) else float(value)


def number_of(value: float | None) -> float:
    """Return the inverse of `finite_or_none`: NaN for None."""
    return math.nan if value is None else float(value)
