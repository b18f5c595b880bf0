"""What a match has reached: a frozen state that every stage takes and gives back with more in it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from clalign.alignment.alternation import AlignedRotation, AlignmentState
from clalign.alignment.band import funnel_band
from clalign.alignment.objective import Objective
from clalign.alignment.rotation import StartingRotation
from clalign.engine.band import Band
from clalign.geometry.shape import Shape
from clalign.geometry.spectra import Spectrum
from clalign.maps.point_maps import PointMaps
from clalign.mesh.landmarks import Landmarks
from clalign.options import Options
from clalign.refinement.precise import SurfacePoints
from clalign.search.find import SearchResult

Value = TypeVar("Value")


def required(value: Value | None) -> Value:
    """Return what an earlier stage has left in the state.

    Raises
    ------
    RuntimeError
        That stage was not run.
    """
    if value is None:
        raise RuntimeError("a stage of a match was run before the one whose outcome it needs")
    return value


def aligned_count(source: Shape, target: Shape, options: Options) -> int:
    """Return d, the number of scale-invariant eigenfunctions that R aligns."""
    return min(options.spectrum.scale_invariant, source.scale_invariant.count, target.scale_invariant.count)


@dataclass(frozen=True)
class MatchState:
    """How far a pair has come, in the compact vertex order of the meshes.

    Attributes
    ----------
    source, target : prepared with the same options.
    options : of what is left to do.
    xi : exponent of the metric: that of the options, or the one chosen for this pair with the metric "auto".
    metric_chosen : ξ was chosen.
    found : the search's result; None before it, and with the paper's random start.
    start_map : (n_x,) matches to start from instead of a search, -1 where unknown; or None.
    landmarks : pairs of vertices that a user knows, or None.
    landmarks_used : the chosen map was chosen by them.
    rivals_grown : the chosen map was chosen anew, among candidates that were grown.
    anchored : it was decided whether distances to anchors stand beside the eigenfunctions.
    maps : the best maps so far.
    alternatives : maps of the best different candidates.
    start : R before the optimisation, and the signs that were absorbed.
    objective : the pair bound to a backend.
    alignment : R between two outer iterations.
    aligned : R after the optimisation.
    functional_map : (k, k) C of R (Eq. 11, 26).
    steps : two-way steps of the read-out that have been made.
    joined : the step in both bases has been made.
    points : of the target, for every source vertex; None without the precise read-out.
    interrupted : Ctrl-C cut short what was left.
    """

    source: Shape
    target: Shape
    options: Options
    xi: float
    metric_chosen: bool = False
    found: SearchResult | None = None
    start_map: NDArray[np.int64] | None = None
    landmarks: Landmarks | None = None
    landmarks_used: bool = False
    rivals_grown: bool = False
    anchored: bool = False
    maps: PointMaps | None = None
    alternatives: tuple[PointMaps, ...] = ()
    start: StartingRotation | None = None
    objective: Objective | None = None
    alignment: AlignmentState | None = None
    aligned: AlignedRotation | None = None
    functional_map: NDArray[np.float64] | None = None
    steps: int = 0
    joined: bool = False
    points: SurfacePoints | None = None
    interrupted: bool = False

    @property
    def worth_keeping(self) -> bool:
        """Whether there is a map to keep when the rest is given up."""
        return self.found is not None or self.alignment is not None

    @property
    def count(self) -> int:
        """Number d of scale-invariant eigenfunctions that R aligns."""
        return aligned_count(self.source, self.target, self.options)

    @property
    def band(self) -> Band:
        """The funnel of R."""
        return funnel_band(self.count, self.options.alignment)

    def scale_invariant(self, signs: NDArray[np.float64] | None = None) -> tuple[Spectrum, Spectrum]:
        """Return the d eigenfunctions of both shapes, with signs absorbed into the source's."""
        return self.source.scale_invariant.head(self.count, signs), self.target.scale_invariant.head(self.count)

    def cut_short(self) -> MatchState:
        """Return the state with options that leave out every step which has not been made yet."""
        changes: dict[str, object] = {
            "readout.refine": "none",
            "readout.steps": 0,
            "alignment.outer_iterations": 0,
            "search.alternatives": 0,
        }
        if self.options.spectrum.metric == "auto":
            changes["spectrum.metric"] = "power"
        return replace(self, options=self.options.replace(changes), interrupted=True)


def wanted_sign(state: MatchState) -> float:
    """Return the sign of the orientation that a match is to have; see `orientation_sign`."""
    return orientation_sign(state.options)


def orientation_sign(options: Options) -> float:
    """Return +1 where the orientation is to be kept, −1 where it is to be reversed, 0 where it is free."""
    return {"preserving": 1.0, "reversing": -1.0, "any": 0.0}[options.search.orientation]
