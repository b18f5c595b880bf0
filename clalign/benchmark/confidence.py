"""How far a confidence can be trusted: the share of right maps against it, over pairs of every kind at hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clalign.benchmark.damaged import damaged
from clalign.benchmark.generated import mesh_on_sphere, points_on_sphere
from clalign.benchmark.layouts import Layout, animals, humans
from clalign.benchmark.pairs import LoadedPair
from clalign.benchmark.records import Record
from clalign.benchmark.table import markdown_table
from clalign.benchmark.warped import warped
from clalign.evaluation.truth import Truth

SYMMETRIC = "symmetric"
RIGHT = 0.2
"""A map is right if nine of ten points lie within this distance of the truth, in sqrt(area): no limb is elsewhere."""
EDGES = (0.0, 0.15, 0.3, 0.5, 0.7, 0.9, 1.0)
DOUBTED, TRUSTED = 0.15, 0.5
"""A wrong or ambiguous pair should be below the first, a right one above the second."""
WARPED = ("waves", "limbs", "ape")
DAMAGED = ("holes", "uneven")
VERTICES = 2500


@dataclass(frozen=True)
class SymmetricPair:
    """A body that some turns carry to itself, meshed twice: no one can say which of its right maps is meant.

    body : one of `BODIES`.
    exact : the target has the triangles of the source, renumbered.
    """

    body: str
    exact: bool

    @property
    def name(self) -> str:
        """Name of the pair."""
        return f"{self.body} {'exact' if self.exact else 'remeshed'}"

    def load(self) -> LoadedPair:
        """Make both meshes; the truth is one of several."""
        source = points_on_sphere(VERTICES, seed=1)
        order = np.random.default_rng(3).permutation(VERTICES)
        target = source[order] if self.exact else points_on_sphere(VERTICES, seed=2)
        nearest = np.argmax(source @ target.T, axis=1).astype(np.int64)
        truth = Truth(np.arange(VERTICES), nearest)
        one, other = (mesh_on_sphere(each, BODIES[self.body](each), self.body) for each in (source, target))
        return LoadedPair(self.name, one, other, truth, None)


def _ellipsoid(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    return directions * [1.0, 0.7, 0.45]


def _propeller(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Three equal blades around an axis, and ends of that axis that differ."""
    angle = np.arctan2(directions[:, 1], directions[:, 0])
    blades = 0.8 * (1.0 - directions[:, 2] ** 2) ** 4 * np.exp(4.0 * (np.cos(3.0 * angle - directions[:, 2]) - 1.0))
    return directions * (1.0 + blades)[:, None] * [0.8, 0.8, 1.0] + [0.0, 0.0, 0.3] * directions[:, 2:] ** 2


#: Bodies with rotations to themselves.
BODIES = {"ellipsoid": _ellipsoid, "propeller": _propeller}


def confidence_layouts(people: str | Path, beasts: str | Path | None) -> tuple[Layout, ...]:
    """Return the suites that a confidence is judged on.

    People as they are, warped and damaged, animals if there is a folder of them, and bodies with symmetries.
    """
    bodies = tuple(SymmetricPair(name, exact) for name in BODIES for exact in (True, False))
    return (
        *humans(people),
        *(animals(beasts) if beasts is not None else ()),
        *warped(people, WARPED),
        *damaged(people, DAMAGED),
        Layout(SYMMETRIC, bodies, ()),
    )


def right(record: Record) -> bool:
    """Return whether the map of a record is the right one."""
    return record.q90 is not None and record.q90 <= RIGHT and not record.flipped


def confidence_table(records: Sequence[Record]) -> str:
    """Return a Markdown table of the pairs by their confidence: how many are right, wrong, or have no single answer."""
    known = [each for each in records if not each.failed and each.confidence is not None]
    rows = []
    for low, high in pairwise(EDGES):
        inside = [each for each in known if low <= _confidence(each) < high or (high == EDGES[-1] == _confidence(each))]
        answered = [each for each in inside if each.suite != SYMMETRIC]
        good = sum(map(right, answered))
        share = f"{good / len(answered):.0%}" if answered else "–"
        counts = (len(inside), good, len(answered) - good, len(inside) - len(answered))
        rows.append([f"{low:g} to {high:g}", *map(str, counts), share])
    return markdown_table(("confidence", "pairs", "right", "wrong", "ambiguous", "share right"), rows)


def verdicts(records: Sequence[Record]) -> list[str]:
    """Return one sentence on right pairs, and one for every wrong or ambiguous pair that is not doubted."""
    known = [each for each in records if not each.failed and each.confidence is not None]
    good = [each for each in known if each.suite != SYMMETRIC and right(each)]
    trusted = sum(_confidence(each) > TRUSTED for each in good)
    said = [f"{trusted} of {len(good)} right pairs have a confidence above {TRUSTED:g}"]
    for each in known:
        if each not in good and _confidence(each) >= DOUBTED:
            kind = "ambiguous" if each.suite == SYMMETRIC else "wrong"
            said.append(
                f"{each.suite}, {each.pair}: {kind} with confidence {_confidence(each):.2f} and orientation "
                f"{each.orientation or 0.0:+.2f}"
            )
    return said


def _confidence(record: Record) -> float:
    return record.confidence if record.confidence is not None else 0.0
