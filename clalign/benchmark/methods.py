"""What a benchmark runs: a method with its settings, called with a pair of meshes.

A method is written ``[NAME=]BASE[+OPTION=VALUE ...]``: what tables call it (the text itself where no name is given), a
short name of `NAMED`, and the options that differ from it. ``+truth=isometric`` and ``+truth=signs`` are no options:
they say what `AlignMethod` takes from the truth.
"""

from __future__ import annotations

import hashlib
import json
import re
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, Protocol, get_args

from clalign.errors import ClalignWarning, OptionError, ResultError
from clalign.options import Options

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from clalign.benchmark.pairs import LoadedPair
    from clalign.correspondence import Correspondence
    from clalign.geometry.cache import ShapeCache
    from clalign.geometry.shape import Shape
    from clalign.matching.loop import Progress

    Watch = Callable[[str], Progress]

MethodRuns = Callable[[str], "Correspondence"]
FromTruth = Literal["", "isometric", "signs"]

#: The methods with a short name: what it stands for, beginning with a preset, and the label in figures.
NAMED: dict[str, tuple[str, str]] = {
    "default": ("default", "this program"),
    "fast": ("fast", "preset fast"),
    "cycle": ("default+alignment.cycle=true", "with the cycle term"),
    "one-sided": ("default+alignment.sides=one", "one side only"),
    "heat-kernel": ("default+spectrum.metric=heat-kernel", "heat-kernel metric"),
    "auto-metric": ("default+spectrum.metric=auto", "ξ chosen for the pair"),
    "search-only": ("default+alignment.outer_iterations=0+readout.refine=none+readout.steps=0", "search only"),
    "zoomout": (
        "default+alignment.outer_iterations=0+readout.refine=zoomout+readout.steps=0",
        "by ZoomOut as a whole",
    ),
    "patches": ("default+alignment.outer_iterations=0+readout.steps=0", "patch by patch"),
    "aligned": ("default+readout.steps=0", "no steps after the alignment"),
    "closed-form": ("default+alignment.outer_iterations=0", "least-squares start of R"),
    "mirrored": ("default+search.orientation=reversing", "from the mirror image"),
    "isometric": ("default+truth=isometric", "isometry enforced"),
    "paper": ("paper", "as printed (Eq. 24)"),
    "paper-searched": ("paper+search.method=tree", "as printed, from the search"),
    "paper-cycle": ("paper+alignment.cycle=true", "as printed, with the cycle term (Eq. 32)"),
    "paper-heat-kernel": ("paper+spectrum.metric=heat-kernel", "as printed, heat-kernel metric"),
    "paper-isometric": ("paper+truth=isometric", "as printed, isometry enforced"),
    "paper-mirrored": ("paper+truth=signs", "as printed, other signs"),
    "pyfm": ("pyfm", "pyFM"),
}

_BEFORE_CHANGE = re.compile(r"\+(?=[\w.]+=)")
_COMMA = re.compile(r",(?![^(\[]*[)\]])")


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

    def __call__(self, pair: LoadedPair) -> Outcome:
        """Match the source of a pair with its target; only a method that says so looks at the truth."""


@dataclass(frozen=True)
class AlignMethod:
    """`clalign.match` with some options.

    Shapes come from the cache once they were prepared, so the seconds of a pair depend on what ran before;
    `clalign bench pair` measures cold and warm.

    truth : what is taken from it. "isometric", the study of Fig. 5 in which the shapes are made isometric: D_Y is D_X
        carried over by the truth. "signs", the paper's start as it goes when the eigensolver happens to give the signs
        of the mirror image: a solver gives eigenfunctions any signs, and a diagonal start of R cannot change them, as
        both sides of a column get the same sign.
    """

    name: str
    options: Options = field(default_factory=Options)
    truth: FromTruth = ""

    @property
    def settings(self) -> str:
        """Version of the package and a digest of the options."""
        import clalign

        return "-".join(part for part in (clalign.__version__, self.truth, digest(self.options.as_dict())) if part)

    def correspondence(
        self, pair: LoadedPair, cache: ShapeCache | None = None, progress: Progress | None = None
    ) -> Correspondence:
        """Return the whole result of one pair.

        Raises
        ------
        ResultError
            The truth that is needed is not known.
        """
        import clalign

        if not self.truth:
            return clalign.match(pair.source, pair.target, self.options, cache=cache, progress=progress)
        from clalign.engine import open_backend
        from clalign.evaluation.distances import with_distances_of
        from clalign.evaluation.truth import true_maps
        from clalign.geometry.shape import prepare_pair
        from clalign.matching.loop import Clock
        from clalign.matching.pair import match_shapes

        source, target = prepare_pair(pair.source, pair.target, self.options, cache)
        if self.truth == "isometric":
            target = with_distances_of(target, source, pair.truth)
        elif pair.mirrored is None:
            raise ResultError(f"{pair.name}: {self.name} needs the mirror image of the truth")
        else:
            maps = true_maps(pair.source, pair.target, pair.mirrored)
            source = _with_signs_of(source, target, maps.source_of_target)
        return match_shapes(source, target, open_backend(self.options.engine), self.options, Clock(progress))

    def __call__(self, pair: LoadedPair) -> Outcome:
        """Match one pair."""
        from clalign.correspondence import finite_or_none
        from clalign.geometry.cache import ShapeCache

        start = time.perf_counter()
        result = uninterrupted(self.correspondence(pair, ShapeCache()))
        seconds = time.perf_counter() - start
        return Outcome(
            target_of_source=result.target_of_source,
            seconds=seconds,
            stages=result.timings,
            confidence=finite_or_none(result.confidence),
            orientation=finite_or_none(result.orientation),
            barycentric=result.barycentric,
        )


def _with_signs_of(source: Shape, target: Shape, source_of_target: NDArray[np.int64]) -> Shape:
    """Return the source with eigenfunctions of the signs that make the diagonal of a map's C̃ positive."""
    import numpy as np

    from clalign.evaluation.spectral import true_rotation

    count = min(source.scale_invariant.count, target.scale_invariant.count)
    rotation = true_rotation(source.scale_invariant.functions[:, :count], target.scale_invariant, source_of_target)
    signs = np.where(np.diagonal(rotation) < 0, -1.0, 1.0)
    return replace(source, scale_invariant=source.scale_invariant.head(count, signs))


def uninterrupted(result: Correspondence) -> Correspondence:
    """Return a result, or raise KeyboardInterrupt if Ctrl-C cut it short: what is measured must be whole."""
    if result.interrupted:
        raise KeyboardInterrupt
    return result


def split_list(text: str) -> list[str]:
    """Return the entries of a comma-separated list; values that hold commas themselves stand in brackets."""
    return [entry.strip() for entry in _COMMA.split(text)]


def align_method(text: str, changes: Mapping[str, Any]) -> AlignMethod:
    """Return a method of ours.

    Parameters
    ----------
    text : as of the module.
    changes : to options that the text does not change itself.

    Raises
    ------
    OptionError
        No such base or option.
    """
    head, *own = _BEFORE_CHANGE.split(text)
    name, _, base = head.rpartition("=")
    if base not in NAMED or base == "pyfm":
        raise OptionError(
            f"unknown method {base!r}; there are {', '.join(NAMED)}, and each of ours with options of its own, such as "
            "name=default+alignment.weight=50"
        )
    preset, *given = _BEFORE_CHANGE.split(NAMED[base][0])
    merged = {**changes, **dict(change.split("=", 1) for change in (*given, *own))}
    truth = merged.pop("truth", "")
    if truth not in get_args(FromTruth):
        raise OptionError(f"truth={truth} in {text!r}: there are {', '.join(get_args(FromTruth)[1:])}")
    return AlignMethod(name or text, Options.preset(preset).replace(merged), truth)


def named_methods(texts: Sequence[str], changes: Mapping[str, Any]) -> list[Method]:
    """Return methods by their texts; `changes` to options apply to all of ours.

    Raises
    ------
    OptionError
        No such method or option.
    """
    from clalign.benchmark.peers import PyfmMethod

    return [PyfmMethod() if text == "pyfm" else align_method(text, changes) for text in texts]


def method_label(text: str) -> str:
    """Return what figures call a method."""
    return NAMED[text][1] if text in NAMED else text.partition("+")[0].rpartition("=")[0] or text


def method_runs(
    pair: LoadedPair,
    changes: Mapping[str, Any],
    *,
    cache: ShapeCache | None = None,
    watch: Watch | None = None,
    known: Mapping[str, Correspondence] | None = None,
) -> MethodRuns:
    """Return a function from the text of a method to its match of one pair, computed when it is first asked for.

    Warnings of a match are not raised, since a variant is expected to fail here and there; they are in the result.

    Parameters
    ----------
    pair : what is matched.
    changes : options changed in every method.
    cache : keeps what is computed of a single shape between the methods.
    watch : called with the method that is about to run; returns its progress callback.
    known : matches that are there already.
    """
    done = dict(known or {})

    def result(text: str) -> Correspondence:
        if text not in done:
            method = align_method(text, changes)
            progress = None if watch is None else watch(text)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ClalignWarning)
                done[text] = uninterrupted(method.correspondence(pair, cache, progress))
        return done[text]

    return result


def digest(values: Mapping[str, Any]) -> str:
    """Return eight letters that tell settings apart."""
    text = json.dumps(values, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:8]
