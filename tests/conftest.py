"""Caches of their own for every test session, and meshes that several rooms use."""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import fabricated
import hypothesis
import numpy as np
import pytest
import shapes
import skips
from numpy.typing import NDArray
from shapes import Pair
from skips import pytest_make_collect_report, pytest_runtest_makereport  # noqa: F401 (hooks are found by name)

if TYPE_CHECKING:
    from prepared import Bound, PreparedPair

    from clalign.correspondence import Correspondence
    from clalign.engine import Backend, Reference

# A busy machine is no reason to fail.
hypothesis.settings.register_profile("any pace", deadline=None)
hypothesis.settings.load_profile("any pace")

# Set before any driver or library reads them: a test must neither profit from nor harm what is cached on the machine.
_SCRATCH = Path(tempfile.mkdtemp(prefix="clalign-tests-"))
os.environ["POCL_CACHE_DIR"] = str(_SCRATCH / "pocl")
os.environ["CLALIGN_CACHE"] = str(_SCRATCH / "cache")
os.environ["XDG_CACHE_HOME"] = str(_SCRATCH / "xdg")
os.environ.pop("CLALIGN_DEVICE", None)
os.environ.pop("CLALIGN_DEBUG", None)
(_SCRATCH / "pocl").mkdir()

# A shell that starts the tests in the background has Ctrl-C ignored, and so would every program that they start.
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_unconfigure() -> None:
    shutil.rmtree(_SCRATCH, ignore_errors=True)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20261122)


@pytest.fixture(scope="session")
def bumpy() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Sphere with bumps, 642 vertices, no symmetry."""
    return shapes.bumpy_sphere(3)


@pytest.fixture(scope="session")
def bumpy_pair() -> Pair:
    """The bumpy sphere and a slightly bent copy of it, each numbered in its own order."""
    vertices, faces = shapes.bumpy_sphere(3)
    source_vertices, source_faces, source_of_old = shapes.renumbered(vertices, faces, 1)
    target_vertices, target_faces, target_of_old = shapes.renumbered(shapes.bent(vertices, 0.15), faces, 2)
    truth = target_of_old[np.argsort(source_of_old)]
    return Pair((source_vertices, source_faces), (target_vertices, target_faces), truth)


@pytest.fixture(scope="session")
def human_pair() -> Pair:
    """The bundled pair at 1,500 vertices, each mesh numbered in its own order."""
    from clalign.data import bundled_pair
    from clalign.mesh.mesh import load_mesh

    paths = bundled_pair()
    source, target = load_mesh(paths.source), load_mesh(paths.target)
    truth, mirrored = (np.loadtxt(path, dtype=np.int64) for path in (paths.truth, paths.mirrored))
    kept, faces = shapes.decimated(source.vertices, source.faces.astype(np.int64), 1500)
    source_vertices, source_faces, source_of_kept = shapes.renumbered(source.vertices[kept], faces, 3)
    target_vertices, target_faces, target_of_kept = shapes.renumbered(target.vertices[truth[kept]], faces, 4)
    nearest = ((target.vertices[mirrored[kept]][:, None] - target.vertices[truth[kept]][None]) ** 2).sum(-1).argmin(1)
    kept_of_source = np.argsort(source_of_kept)
    return Pair(
        (source_vertices, source_faces),
        (target_vertices, target_faces),
        target_of_kept[kept_of_source],
        target_of_kept[nearest[kept_of_source]],
    )


@pytest.fixture
def bumpy_files(tmp_path: Path, bumpy_pair: Pair) -> tuple[Path, Path, Path]:
    """OFF files of `bumpy_pair` and the text file of its truth."""
    source = shapes.write_off(tmp_path / "bumpy-source.off", *bumpy_pair.source)
    target = shapes.write_off(tmp_path / "bumpy-target.off", *bumpy_pair.target)
    truth = tmp_path / "truth.txt"
    np.savetxt(truth, bumpy_pair.truth, fmt="%d")
    return source, target, truth


@pytest.fixture(scope="session")
def true_correspondence(bumpy_pair: Pair) -> Correspondence:
    """The result that a perfect matcher would return for `bumpy_pair`, built from its truth."""
    return fabricated.correspondence(bumpy_pair.source, bumpy_pair.target, bumpy_pair.truth)


@pytest.fixture(scope="session")
def small() -> PreparedPair:
    """162 vertices each, 16 LBO functions, 20 scale-invariant eigenfunctions."""
    import prepared

    return prepared.prepared_pair(prepared.tiny_pair(), prepared.SMALL)


@pytest.fixture(scope="session")
def middle(bumpy_pair: Pair) -> PreparedPair:
    """642 vertices each, 60 LBO functions, 60 scale-invariant eigenfunctions."""
    import prepared

    return prepared.prepared_pair(bumpy_pair, prepared.MIDDLE)


@pytest.fixture(scope="session")
def opencl() -> None:
    """For tests that need an OpenCL device, of whatever kind: skips them where there is none."""
    if skips.backend() != "opencl":
        pytest.skip("there is no OpenCL device")


@pytest.fixture(scope="session")
def kernels(opencl: None) -> Backend:
    from clalign.engine import open_backend

    return open_backend()


@pytest.fixture(scope="session")
def bind_small(small: PreparedPair) -> Callable[..., Bound]:
    """``bind_small(changes, backend=None, dense=False)``: the small pair bound with some options changed."""
    import prepared

    def make(changes: dict[str, Any] | None = None, backend: Backend | None = None, *, dense: bool = False) -> Bound:
        return prepared.bound(small, prepared.SMALL.replace(changes or {}), backend, dense=dense)

    return make


@pytest.fixture
def reference() -> Reference:
    from clalign.engine import Reference

    return Reference()
