"""What a worker process keeps between tasks: its device, a few prepared shapes, and its own compiled kernels."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from threadpoolctl import threadpool_limits

from clalign.collection.members import Member
from clalign.collection.store import Store
from clalign.correspondence import Correspondence
from clalign.engine import open_backend
from clalign.engine.backend import Backend
from clalign.geometry.cache import ShapeCache
from clalign.geometry.shape import Shape, equally_smoothed, prepare
from clalign.mesh.mesh import load_mesh
from clalign.options import Options
from clalign.storage.files import claim_kernel_folder

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
        self._backend: Backend | None = None
        self._shapes: OrderedDict[str, Shape] = OrderedDict()
        self.loaded = 0

    @property
    def backend(self) -> Backend:
        """The open device, opened when first asked for."""
        if self._backend is None:
            claim_kernel_folder()
            self._backend = open_backend(self.settings.options.engine)
        return self._backend

    def shape(self, member: Member) -> Shape:
        """Return a prepared shape: from memory, else from the cache by the mesh's content, else computed."""
        held = self._shapes.pop(member.digest, None)
        if held is None:
            while len(self._shapes) >= HELD_SHAPES:
                self._shapes.popitem(last=False)
            self.loaded += 1
            held = prepare(load_mesh(member.path), self.settings.options, self._cache)
        self._shapes[member.digest] = held
        return held

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
