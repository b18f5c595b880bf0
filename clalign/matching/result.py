"""From the last state of a match to its result."""

from __future__ import annotations

import importlib.metadata
import inspect
import platform
import warnings as python_warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clalign.correspondence import Alternative, Correspondence
from clalign.engine.backend import Backend
from clalign.errors import ClalignWarning, ConfidenceWarning
from clalign.geometry.shape import Shape
from clalign.maps.file_maps import file_maps
from clalign.maps.point_maps import PointMaps
from clalign.matching.state import MatchState, orientation_sign, required
from clalign.mesh.mesh import Mesh
from clalign.options import Options, odd_sizes
from clalign.refinement.landmarks import disagreement, kept_exactly
from clalign.refinement.relations import Relation, relation
from clalign.search.score import facing, over

PACKAGE = __name__.partition(".")[0]

NO_FINITE_VALUE = "the objective had no finite value, and the optimisation of R ended there; look at the picture"


def correspondence(state: MatchState, backend: Backend, options: Options, timings: dict[str, float]) -> Correspondence:
    """Return the result of a match that went through all its stages, in the vertex numbering of the files.

    Parameters
    ----------
    options : as the user gave them.
    """
    source, target, found = state.source, state.target, state.found
    maps, aligned, functional_map = required(state.maps), required(state.aligned), required(state.functional_map)
    maps, landmarks = _with_landmarks(state, maps)
    size = len(functional_map)
    points = state.points
    relations = _relations(state)
    equally_good = _equally_good(state, relations)
    source_scale_invariant, target_scale_invariant = state.scale_invariant(required(state.start).signs)
    return Correspondence(
        source=source.mesh,
        target=target.mesh,
        **vars(file_maps(source.mesh, target.mesh, maps)),
        functional_map=functional_map,
        rotation=aligned.rotation,
        source_basis=source.basis.head(size),
        target_basis=target.basis.head(size),
        source_scale_invariant=source_scale_invariant,
        target_scale_invariant=target_scale_invariant,
        history=aligned.history,
        losses=aligned.losses,
        confidence=float("nan") if found is None else found.confidence,
        orientation=float("nan") if found is None else found.chosen.orientation,
        distortion=local_distortion(source, target, maps.target_of_source),
        alternatives=_alternatives(state, relations),
        timings=timings,
        landmarks=landmarks,
        warnings=(
            *_contradicted(landmarks),
            *_remarks(state, options),
            *_failures(state),
            *_doubts(state, options),
            *_said_of_equals(equally_good),
        ),
        equally_good=equally_good,
        device=backend.name,
        options=options,
        versions=versions(),
        source_faces=None if points is None else source.mesh.to_file(points.faces, -1),
        source_barycentric=None if points is None else source.mesh.to_file(points.barycentric, 0.0),
        score=float("nan") if found is None else found.chosen.score,
        xi=state.xi,
        status="interrupted" if state.interrupted else aligned.status,
    )


def _with_landmarks(state: MatchState, maps: PointMaps) -> tuple[PointMaps, tuple[dict[str, Any], ...]]:
    """Return the maps with what they agree with of the landmarks kept exactly, and what became of each landmark."""
    landmarks = state.landmarks
    if landmarks is None:
        return maps, ()
    off = disagreement(state.source, state.target, maps, landmarks)
    agreed = off <= state.options.rules.landmarks.contradicted + landmarks.tolerance
    source, target = state.source.mesh, state.target.mesh
    fates = tuple(
        {
            "name": name,
            "source": int(source.file_index[landmarks.source[number]]),
            "target": int(target.file_index[landmarks.target[number]]),
            "distance": float(off[number]),
            "used": bool(agreed[number]),
        }
        for number, name in enumerate(landmarks.names)
    )
    return maps if landmarks.tolerance > 0 else kept_exactly(maps, landmarks, agreed), fates


def _contradicted(landmarks: tuple[dict[str, Any], ...]) -> list[str]:
    return [
        f"landmark {each['name']} (source vertex {each['source']}, target vertex {each['target']}): the map sends it "
        f"{each['distance']:.2f} sqrt(area) away, and it was left aside; look at it, or at the others"
        for each in landmarks
        if not each["used"]
    ]


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


def _relations(state: MatchState) -> list[Relation]:
    """How each candidate of the search differs from the chosen one, of the best ones."""
    rules, found = state.options.rules.relations, state.found
    return [
        relation(
            state.source,
            required(found).chosen.functional,
            other.functional,
            reversing=other.orientation * required(found).chosen.orientation < 0,
            rules=rules,
        )
        for other in (() if found is None else found.alternatives[: rules.most])
    ]


def _equally_good(state: MatchState, relations: list[Relation]) -> tuple[dict[str, Any], ...]:
    """What is known of the candidates whose score is about that of the chosen one."""
    found, rules, exact = state.found, state.options.rules, state.options.rules.rivals
    if found is None:
        return ()
    equals = []
    for number, (other, how) in enumerate(zip(found.alternatives, relations, strict=False), start=1):
        as_good = over(other.score, found.chosen.score) <= rules.relations.equal
        # Scores of exact copies are rounding, and cannot be compared.
        as_good |= found.chosen.score < exact.exact and other.score <= exact.resolution
        passes = facing(np.array(other.orientation), orientation_sign(state.options)) > rules.search.least_orientation
        if as_good and passes:
            equals.append(
                {
                    "relation": how.words(rules.relations),
                    "reversing": how.reversing,
                    "order": how.order,
                    "moved": how.moved,
                    "alternative": number if number <= len(state.alternatives) else None,
                }
            )
    return tuple(equals)


def _said_of_equals(equals: tuple[dict[str, Any], ...]) -> list[str]:
    if not equals:
        return []
    one = len(equals) == 1
    kept = [str(each["alternative"]) for each in equals if each["alternative"] is not None]
    way = (
        f"start from it with --start RESULT --start-map {' or '.join(kept)}"
        if kept
        else f"keep {'it' if one else 'them'} with --alternatives {len(equals)}"
    )
    listed = "; ".join(each["relation"] for each in equals)
    return [
        f"{len(equals)} other {'map is' if one else 'maps are'} about as good as the chosen one ({listed}): if another "
        f"is meant, give a landmark with --landmarks, or {way}"
    ]


def _alternatives(state: MatchState, relations: list[Relation]) -> tuple[Alternative, ...]:
    if state.found is None:
        return ()
    source, target = state.source.mesh, state.target.mesh
    return tuple(
        Alternative(
            **vars(file_maps(source, target, maps)),
            score=candidate.score,
            orientation=candidate.orientation,
            distance=candidate.distance,
            relation=how.words(state.options.rules.relations),
        )
        for maps, candidate, how in zip(state.alternatives, state.found.alternatives, relations, strict=False)
    )


def _remarks(state: MatchState, options: Options) -> list[str]:
    """Return what the user has done (Ctrl-C), asked for (more maps than there are) or can read in a mesh's notes."""
    remarks, count = [], len(state.alternatives)
    if state.interrupted:
        remarks.append("interrupted: what was left to do was cut short, and the best map so far was kept")
    elif state.found is not None and state.start_map is None and count < options.search.alternatives:
        found = f"only {count} different map{' was' if count == 1 else 's were'}"
        remarks.append(f"{found if count else 'no different map was'} found ({options.search.alternatives} asked for)")
    meshes = state.source.mesh, state.target.mesh
    return [*remarks, *odd_sizes(options, min(mesh.n_vertices for mesh in meshes)), *mesh_notes(*meshes)]


def mesh_notes(*meshes: Mesh) -> tuple[str, ...]:
    """Return what is to be said of each mesh, with its name."""
    return tuple(f"{mesh.name}: {note}" for mesh in meshes for note in mesh.notes)


def _failures(state: MatchState) -> list[str]:
    return [NO_FINITE_VALUE] if required(state.aligned).status == "failed" else []


def warn_of_doubts(state: MatchState, options: Options, landmarks: tuple[dict[str, Any], ...] = ()) -> None:
    """Raise as Python warnings what puts the map itself in doubt.

    A low confidence or orientation, a map that was not searched for, an objective without a finite value.
    """
    for texts, category in (
        ([*_failures(state), *_contradicted(landmarks)], ClalignWarning),
        (_doubts(state, options), ConfidenceWarning),
    ):
        raise_warnings(texts, category)


def raise_warnings(texts: Sequence[str], category: type[ClalignWarning]) -> None:
    """Raise some texts as Python warnings of the line outside this package that asked for a match."""
    for text in texts:
        python_warnings.warn(text, category, stacklevel=_users_level())


def _doubts(state: MatchState, options: Options) -> list[str]:
    if state.found is None:
        return ["no search was made (search.method=random), so the map may be mirrored or wrong"]
    found, least = state.found, options.rules.judgement.low_orientation
    return doubts(found.chosen.orientation, found.confidence, least, options, alternatives=bool(state.alternatives))


def doubts(orientation: float, confidence: float, least: float, options: Options, *, alternatives: bool) -> list[str]:
    """Return what puts a map in doubt.

    Parameters
    ----------
    orientation, confidence : of the map.
    least : orientation below which there is doubt.
    options : the orientation that was asked for, and the confidence below which there is doubt.
    alternatives : whether the result has some.
    """
    said = []
    wanted = facing(np.array(orientation), orientation_sign(options))
    if wanted < -least:
        said.append(
            f"orientation {orientation:+.2f}: against --orientation {options.search.orientation} the map is "
            f"{'mirrored' if orientation < 0 else 'not mirrored'}; no other was found to pass"
        )
    elif wanted < least:
        said.append(
            f"orientation {orientation:+.2f}: parts of the map are turned inside out; one shape may be a "
            "part of the other, mirrored, or too different; look at the page"
        )
    if confidence < options.rules.judgement.low_confidence:
        way = "see the alternatives on the page" if alternatives else "ask for --alternatives 3 to see the alternatives"
        said.append(
            f"low confidence ({confidence:.2f}): a different map explains the shapes almost as well; "
            f"look at the picture, and {way}"
        )
    return said


def _users_level() -> int:
    """Return the level, for a warning of the calling function, of the innermost line outside this package.

    It is the user's own, whichever of the package's functions that was called by.
    """
    level, frame = 0, inspect.currentframe()
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] == PACKAGE:
        level, frame = level + 1, frame.f_back
    return level


def versions() -> dict[str, str]:
    """Return the versions of Python, of this package and of those that it computes with."""
    found = {"python": platform.python_version()}
    for name in ("clalign", "numpy", "scipy", "trimesh", "pyopencl", "nlopt", "potpourri3d"):
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "not installed as a package"
    return found
