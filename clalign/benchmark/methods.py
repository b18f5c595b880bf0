"""What a benchmark runs: one method with its settings, called with two meshes."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from clalign.errors import OptionError, ResultError
from clalign.evaluation.pairs import Problem
from clalign.options import Options

if TYPE_CHECKING:
    from clalign.correspondence import Correspondence
    from clalign.geometry.cache import ShapeCache

Progress = Callable[[str, float, str], None]


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
    """`clalign.match` with some options.

    Shapes come from the cache once they were prepared, so the seconds of a pair depend on what ran before;
    `clalign bench pair` measures cold and warm.
    """

    name: str
    options: Options = field(default_factory=Options)

    @property
    def settings(self) -> str:
        """Version of the package and a digest of the options."""
        import clalign

        return f"{clalign.__version__}-{digest(self.options.as_dict())}"

    def correspondence(
        self, problem: Problem, cache: ShapeCache | None = None, progress: Progress | None = None
    ) -> Correspondence:
        """Return the whole result of one pair."""
        import clalign

        return clalign.match(problem.source, problem.target, self.options, cache=cache, progress=progress)

    def __call__(self, problem: Problem) -> Outcome:
        """Match one pair."""
        from clalign.geometry.cache import ShapeCache

        start = time.perf_counter()
        result = self.correspondence(problem, ShapeCache())
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

    def correspondence(
        self, problem: Problem, cache: ShapeCache | None = None, progress: Progress | None = None
    ) -> Correspondence:
        """Return the whole result of one pair, matched with the target's distances taken from the source."""
        from clalign.engine import open_backend
        from clalign.evaluation.isometric import with_distances_of
        from clalign.geometry.shape import prepare_pair
        from clalign.matching.pair import match_shapes
        from clalign.matching.stages import Clock

        source, target = prepare_pair(problem.source, problem.target, self.options, cache)
        carried = with_distances_of(target, source, problem.truth)
        return match_shapes(source, carried, open_backend(self.options.engine), self.options, Clock(progress))

    def __call__(self, problem: Problem) -> Outcome:
        """Match one pair."""
        from clalign.geometry.cache import ShapeCache

        start = time.perf_counter()
        result = self.correspondence(problem, ShapeCache())
        return outcome_of(result, time.perf_counter() - start)


@dataclass(frozen=True)
class SignedMethod:
    """The paper's start, as it goes when the eigensolver happens to give the signs of the mirror image.

    A solver gives eigenfunctions any signs, and a diagonal start of R cannot change them: both sides of a column get
    the same sign. With the signs that the mirrored truth asks for, the paper's start is that of the mirror image.
    """

    name: str
    options: Options

    @property
    def settings(self) -> str:
        """Version of the package and a digest of the options."""
        import clalign

        return f"{clalign.__version__}-signs-{digest(self.options.as_dict())}"

    def correspondence(
        self, problem: Problem, cache: ShapeCache | None = None, progress: Progress | None = None
    ) -> Correspondence:
        """Return the whole result of one pair.

        Raises
        ------
        ResultError
            The mirror image of the truth is not known.
        """
        from clalign.engine import open_backend
        from clalign.evaluation.isometric import total_maps
        from clalign.evaluation.spectral import true_rotation
        from clalign.geometry.shape import prepare_pair
        from clalign.matching.pair import match_shapes
        from clalign.matching.stages import Clock

        if problem.mirrored is None:
            raise ResultError(f"{problem.name}: {self.name} needs the mirror image of the truth")
        source, target = prepare_pair(problem.source, problem.target, self.options, cache)
        source_of_target, _ = total_maps(problem.source, problem.target, problem.mirrored)
        count = min(source.descriptors.count, target.descriptors.count)
        mirrored = true_rotation(source.descriptors.functions[:, :count], target.descriptors, source_of_target)
        signs = np.where(np.diagonal(mirrored) < 0, -1.0, 1.0)
        source = replace(source, descriptors=source.descriptors.head(count, signs))
        return match_shapes(source, target, open_backend(self.options.engine), self.options, Clock(progress))

    def __call__(self, problem: Problem) -> Outcome:
        """Match one pair."""
        from clalign.geometry.cache import ShapeCache

        start = time.perf_counter()
        result = self.correspondence(problem, ShapeCache())
        return outcome_of(result, time.perf_counter() - start)


def uninterrupted(result: Correspondence) -> Correspondence:
    """Return a result, or raise KeyboardInterrupt if Ctrl-C cut it short: what is measured must be whole."""
    if result.interrupted:
        raise KeyboardInterrupt
    return result


def outcome_of(result: Correspondence, seconds: float) -> Outcome:
    """Return what a benchmark keeps of a result."""
    from clalign.correspondence import finite_or_none

    result = uninterrupted(result)
    barycentric = None
    if result.source_faces is not None and result.source_barycentric is not None:
        barycentric = (result.source_faces, result.source_barycentric)
    return Outcome(
        target_of_source=result.target_of_source,
        seconds=seconds,
        stages=result.timings,
        confidence=finite_or_none(result.confidence),
        orientation=finite_or_none(result.orientation),
        barycentric=barycentric,
    )


#: Name, preset and changes of the methods that a benchmark can be asked for by name.
NAMED_OPTIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "default": ("default", {}),
    "fast": ("fast", {}),
    "cycle": ("default", {"alignment.cycle": True}),
    "one-sided": ("default", {"alignment.sides": "one"}),
    "unitarity": ("default", {"alignment.unitarity": 100.0}),
    "frozen": ("default", {"alignment.denominator": "frozen"}),
    "uniform": ("default", {"alignment.weights": "uniform"}),
    "full-band": ("default", {"alignment.band": "full"}),
    "diagonal-band": ("default", {"alignment.band": "diagonal"}),
    "no-band": ("default", {"alignment.band": "none"}),
    "euclidean": ("default", {"spectrum.metric": "euclidean"}),
    "regularized": ("default", {"spectrum.metric": "regularized"}),
    "heat-kernel": ("default", {"spectrum.metric": "heat-kernel"}),
    "search-only": ("default", {"alignment.rounds": 0, "readout.refine": "none", "readout.steps": 0}),
    "up-sampled": ("default", {"alignment.rounds": 0, "readout.refine": "upsample", "readout.steps": 0}),
    "pieces": ("default", {"alignment.rounds": 0, "readout.steps": 0}),
    "aligned": ("default", {"readout.steps": 0}),
    "closed-form": ("default", {"alignment.rounds": 0}),
    "auto-metric": ("default", {"spectrum.metric": "auto"}),
    "mirrored": ("default", {"search.orientation": "reversing"}),
    "paper": ("paper", {}),
    "paper-searched": ("paper", {"search.method": "tree"}),
    "paper-cycle": ("paper", {"alignment.cycle": True}),
    "paper-heat-kernel": ("paper", {"spectrum.metric": "heat-kernel"}),
    "paper-one-sided": ("paper", {"alignment.sides": "one"}),
}

#: Methods whose target has the source's distances, by the preset of their other options.
ISOMETRIC_PRESETS = {"isometric": "default", "paper-isometric": "paper"}

#: The paper's start with the signs of the mirror image.
PAPER_MIRRORED = "paper-mirrored"


def own_method(name: str, changes: Mapping[str, Any]) -> AlignMethod | IsometricMethod | SignedMethod:
    """Return a variant of our own method by its name among `method_names`.

    Raises
    ------
    OptionError
        No such method or option.
    """
    if name in ISOMETRIC_PRESETS:
        return IsometricMethod(name, Options.preset(ISOMETRIC_PRESETS[name]).replace(changes))
    if name == PAPER_MIRRORED:
        return SignedMethod(name, Options.preset("paper").replace(changes))
    if name in NAMED_OPTIONS:
        preset, own = NAMED_OPTIONS[name]
        return AlignMethod(name, Options.preset(preset).replace({**own, **changes}))
    raise OptionError(f"unknown method {name!r}; there are {', '.join(method_names())}")


def named_methods(names: Sequence[str], changes: Mapping[str, Any]) -> list[Method]:
    """Return the methods of some `method_names`; `changes` to options apply to all of ours.

    Raises
    ------
    OptionError
        No such method or option.
    """
    from clalign.benchmark.peers import PyfmMethod

    return [PyfmMethod() if name == "pyfm" else own_method(name, changes) for name in names]


def method_names() -> tuple[str, ...]:
    """Return every name that a benchmark can be asked for."""
    return (*NAMED_OPTIONS, *ISOMETRIC_PRESETS, PAPER_MIRRORED, "pyfm")


def digest(values: Mapping[str, Any]) -> str:
    """Return eight letters that tell settings apart."""
    text = json.dumps(values, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:8]
