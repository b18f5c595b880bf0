"""Matching two meshes: the one function that most users need."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.correspondence import Correspondence
from clalign.ctrl_c import plain_interrupts
from clalign.engine import open_backend
from clalign.engine.backend import Backend
from clalign.errors import OptionError
from clalign.geometry.cache import ShapeCache, given_cache
from clalign.geometry.shape import Shape, prepare_pair
from clalign.geometry.workers import single_threaded_blas
from clalign.matching.loop import Clock, Progress, run_stages
from clalign.matching.parts import match_part, roles
from clalign.matching.result import correspondence, warn_of_doubts
from clalign.matching.start import starting_map
from clalign.matching.state import MatchState
from clalign.mesh.descriptors import DESCRIPTOR_WEIGHT, descriptors_of
from clalign.mesh.landmarks import Landmarks, landmarks_of
from clalign.mesh.mesh import as_mesh
from clalign.options import Options, given_options
from clalign.resources import require_memory


def match(
    source: Any,
    target: Any,
    options: Options | None = None,
    *,
    start: Any = None,
    landmarks: Any = None,
    landmark_tolerance: float = 0.0,
    descriptors: Any = None,
    descriptor_weight: float = DESCRIPTOR_WEIGHT,
    partial: str | None = None,
    progress: Progress | None = None,
    cache: ShapeCache | None = None,
) -> Correspondence:
    """Find for every vertex of each mesh its match on the other one.

    Parameters
    ----------
    source, target : a path, a ``trimesh.Trimesh``, a pair ``(vertices, faces)``, points (n, 3), or a loaded `Mesh`
        (which `load_mesh` makes of one of several pieces in a file).
    options : see `Options`; the default preset if None.
    start : a map to start from, or how the shapes lie in space, instead of a search; see
        `clalign.matching.start.starting_map`.
    landmarks : what is known: pairs of vertices (k, 2), two arrays of vertices or of points, or files; see
        `clalign.mesh.landmarks.landmarks_of`. They choose among candidate maps and, with three or more, start one;
        those that the final map agrees with are kept exactly, others are named in a warning.
    landmark_tolerance : how far landmarks may be off, in sqrt(area); above 0 none is kept exactly.
    descriptors : pointwise descriptors (F_x, F_y) of the user, (vertices of the file, columns); see
        `clalign.mesh.descriptors.descriptors_of`. They join the search's score, the refinement and the read-out.
    descriptor_weight : what their squared distances count, relative to those of the eigenfunctions.
    partial : which mesh is a part of the other, "source", "target", "none" or "auto", instead of what the options say;
        see `PartialOptions`.
    progress : called as ``progress(stage, fraction, message)``, fraction in [0, 1] of the stage.
    cache : keeps what is computed of a single shape for later matches; None computes everything.

    Returns
    -------
    Correspondence
        Both maps in the vertex numbering of the input, the functional map C, R, and the aligned eigenfunctions. After
        Ctrl-C it is the best map so far, once the search has found one; `Correspondence.interrupted` says so.

    Raises
    ------
    OptionError
        `options` or `cache` is something else, such as a name; `partial` comes with a start, landmarks or descriptors;
        or no step would look at the descriptors.
    InputError
        The start, the landmarks or the descriptors do not fit the meshes.
    MeshError
        A mesh cannot be read or has a defect that the method cannot work with; the message says what to do.
    MemoryBudgetError
        The match would not fit into memory; raised before anything is computed.
    DeviceError
        No usable OpenCL device (``engine.backend=reference`` needs none).
    """
    given = _Given(start, landmarks, landmark_tolerance, descriptors, descriptor_weight)
    chosen = given_options(options)
    chosen = given.checked(chosen if partial is None else chosen.replace({"partial.part": partial}))
    return _matched(source, target, chosen, given, Clock(progress), given_cache(cache))


@dataclass(frozen=True)
class _Given:
    """What a caller of `match` knows of the pair, as it came."""

    start: Any
    landmarks: Any
    tolerance: float
    descriptors: Any
    weight: float

    @property
    def nothing(self) -> bool:
        """Whether there is nothing."""
        return self.start is None and self.landmarks is None and self.descriptors is None

    def checked(self, options: Options) -> Options:
        """Return options under which all of it is looked at."""
        if options.partial.part in ("source", "target") and not self.nothing:
            raise OptionError(
                "a start, landmarks or descriptors cannot be given for a part yet: leave them out, or partial=none"
            )
        if self.descriptors is not None and options.search.method == "random" and not options.readout.steps:
            raise OptionError("descriptors have no part in search.method=random with readout.steps=0 (--preset paper)")
        return options


def _matched(
    source: Any, target: Any, options: Options, given: _Given, clock: Clock, cache: ShapeCache | None
) -> Correspondence:
    with clock.stage("read"):
        reading: dict[str, Any] = {"strict": options.surface.strict, "component": options.surface.component or None}
        meshes = as_mesh(source, "source", **reading), as_mesh(target, "target", **reading)
        start = None if given.start is None else starting_map(given.start, *meshes, options.rules.start)
        landmarks = None if given.landmarks is None else landmarks_of(given.landmarks, *meshes, given.tolerance)
        beside = None if given.descriptors is None else descriptors_of(given.descriptors, *meshes, given.weight)
    with clock.stage("device"):
        backend = open_backend(options.engine)
        device = backend.describe() if options.engine.backend == "opencl" else None
        require_memory(meshes[0].n_vertices, meshes[1].n_vertices, options, device)
    part = roles(*meshes, options) if given.nothing else None
    if part is not None:
        result = match_part(*meshes, part, backend, options, clock, cache)
        if result is not None:
            return result
    with clock.stage("prepare"):
        shapes = prepare_pair(*meshes, options, cache)
        if beside is not None:
            shapes = replace(shapes[0], given=beside[0]), replace(shapes[1], given=beside[1])
    return match_shapes(*shapes, backend, options, clock, landmarks=landmarks, start_map=start)


def match_shapes(
    source: Shape,
    target: Shape,
    backend: Backend,
    options: Options,
    clock: Clock | None = None,
    *,
    landmarks: Landmarks | None = None,
    start_map: NDArray[np.int64] | None = None,
) -> Correspondence:
    """Match two prepared shapes on an open backend; see `match`.

    The host's small factorisations run on one thread: threads of BLAS that wait for work and threads of a CPU device
    would take the cores from each other.
    """
    clock = Clock() if clock is None else clock
    state = MatchState(source, target, options, options.spectrum.xi, start_map=start_map, landmarks=landmarks)
    with single_threaded_blas(), np.errstate(over="ignore", under="ignore"):
        state = run_stages(state, backend, clock)
    try:
        with plain_interrupts():
            result = correspondence(state, backend, options, clock.seconds)
    except KeyboardInterrupt:
        state = state.cut_short()
        with plain_interrupts():
            result = correspondence(state, backend, options, clock.seconds)
    warn_of_doubts(state, options, result.landmarks)
    return result
