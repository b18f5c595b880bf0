"""The tasks of a collection, as they run on the workers. What goes wrong becomes a row that says so."""

from __future__ import annotations

import logging
import os
import socket
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clalign.collection.derive import derived_correspondence
from clalign.collection.members import Member
from clalign.collection.rows import Kind, PairRow, ShapeRow
from clalign.collection.session import Settings, session
from clalign.collection.store import RESULT_FOLDER, PairMaps, Subfolder, pair_key
from clalign.correspondence import Correspondence, finite_or_none
from clalign.errors import ClalignError
from clalign.maps.functional_maps import two_way_functional_map
from clalign.maps.point_maps import PointMaps
from clalign.matching.loop import Clock
from clalign.matching.pair import match_shapes

try:
    import resource
except ImportError:  # Windows: the peak is then not recorded
    resource = None  # type: ignore[assignment]

logger = logging.getLogger(__name__)

EIGENVALUES = 30
"""Eigenvalues by which shapes are compared to choose the middle of a star and the branches of a tree."""


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
    broken = [row for row in prepared if not row.ok]
    if broken:
        return skipped(source, target, broken[0])

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
    subfolder: Subfolder = "pairs" if kind == "direct" else "consistent"
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
        settings.store.write_pair(subfolder, row, key, maps, lambda folder: _extras(result, folder, settings))
        return row
    except Exception as error:
        logger.debug("%s %s", source.name, target.name, exc_info=True)
        return PairRow(source.name, target.name, kind, "failed", explained(error), worker=_here())


def skipped(source: Member, target: Member, broken: ShapeRow) -> PairRow:
    """Return the row of a pair that was not tried because a shape of it is of no use."""
    return PairRow(source.name, target.name, status="skipped", message=f"{broken.name}: {broken.message}")


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


def _extras(result: Correspondence, folder: Path, settings: Settings) -> None:
    if settings.keep == "full":
        result.save(folder / RESULT_FOLDER)
    if settings.pages is not None:
        settings.pages(result, folder)


def _peak_memory() -> int | None:
    if resource is None:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def _here() -> str:
    return f"{socket.gethostname()}:{os.getpid()}"
