"""The tasks of a collection, as they run on the workers, and what a worker keeps between them.

It keeps its device, a few prepared shapes and its own compiled kernels. What goes wrong becomes a row that says so.
"""

from __future__ import annotations

import logging
import math
import os
import socket
import sys
import threading
import time
import warnings
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from clalign.alignment.band import funnel_band
from clalign.alignment.rotation import least_squares_start
from clalign.collection.members import Member
from clalign.collection.store import RESULT_FOLDER, Kind, PairMaps, PairRow, ShapeRow, Store, pair_key, subfolder_of
from clalign.correspondence import Correspondence, finite_or_none
from clalign.engine import open_backend
from clalign.engine.backend import Backend
from clalign.errors import ClalignError
from clalign.geometry.cache import ShapeCache
from clalign.geometry.shape import Shape, equally_smoothed, prepare
from clalign.maps.file_maps import file_maps
from clalign.maps.functional_maps import two_way_functional_map
from clalign.maps.point_maps import PointMaps
from clalign.matching.loop import Clock
from clalign.matching.pair import match_shapes
from clalign.matching.result import local_distortion, mesh_notes, versions
from clalign.matching.stages import joint_after, refined_maps, steps_before_alignment
from clalign.matching.state import aligned_count
from clalign.mesh.mesh import Mesh, load_mesh
from clalign.options import Options
from clalign.refinement.zoomout import BoundSpectra, joint_step, two_way_steps
from clalign.storage.files import claim_kernel_folder

try:
    import resource
except ImportError:  # Windows: the peak is then not recorded
    resource = None  # type: ignore[assignment]

logger = logging.getLogger(__name__)

EIGENVALUES = 30
"""Eigenvalues by which shapes are compared to choose the middle of a star and the branches of a tree."""

HELD_SHAPES = 4
"""Prepared shapes that a worker keeps in memory: those of its pair, and two that a next pair may need."""

PageWriter = Callable[[Correspondence, Path], None]


@dataclass(frozen=True)
class Settings:
    """What every task of a collection needs to know; small, as it travels with each of them.

    Attributes
    ----------
    folder : of the collection, on a file system that all workers see.
    options : of every match.
    cache : folder of the prepared shapes.
    cache_limit : its largest size in bytes.
    keep : "maps" stores maps and C of a pair, "full" the whole result besides.
    latent : functions in the stored C.
    pages : writes a pair's page into its folder; a function that can be pickled, or None.
    """

    folder: str
    options: Options
    cache: str
    cache_limit: int
    keep: str
    latent: int
    pages: PageWriter | None = None

    @property
    def store(self) -> Store:
        """The folder of the collection."""
        return Store(self.folder)


class Session:
    """The state of one thread of a worker; `loaded` counts the shapes that were not in its memory."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._cache = ShapeCache(settings.cache, settings.cache_limit)
        self._shapes: OrderedDict[str, Shape] = OrderedDict()
        self.loaded = 0

    @cached_property
    def backend(self) -> Backend:
        """The open device, opened when first asked for."""
        claim_kernel_folder()
        return open_backend(self.settings.options.engine)

    def shape(self, member: Member) -> Shape:
        """Return a prepared shape: from memory, else from the cache by the mesh's content, else computed."""
        held = self._shapes.pop(member.digest, None)
        if held is None:
            while len(self._shapes) >= HELD_SHAPES:
                self._shapes.popitem(last=False)
            self.loaded += 1
            held = prepare(self._mesh(member), self.settings.options, self._cache)
        self._shapes[member.digest] = held
        return held

    def _mesh(self, member: Member) -> Mesh:
        surface = self.settings.options.surface
        return load_mesh(member.path, strict=surface.strict, component=surface.component or None)

    def pair(self, source: Member, target: Member) -> tuple[Shape, Shape]:
        """Return two prepared shapes, both in the metric that the noisier one asks for."""
        return equally_smoothed(self.shape(source), self.shape(target), self.settings.options.spectrum, self._cache)


_threads = threading.local()


def session(settings: Settings) -> Session:
    """Return this thread's session; another collection than before starts a new one.

    BLAS is kept to one thread whatever the number of workers: its sums depend on the number, and maps shall not.
    """
    held: Session | None = getattr(_threads, "session", None)
    if held is None or held.settings != settings:
        threadpool_limits(1, user_api="blas")
        held = Session(settings)
        _threads.session = held
    return held


def prepare_member(member: Member, settings: Settings) -> ShapeRow:
    """Load and prepare a shape, so that the cache has it; returns a row, "failed" when it is of no use."""
    started = time.perf_counter()
    try:
        shape = session(settings).shape(member)
    except Exception as error:
        logger.debug("%s", member.path, exc_info=True)
        return ShapeRow(member.name, member.path, "failed", explained(error))
    values = shape.basis.eigenvalues[1 : EIGENVALUES + 1]
    return ShapeRow(
        member.name,
        member.path,
        vertices=shape.mesh.n_vertices,
        faces=shape.mesh.n_faces,
        seconds=time.perf_counter() - started,
        notes=" | ".join(shape.mesh.notes),
        eigenvalues=tuple(float(value) for value in values),
    )


def match_members(source: Member, target: Member, prepared: tuple[ShapeRow, ShapeRow], settings: Settings) -> PairRow:
    """Match a pair and write its folder; a folder that is there already is not computed again.

    Parameters
    ----------
    prepared : rows of both shapes; the graph's edge from shapes to pairs.
    """
    for row in prepared:
        if not row.ok:
            # Not tried, as a shape of the pair is of no use.
            return PairRow(source.name, target.name, status="skipped", message=f"{row.name}: {row.message}")

    def work() -> Correspondence:
        here = session(settings)
        return match_shapes(*here.pair(source, target), here.backend, settings.options, Clock())

    return _finished_pair(source, target, "direct", pair_key(source, target, settings.options), work, settings)


def derive_members(
    source: Member,
    target: Member,
    functional: NDArray[np.float64],
    direct: float | None,
    network: str,
    settings: Settings,
) -> PairRow:
    """Make the maps of a pair from the network's functional map and write their folder.

    Parameters
    ----------
    functional : (L, L) of the network.
    direct : distortion of the map that was matched; None where there is none.
    network : short text that differs when the network does.
    """

    def work() -> Correspondence:
        here = session(settings)
        return derived_correspondence(*here.pair(source, target), functional, here.backend, settings.options)

    kind: Kind = "derived" if direct is None else "repaired"
    key = pair_key(source, target, settings.options, network)
    return _finished_pair(source, target, kind, key, work, settings)


def _finished_pair(
    source: Member, target: Member, kind: Kind, key: str, work: Callable[[], Correspondence], settings: Settings
) -> PairRow:
    subfolder = subfolder_of(kind)
    started = time.perf_counter()
    try:
        done = settings.store.finished(subfolder, source.name, target.name, key)
        if done is not None:
            return done
        loaded = session(settings).loaded
        with warnings.catch_warnings():
            # What there is to warn of is in the result and gets to the row.
            warnings.simplefilter("ignore")
            result = work()
        row = replace(
            _row(source, target, kind, result),
            seconds=time.perf_counter() - started,
            loaded=session(settings).loaded - loaded,
            peak_memory=_peak_memory(),
        )
        maps = pair_maps(result, settings.latent)

        def extras(folder: Path) -> None:
            if settings.keep == "full":
                result.save(folder / RESULT_FOLDER)
            if settings.pages is not None:
                settings.pages(result, folder)

        settings.store.write_pair(subfolder, row, key, maps, extras)
        return row
    except Exception as error:
        logger.debug("%s %s", source.name, target.name, exc_info=True)
        return PairRow(source.name, target.name, kind, "failed", explained(error), worker=_here())


def explained(error: Exception) -> str:
    """Return one line that says what went wrong."""
    text = str(error) if isinstance(error, ClalignError) else f"{type(error).__name__}: {error}"
    return " ".join(text.split())


def pair_maps(result: Correspondence, latent: int) -> PairMaps:
    """Return what is kept of a result: both maps, and C in the first `latent` LBO functions."""
    source, target = result.source, result.target
    maps = PointMaps(
        source.map_from_file(target, result.target_of_source), target.map_from_file(source, result.source_of_target)
    )
    size = min(latent, result.source_basis.count, result.target_basis.count)
    functional = two_way_functional_map(result.source_basis, result.target_basis, maps, size)
    return PairMaps(result.target_of_source.astype(np.int32), result.source_of_target.astype(np.int32), functional)


def _row(source: Member, target: Member, kind: Kind, result: Correspondence) -> PairRow:
    return PairRow(
        source.name,
        target.name,
        kind,
        confidence=finite_or_none(result.confidence) if kind == "direct" else None,
        orientation=finite_or_none(result.orientation),
        distortion=finite_or_none(float(result.source_basis.mass @ result.distortion / result.source_basis.mass.sum())),
        total=finite_or_none(result.losses.get("total")),
        align=finite_or_none(result.losses.get("align")),
        unsup=finite_or_none(result.losses.get("unsup")),
        stages=";".join(f"{name}={seconds:.3f}" for name, seconds in result.timings.items()),
        warnings=" | ".join(result.warnings),
        device=result.device,
        worker=_here(),
    )


def _peak_memory() -> int | None:
    if resource is None:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def _here() -> str:
    return f"{socket.gethostname()}:{os.getpid()}"


def derived_correspondence(
    source: Shape, target: Shape, functional: NDArray[np.float64], backend: Backend, options: Options
) -> Correspondence:
    """Return the correspondence that a functional map leads to: refined, with R and the read-out by least squares.

    Parameters
    ----------
    source, target : prepared with the same options, in one metric (`equally_smoothed`).
    functional : (L, L) orthogonal, from coefficients in the first LBO functions of the source to those of the target.
    """
    clock = Clock()
    with clock.stage("refinement"):
        maps = refined_maps(source, target, functional, options, backend)
    count = aligned_count(source, target, options)
    scale_invariant = source.scale_invariant.head(count), target.scale_invariant.head(count)
    with clock.stage("read-out"):
        # As many steps as a match makes before and after its optimisation.
        steps = steps_before_alignment(options) + options.readout.steps
        spectra = BoundSpectra.of(*scale_invariant, backend)
        maps = two_way_steps(spectra, maps, steps, (source.order, target.order), backend)
        if joint_after(options):
            maps, _ = joint_step(source, target, spectra, options.spectrum.refinement, maps, backend)
    with clock.stage("start of R"):
        band, one_sided = funnel_band(count, options.alignment), options.alignment.sides == "one"
        start = least_squares_start(*scale_invariant, maps, band, backend, one_sided=one_sided)
    return Correspondence(
        source=source.mesh,
        target=target.mesh,
        **vars(file_maps(source.mesh, target.mesh, maps)),
        functional_map=functional,
        rotation=start.rotation,
        source_basis=source.basis.head(max(len(functional), options.spectrum.basis)),
        target_basis=target.basis.head(max(len(functional), options.spectrum.basis)),
        source_scale_invariant=scale_invariant[0].head(count, start.signs),
        target_scale_invariant=scale_invariant[1],
        history=(),
        losses={},
        confidence=math.nan,
        orientation=math.nan,
        distortion=local_distortion(source, target, maps.target_of_source),
        alternatives=(),
        timings=clock.seconds,
        warnings=mesh_notes(source.mesh, target.mesh),
        device=backend.name,
        options=options,
        versions=versions(),
        xi=options.spectrum.xi,
        status="not run",
    )
