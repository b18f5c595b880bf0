"""What a benchmark runs: one method with its settings, called with two meshes."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from clalign.errors import OptionError
from clalign.options import Options

from .pairs import Problem

if TYPE_CHECKING:
    from clalign.correspondence import Correspondence


@dataclass(frozen=True)
class Outcome:
    """What a method found for one pair.

    target_of_source : (file vertices of X,) int64 in file numbering, -1 for none.
    seconds : of the whole method.
    stages : seconds of its parts, by name.
    confidence, orientation : as in `Correspondence`; None for methods without.
    barycentric : target faces and weights of matches inside faces, or None.
    """

    target_of_source: NDArray[np.int64]
    seconds: float
    stages: Mapping[str, float] = field(default_factory=dict)
    confidence: float | None = None
    orientation: float | None = None
    barycentric: tuple[NDArray[np.integer], NDArray[np.float64]] | None = None


class Method(Protocol):
    """A method can be sent to another process and says what its results depend on."""

    @property
    def name(self) -> str:
        """Label in tables."""

    @property
    def settings(self) -> str:
        """Short text that differs when results may differ."""

    def __call__(self, problem: Problem) -> Outcome:
        """Match the source of a pair with its target; only a method that says so looks at the truth."""


@dataclass(frozen=True)
class AlignMethod:
    """`clalign.match` with some options."""

    name: str
    options: Options = field(default_factory=Options)

    @property
    def settings(self) -> str:
        """Version of the package and a digest of the options."""
        import clalign

        return f"{clalign.__version__}-{digest(self.options.as_dict())}"

    def __call__(self, problem: Problem) -> Outcome:
        """Match one pair."""
        import clalign

        start = time.perf_counter()
        result = clalign.match(problem.source, problem.target, self.options)
        return outcome_of(result, time.perf_counter() - start)


@dataclass(frozen=True)
class IsometricMethod:
    """The study of Fig. 5 in which the shapes are made isometric: D_Y is D_X carried over by the truth."""

    name: str
    options: Options

    @property
    def settings(self) -> str:
        """Version of the package and a digest of the options."""
        import clalign

        return f"{clalign.__version__}-isometric-{digest(self.options.as_dict())}"

    def __call__(self, problem: Problem) -> Outcome:
        """Match one pair with the target's distances taken from the source."""
        from clalign.engine import open_backend
        from clalign.geometry.shape import prepare_pair
        from clalign.matching import match_shapes

        from .isometric import with_distances_of

        start = time.perf_counter()
        source, target = prepare_pair(problem.source, problem.target, self.options, None)
        carried = with_distances_of(target, source, problem.truth)
        result = match_shapes(source, carried, open_backend(self.options.engine), self.options)
        return outcome_of(result, time.perf_counter() - start)


def outcome_of(result: Correspondence, seconds: float) -> Outcome:
    """Return what a benchmark keeps of a result."""
    barycentric = None
    if result.source_faces is not None and result.source_barycentric is not None:
        barycentric = (result.source_faces, result.source_barycentric)
    return Outcome(
        target_of_source=result.target_of_source,
        seconds=seconds,
        stages=result.timings,
        confidence=result.confidence,
        orientation=result.orientation,
        barycentric=barycentric,
    )


#: Name, preset and changes of the methods that a benchmark can be asked for by name.
NAMED_OPTIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "default": ("default", {}),
    "fast": ("fast", {}),
    "cycle": ("default", {"alignment.cycle": True}),
    "heat-kernel": ("default", {"spectrum.metric": "heat-kernel"}),
    "one-sided": ("default", {"alignment.sides": "one"}),
    "search-only": ("default", {"alignment.rounds": 0, "readout.refine": "none", "readout.steps": 0}),
    "paper": ("paper", {}),
    "paper-cycle": ("paper", {"alignment.cycle": True}),
    "paper-heat-kernel": ("paper", {"spectrum.metric": "heat-kernel"}),
    "paper-one-sided": ("paper", {"alignment.sides": "one"}),
}


def named_methods(names: Sequence[str], changes: Mapping[str, Any]) -> list[Method]:
    """Return the methods of some names of `NAMED_OPTIONS`, or "pyfm"; `changes` to options apply to all of ours.

    Raises
    ------
    OptionError
        No such method or option.
    """
    from .peers import PyfmMethod

    methods: list[Method] = []
    for name in names:
        if name == "pyfm":
            methods.append(PyfmMethod())
        elif name == "paper-isometric":
            methods.append(IsometricMethod(name, Options.preset("paper").replace(changes)))
        elif name in NAMED_OPTIONS:
            preset, own = NAMED_OPTIONS[name]
            methods.append(AlignMethod(name, Options.preset(preset).replace({**own, **changes})))
        else:
            raise OptionError(f"unknown method {name!r}; there are {', '.join(NAMED_OPTIONS)}, paper-isometric, pyfm")
    return methods


def digest(values: Mapping[str, Any]) -> str:
    """Return eight letters that tell settings apart."""
    text = json.dumps(values, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:8]
