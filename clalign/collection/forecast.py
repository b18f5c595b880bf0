"""What a collection will need, in memory and on disk, said before the work starts."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from clalign.collection.members import Member
from clalign.collection.work import HELD_SHAPES
from clalign.errors import MemoryBudgetError, MeshError, ResultError
from clalign.mesh.mesh import load_mesh
from clalign.options import Options, SurfaceOptions
from clalign.resources import available_memory, forecast
from clalign.storage.files import size_text

DASK_BYTES = 250e6
"""Of a worker process, beside what a single match takes: Dask, and what the allocator keeps from earlier pairs."""

PAGE_BYTES, PAGE_BYTES_PER_VERTEX = 1.1e6, 45.0
"""Of a pair's page: library and picture, then positions, faces, maps and a few functions of both shapes."""


@dataclass(frozen=True)
class Needs:
    """Bytes that a collection needs at most.

    Attributes
    ----------
    cache : all prepared shapes, each as large in memory.
    pairs : what is kept of all pairs.
    worker : memory of one worker process.
    """

    cache: float
    pairs: float
    worker: float

    def text(self, workers: int) -> str:
        """Return one line for people."""
        return (
            f"about {size_text(self.worker)} of memory in each of {workers} worker{'s' if workers > 1 else ''}, "
            f"at most {size_text(self.cache)} of disk for the prepared shapes and {size_text(self.pairs)} for the pairs"
        )


def needs(members: Sequence[Member], pairs: int, options: Options, *, keep: str, latent: int, pages: bool) -> Needs:
    """Predict from the largest mesh file, taking the others to have vertices in proportion to their files.

    Raises
    ------
    MeshError
        No mesh of the collection can be loaded.
    """
    largest, vertices = _largest(members, options.surface)
    share = [min(1.0, member.size / largest.size) for member in members]
    mean = sum(share) / len(share) * vertices
    pair = 2 * 4 * mean + 8 * latent**2 + 4096
    if pages:
        pair += PAGE_BYTES + 2 * PAGE_BYTES_PER_VERTEX * mean
    if keep == "full":
        pair += 2 * mean * (4 * (options.spectrum.basis + options.spectrum.scale_invariant) + 64)
        pair += 8 * (options.spectrum.scale_invariant**2 + options.spectrum.basis**2)
    return Needs(
        cache=sum(shape_bytes(vertices * part, options) for part in share),
        pairs=pair * pairs,
        worker=DASK_BYTES
        + forecast(vertices, vertices, options).memory
        + (HELD_SHAPES - 2) * shape_bytes(vertices, options),
    )


def shape_bytes(vertices: float, options: Options) -> float:
    """Return the bytes of a prepared shape: spectra in double precision, distances of the samples."""
    functions = max(options.spectrum.basis, options.spectrum.refinement) + options.spectrum.scale_invariant
    samples = min(options.geodesics.search_samples, vertices)
    return vertices * (8 * functions + 4 * options.geodesics.factor_samples + 16) + 8 * samples**2


def _largest(members: Sequence[Member], surface: SurfaceOptions) -> tuple[Member, int]:
    reason = "no mesh file can be read"
    for member in sorted(members, key=lambda member: -member.size):
        if member.size:
            try:
                return member, load_mesh(member.path, component=surface.component or None).n_vertices
            except MeshError as error:
                reason = str(error)
    raise MeshError(f"no mesh of the collection can be used; the last reason: {reason}")


def check_disk(needed: float, folder: Path) -> None:
    """Refuse a collection that the disk has no room for.

    Raises
    ------
    ResultError
        With the ways to need less.
    """
    free = shutil.disk_usage(folder).free
    if needed > free:
        raise ResultError(
            f"{folder}: needs up to {size_text(needed)} and the disk has {size_text(free)} left; keep less "
            "(--keep maps, --no-report), bound the prepared shapes (--cache-limit), or choose another --out"
        )


def workers_that_fit(needed: float, wanted: int | None, processors: int) -> int:
    """Return the number of local workers: what is wanted, else one a processor as far as the memory allows.

    Raises
    ------
    MemoryBudgetError
        The memory is too small for what is wanted, or for a single worker.
    """
    free = available_memory()
    if free is None:
        return wanted or processors
    fitting = int(free // needed)
    if fitting < (wanted or 1):
        raise MemoryBudgetError(
            f"{wanted or 1} worker(s) need up to {size_text((wanted or 1) * needed)} of memory and {size_text(free)} "
            "are free; use fewer --workers, or fewer functions (--preset fast)"
        )
    return wanted or max(1, min(processors, fitting))
