"""Matching two meshes: the one function that most users need."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import inspect
import logging
import platform
import warnings as python_warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.correspondence import INTERRUPTED, Alternative, Correspondence
from clalign.ctrl_c import plain_interrupts
from clalign.engine import open_backend
from clalign.engine.backend import Backend
from clalign.errors import ClalignWarning, ConfidenceWarning
from clalign.geometry.cache import ShapeCache
from clalign.geometry.shape import Shape, prepare_pair
from clalign.geometry.workers import single_threaded_blas
from clalign.matching.stages import AlignedPair, Clock, align_pair
from clalign.mesh.mesh import Mesh, as_mesh
from clalign.options import Options
from clalign.resources.forecast import require_memory

LOG = logging.getLogger(__name__)

PACKAGE = __name__.partition(".")[0]

NO_FINITE_VALUE = "the objective had no finite value, and the optimisation of R ended there; look at the picture"

LOW_CONFIDENCE = 0.15
"""A best different map whose score is within this share of the chosen one's is worth a warning."""

LOW_ORIENTATION = 0.9
"""An orientation nearer to zero is worth a warning: below are maps with parts turned inside out, as between half a body
and a whole one (0.4 to 0.7); near-isometries reach 0.95."""


def match(
    source: Any,
    target: Any,
    options: Options | None = None,
    *,
    progress: Callable[[str, float, str], None] | None = None,
    cache: ShapeCache | None = None,
) -> Correspondence:
    """Find for every vertex of each mesh its match on the other one.

    Parameters
    ----------
    source, target : a path, a ``trimesh.Trimesh``, a pair ``(vertices, faces)``, or a loaded `Mesh`; one connected
        manifold surface each.
    options : see `Options`; the default preset if None.
    progress : called as ``progress(stage, fraction, message)``, fraction in [0, 1] of the stage.
    cache : keeps what is computed of a single shape for later matches; None computes everything.

    Returns
    -------
    Correspondence
        Both maps in the vertex numbering of the input, the functional map C, R, and the aligned eigenfunctions. After
        Ctrl-C it is the best map so far, once the search has found one; `Correspondence.interrupted` says so.

    Raises
    ------
    MeshError
        A mesh cannot be read or has a defect that the method cannot work with; the message says what to do.
    MemoryBudgetError
        The match would not fit into memory; raised before anything is computed.
    DeviceError
        No usable OpenCL device (``engine.backend=reference`` needs none).
    """
    chosen = Options() if options is None else options
    clock = Clock(progress)
    with clock.stage("read"):
        meshes = as_mesh(source, "source"), as_mesh(target, "target")
    with clock.stage("device"):
        backend = open_backend(chosen.engine)
        device = backend.describe() if chosen.engine.backend == "opencl" else None
        require_memory(meshes[0].n_vertices, meshes[1].n_vertices, chosen, device)
    with clock.stage("prepare"):
        shapes = prepare_pair(*meshes, chosen, cache)
    return match_shapes(*shapes, backend, chosen, clock)


def match_shapes(
    source: Shape, target: Shape, backend: Backend, options: Options, clock: Clock | None = None
) -> Correspondence:
    """Match two prepared shapes on an open backend; see `match`.

    The host's small factorisations run on one thread: threads of BLAS that wait for work and threads of a CPU device
    would take the cores from each other.
    """
    clock = Clock() if clock is None else clock
    with single_threaded_blas(), np.errstate(over="ignore", under="ignore"):
        pair = align_pair(source, target, backend, options, clock)
    try:
        with plain_interrupts():
            return _correspondence(source, target, pair, backend, options)
    except KeyboardInterrupt:
        pair = dataclasses.replace(pair, alignment=dataclasses.replace(pair.alignment, status="interrupted"))
    with plain_interrupts():
        return _correspondence(source, target, pair, backend, options)


def _correspondence(
    source: Shape, target: Shape, pair: AlignedPair, backend: Backend, options: Options
) -> Correspondence:
    found = pair.search
    confidence = float("nan") if found is None else 1.0 - float(np.exp(-found.confidence))
    size, maps, points = len(pair.functional), pair.maps, pair.points
    return Correspondence(
        source=source.mesh,
        target=target.mesh,
        target_of_source=source.mesh.map_to_file(target.mesh, maps.target_of_source),
        source_of_target=target.mesh.map_to_file(source.mesh, maps.source_of_target),
        functional_map=pair.functional,
        rotation=pair.alignment.rotation,
        source_basis=source.basis.head(size),
        target_basis=target.basis.head(size),
        source_descriptors=pair.source_descriptors,
        target_descriptors=pair.target_descriptors,
        history=pair.alignment.history,
        losses=pair.alignment.losses,
        confidence=confidence,
        orientation=float("nan") if found is None else found.orientation,
        distortion=local_distortion(source, target, maps.target_of_source),
        alternatives=_alternatives(source, target, pair),
        timings=pair.timings,
        warnings=_warnings(source.mesh, target.mesh, pair, confidence, options.search.alternatives),
        device=backend.name,
        options=options,
        versions=_versions(),
        source_faces=None if points is None else source.mesh.to_file(points.faces, -1),
        source_barycentric=None if points is None else source.mesh.to_file(points.barycentric, 0.0),
        score=float("nan") if found is None else found.score,
    )


def local_distortion(source: Shape, target: Shape, target_of_source: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return for each source vertex the mean change of its distances to the farthest-point samples.

    Distances on the target come from its low-rank factors, good to about 0.5 % of the diameter.

    Returns
    -------
    (n_x,) float64, in units of sqrt(area).
    """
    rows = source.geodesics.rows
    samples = source.geodesics.samples[: len(rows)]
    weights = source.geodesics.sample_weights(len(rows))
    left = target.factors.left
    mapped = (left[target_of_source[samples]] @ target.factors.core) @ left.T
    return np.asarray(weights @ np.abs(rows - mapped[:, target_of_source]), dtype=np.float64)


def _alternatives(source: Shape, target: Shape, pair: AlignedPair) -> tuple[Alternative, ...]:
    if pair.search is None:
        return ()
    found = pair.search
    alternatives = []
    for number, maps in enumerate(pair.rivals):
        alternatives.append(
            Alternative(
                source.mesh.map_to_file(target.mesh, maps.target_of_source),
                target.mesh.map_to_file(source.mesh, maps.source_of_target),
                score=found.rival_scores[number],
                orientation=found.rival_orientations[number],
                distance=found.rival_distances[number],
            )
        )
    return tuple(alternatives)


def _warnings(source: Mesh, target: Mesh, pair: AlignedPair, confidence: float, alternatives: int) -> tuple[str, ...]:
    """Return what a user has to know; doubts about the map itself are raised as Python warnings, too.

    Those are a low confidence or orientation, a map that was not searched for, and an objective without a finite value.
    What the user has done (Ctrl-C), asked for (more maps than there are) or can read of a mesh in its notes is only
    returned.
    """
    messages = []
    if pair.alignment.status == "interrupted":
        messages.append(f"{INTERRUPTED}what was left to do was cut short, and the best map so far was kept")
    elif pair.search is not None and len(pair.rivals) < alternatives:
        found = f"only {len(pair.rivals)} different map{' was' if len(pair.rivals) == 1 else 's were'}"
        messages.append(f"{found if pair.rivals else 'no different map was'} found ({alternatives} asked for)")
    messages += [f"{mesh.name}: {note}" for mesh in (source, target) for note in mesh.notes]
    doubts = []
    if pair.search is not None and abs(pair.search.orientation) < LOW_ORIENTATION:
        doubts.append(
            f"orientation {pair.search.orientation:+.2f}: parts of the map are turned inside out; one shape may be a "
            "part of the other, mirrored, or too different; look at the page"
        )
    if pair.search is None:
        doubts.append("no search was made (search.method=random), so the map may be mirrored or wrong")
    elif confidence < LOW_CONFIDENCE:
        way = "see the rivals on the page" if pair.rivals else "ask for --alternatives 3 to see the rivals"
        doubts.append(
            f"low confidence ({confidence:.2f}): a different map explains the shapes almost as well; "
            f"look at the picture, and {way}"
        )
    failures = [NO_FINITE_VALUE] if pair.alignment.status == "failed" else []
    for texts, category in ((failures, ClalignWarning), (doubts, ConfidenceWarning)):
        for text in texts:
            python_warnings.warn(text, category, stacklevel=_users_level())
    return (*messages, *failures, *doubts)


def _users_level() -> int:
    """Return the level, for a warning of the calling function, of the innermost line outside this package.

    It is the user's own, whichever of the package's functions that was called by.
    """
    level, frame = 0, inspect.currentframe()
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] == PACKAGE:
        level, frame = level + 1, frame.f_back
    return level


def _versions() -> dict[str, str]:
    versions = {"python": platform.python_version()}
    for name in ("clalign", "numpy", "scipy", "trimesh", "pyopencl", "nlopt", "potpourri3d"):
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = "not installed as a package"
    return versions
