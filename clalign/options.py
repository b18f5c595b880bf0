"""Every number that a user may change, in frozen groups checked on construction.

`Options()` is the default preset; `Options.preset("paper")` is the method as printed. A single value is
changed with `options.replace({"alignment.weight": 50})`, which is what the command line's ``--set`` calls.
"""

from __future__ import annotations

import dataclasses
import math
import operator
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args, get_origin

from clalign.errors import OptionError
from clalign.option_values import flattened, leaves, replaced, translated, type_hints
from clalign.presets import PRESETS
from clalign.rules import Rules

Metric = Literal["euclidean", "regularized", "power", "heat-kernel", "auto"]
Laplacian = Literal["cotangent", "intrinsic"]
Weights = Literal["area", "uniform"]
Band = Literal["half", "full", "diagonal", "none"]
Orientation = Literal["preserving", "reversing", "any"]
Readout = Literal["aligned", "argmax"]

SEARCHED_WITH = 3
"""Laplace–Beltrami eigenfunctions without which there is no search."""


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise OptionError(message)


def _finite(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def _positive(group: str, options: Any, *names: str) -> None:
    for name in names:
        value = getattr(options, name)
        _require(value > 0 and _finite(value), f"{group}.{name} must be a positive number, got {value!r}")


def _not_negative(group: str, options: Any, *names: str) -> None:
    for name in names:
        value = getattr(options, name)
        _require(value >= 0 and _finite(value), f"{group}.{name} must not be negative, got {value!r}")


MAY_BE_EMPTY = ("rules.search.oriented.strengths", "rules.search.plain.strengths", "rules.search.unfold_sizes")


def _check_rule(name: str, value: Any) -> None:
    """Refuse numbers that no rule can have: only an orientation may be negative, and only some lists empty."""
    if dataclasses.is_dataclass(value):
        for inner in dataclasses.fields(value):
            _check_rule(f"{name}.{inner.name}", getattr(value, inner.name))
        _check_choices(name, value)
    elif isinstance(value, tuple):
        _require(bool(value) or name in MAY_BE_EMPTY, f"{name} must not be empty")
        for each in value:
            _check_rule(name, each)
    elif isinstance(value, int | float):
        least = -1 if name.endswith("orientation") else 1 if name.endswith((".step", ".start")) else 0
        _require(value >= least and _finite(value), f"{name} must be at least {least}, got {value!r}")


def _check_choices(group: str, options: Any) -> None:
    for name, hint in type_hints(type(options)).items():
        if get_origin(hint) is Literal:
            allowed = get_args(hint)
            value = getattr(options, name)
            _require(value in allowed, f"{group}.{name} must be one of {', '.join(allowed)}; got {value!r}")


@dataclass(frozen=True)
class SurfaceOptions:
    """How a mesh is read as a surface.

    strict : refuse a mesh that is no surface as it stands (edges with three faces, sheets that touch in a point, open
        seams, several pieces); otherwise it is read as the surface that was most likely meant, with a note.
    component : the piece that is matched of a file with several, from 1 for the largest; 0 for the one that stands out.
    """

    strict: bool = False
    component: int = 0

    def __post_init__(self) -> None:
        _not_negative("surface", self, "component")


@dataclass(frozen=True)
class SpectrumOptions:
    """Eigenfunctions of both Laplace–Beltrami operators.

    basis : number k of LBO eigenfunctions in the functional map C.
    refinement : number of LBO eigenfunctions computed in all, for ZoomOut (at least `basis`). A search
        needs three.
    scale_invariant : number d of scale-invariant eigenfunctions that R aligns.
    metric : conformal factor of the scale-invariant operator: "power" |K|^xi (Eq. 29), "regularized"
        sqrt(K² + epsilon²) (Eq. 7), "euclidean" 1 (Eq. 3), "heat-kernel", or "auto" (xi chosen per pair).
    xi : exponent of "power", in (0, 1].
    smoothing : diffusion time of K before "power" and "regularized" take it, in units of the surface's area, at least
        0, for pairs of which a mesh is noisy; 0 takes it as it is, as the paper does.
    noisy_below : a mesh is noisy whose angle defects correlate less than this between neighbours, in [0, 1]; 1
        smooths every mesh. Sampled surfaces without noise are above 0.3; one whose flat faces were split is near 0.
    clamp : |K| is clamped to its [clamp, 1 - clamp] quantiles before the power, in [0, 0.5).
    epsilon : constant of "regularized", in units of 1/area.
    laplacian : "cotangent" on the triangles as they are, or "intrinsic" on the intrinsic Delaunay triangulation of the
        same surface, which bears needles and obtuse triangles better (Sharp & Crane 2020). Angle defects and triple
        products are those of the triangles as they are with either.
    """

    basis: int = 120
    refinement: int = 200
    scale_invariant: int = 352
    metric: Metric = "power"
    xi: float = 0.5
    smoothing: float = 0.0005
    noisy_below: float = 0.3
    clamp: float = 0.02
    epsilon: float = 1.0
    laplacian: Laplacian = "cotangent"

    def __post_init__(self) -> None:
        _check_choices("spectrum", self)
        _positive("spectrum", self, "basis", "scale_invariant", "epsilon", "refinement")
        _not_negative("spectrum", self, "smoothing")
        _require(0 <= self.noisy_below <= 1, f"spectrum.noisy_below must lie in [0, 1], got {self.noisy_below!r}")
        _require(0 < self.xi <= 1, f"spectrum.xi must lie in (0, 1], got {self.xi!r}")
        _require(0 <= self.clamp < 0.5, f"spectrum.clamp must lie in [0, 0.5), got {self.clamp!r}")


@dataclass(frozen=True)
class GeodesicOptions:
    """Geodesic distances.

    factor_samples : N, the farthest-point samples whose rows give the low-rank factors of D (rank N / 2).
    search_samples : farthest-point samples whose mutual distances score the candidates of the search.
    """

    factor_samples: int = 100
    search_samples: int = 1000

    def __post_init__(self) -> None:
        for name in ("factor_samples", "search_samples"):
            value = getattr(self, name)
            _require(value >= 2 and _finite(value), f"geodesics.{name} must be at least 2, got {value!r}")


@dataclass(frozen=True)
class SearchOptions:
    """Search for the isometry that the alignment starts from.

    method : "tree" (oriented unfolding and branching) or "random" (R starts as a random ±1 diagonal, as the paper does;
        no search).
    orientation : "preserving" rejects mirrored maps, "reversing" keeps only those, "any" takes the better.
    alternatives : how many of the best different maps are kept in the result beside the chosen one.
    """

    method: Literal["tree", "random"] = "tree"
    orientation: Orientation = "preserving"
    alternatives: int = 0

    def __post_init__(self) -> None:
        _check_choices("search", self)
        _not_negative("search", self, "alternatives")


@dataclass(frozen=True)
class AlignmentOptions:
    """The optimisation of R.

    weight : lambda of Eq. 24, the weight of l_unsup beside l_align.
    band_slope, band_offset : a and b of the funnel W_i = ceil(i / a) + b (Eq. 25).
    band : the funnel read as "half" width (|i - j| <= W_i), "full" width, "diagonal" only, or "none" (dense R).
    sides : "both" aligns with R and R^T (Eq. 20), "one" with a single C~ on the source (Eq. 18).
    cycle : add the cycle term (Eq. 32).
    unitarity : weight of l_uni (Eq. 23) as a penalty; 0 only reports it, as the paper does. A little keeps the scale of
        R, which a differentiated denominator leaves free, at no cost in accuracy.
    denominator : "fixed" as in the paper, which pays for a smaller R, or "differentiated", which does not.
    weights : "area" or the paper's "uniform" weights in the soft map and the losses.
    samples : farthest-point samples of the source on which the losses are evaluated (0: all vertices). All vertices are
        taken too, whatever the number, where the geodesic samples (`geodesics.search_samples`) are all vertices.
    outer_iterations, iterations : at most so many times the correspondence is fixed anew, each followed by at most so
        many L-BFGS evaluations.
    decay : λ is multiplied by this after every outer iteration.
    tolerance : an outer iteration ends when a step lowers the objective by less, relatively.
    """

    weight: float = 200.0
    band_slope: float = 2.5
    band_offset: int = 2
    band: Band = "half"
    sides: Literal["both", "one"] = "both"
    cycle: bool = False
    unitarity: float = 30.0
    denominator: Literal["fixed", "differentiated"] = "differentiated"
    weights: Weights = "area"
    samples: int = 1000
    outer_iterations: int = 3
    iterations: int = 12
    decay: float = 0.2
    tolerance: float = 1e-5

    def __post_init__(self) -> None:
        _check_choices("alignment", self)
        _positive("alignment", self, "band_slope", "decay", "tolerance")
        _not_negative(
            "alignment", self, "weight", "band_offset", "unitarity", "samples", "outer_iterations", "iterations"
        )


@dataclass(frozen=True)
class ReadoutOptions:
    """From aligned eigenfunctions to vertices.

    readout : "aligned" (nearest neighbour among aligned eigenfunctions) or "argmax" (Eq. 28).
    refine : between search and alignment: ZoomOut by several schedules, of which every patch of the surface takes the
        best ("patches"), the best one as a whole ("zoomout"), or "none".
    steps : two-way steps in the scale-invariant basis after the alignment, and before it unless `refine` is "patches".
    joint : after these, if there are any, one step more in the Laplace–Beltrami and the scale-invariant basis jointly.
    subvertex : also give every match as a point in a face.
    """

    readout: Readout = "aligned"
    refine: Literal["none", "zoomout", "patches"] = "patches"
    steps: int = 2
    joint: bool = False
    subvertex: bool = False

    def __post_init__(self) -> None:
        _check_choices("readout", self)
        _not_negative("readout", self, "steps")


@dataclass(frozen=True)
class PartialOptions:
    """Matching a part with a whole.

    part : which mesh is a part of the other: "source", "target", "none", or "auto", by boundaries, areas, and whether
        one is found on the other.
    scale : "same", the files have one unit of length, or "auto", which tries that first and then other factors.
    """

    part: Literal["auto", "none", "source", "target"] = "auto"
    scale: Literal["auto", "same"] = "auto"

    def __post_init__(self) -> None:
        _check_choices("partial", self)


@dataclass(frozen=True)
class EngineOptions:
    """Where the arithmetic runs.

    backend : "opencl" or "reference" (numpy, float64).
    device : device specification such as "cpu", "gpu", "0:1" or part of a name; empty picks one.
    precision : "single" or "double" (where the device has it).
    memory : bytes that the process may use at most (0: what the machine has).
    device_class : kernels written for a "cpu" or for a "gpu"; "auto" takes those that suit the device. The others
        compute the same, slowly: they are a check.
    """

    backend: Literal["opencl", "reference"] = "opencl"
    device: str = ""
    precision: Literal["single", "double"] = "single"
    memory: int = 0
    device_class: Literal["auto", "cpu", "gpu"] = "auto"

    def __post_init__(self) -> None:
        _check_choices("engine", self)
        _not_negative("engine", self, "memory")


@dataclass(frozen=True)
class Options:
    """All groups together. See each group for its values; `seed` fixes everything that is drawn.

    rules : numbers inside the method that no user needs to know; see `clalign.rules`.
    """

    surface: SurfaceOptions = field(default_factory=SurfaceOptions)
    spectrum: SpectrumOptions = field(default_factory=SpectrumOptions)
    geodesics: GeodesicOptions = field(default_factory=GeodesicOptions)
    search: SearchOptions = field(default_factory=SearchOptions)
    alignment: AlignmentOptions = field(default_factory=AlignmentOptions)
    readout: ReadoutOptions = field(default_factory=ReadoutOptions)
    partial: PartialOptions = field(default_factory=PartialOptions)
    engine: EngineOptions = field(default_factory=EngineOptions)
    rules: Rules = field(default_factory=Rules)
    seed: int = 0

    def __post_init__(self) -> None:
        _require(self.seed >= 0, f"seed must not be negative, got {self.seed!r}")
        computed = max(self.spectrum.basis, self.spectrum.refinement)
        _require(
            self.search.method == "random" or computed >= SEARCHED_WITH,
            f"spectrum.basis or spectrum.refinement must be at least {SEARCHED_WITH} for a search, got {computed}: the "
            "orientation of a map is told by two eigenfunctions beside the constant one (search.method=random makes no "
            "search)",
        )
        for name, _ in leaves(self.rules, "rules."):
            _check_rule(name, operator.attrgetter(name)(self))

    @staticmethod
    def preset(name: str) -> Options:
        """Return the options of a preset: "default", "paper" or "fast".

        Raises
        ------
        OptionError
            No such preset.
        """
        if name not in PRESETS:
            raise OptionError(f"unknown preset {name!r}; there are {', '.join(PRESETS)}")
        return Options().replace(PRESETS[name])

    def replace(self, changes: Mapping[str, Any]) -> Options:
        """Return a copy with some values changed.

        Parameters
        ----------
        changes : mapping from "group.name" ("rules.group.name", "seed") to a value; text is converted to the value's
            type. Names of the release before are translated, with a warning.

        Raises
        ------
        OptionError
            Unknown name, or a value that cannot be converted or lies outside its range.
        """
        return replaced(self, translated(changes, warn=True))

    def as_dict(self) -> dict[str, Any]:
        """Return nested plain values, as written to ``result.json``."""
        return dataclasses.asdict(self)

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> Options:
        """Inverse of `as_dict`; unknown names raise `OptionError`, those of the release before are translated."""
        return replaced(Options(), translated(flattened(values), warn=False))


def odd_sizes(options: Options, vertices: int) -> list[str]:
    """Return what a user should know of sizes that cannot be had as they were given; `vertices` of the smaller mesh."""
    spectrum, said = options.spectrum, []
    if spectrum.refinement < spectrum.basis:
        said.append(
            f"spectrum.refinement={spectrum.refinement} is less than spectrum.basis={spectrum.basis}; "
            f"{spectrum.basis} eigenfunctions are computed"
        )
    if spectrum.basis > vertices:
        said.append(
            f"spectrum.basis={spectrum.basis} is more than the {vertices} vertices of the smaller mesh; at most a "
            "third as many eigenfunctions as vertices are used"
        )
    return said


def given_options(options: Any) -> Options:
    """Return the options of a call, the default ones for None.

    Raises
    ------
    OptionError
        It is something else, such as the name of a preset; the message says how to call.
    """
    if options is None:
        return Options()
    if isinstance(options, Options):
        return options
    call = "Options().replace({'seed': 1})"
    if isinstance(options, str):
        call = f"Options.preset({options!r})" if options in PRESETS else f"Options.preset({'fast'!r})"
    elif isinstance(options, Mapping):
        call = f"Options().replace({dict(options)!r})"
    raise OptionError(f"options must be an Options, not {type(options).__name__}; pass {call}")
