"""The library pyFM on the same pairs, so that its figures stand beside ours. Not a dependency of the package."""

from __future__ import annotations

import contextlib
import io
import time
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from clalign.benchmark.methods import Outcome, digest
from clalign.benchmark.pairs import LoadedPair
from clalign.errors import InputError

INSTALL = "pip install pyfmaps==1.3.1"


@dataclass(frozen=True)
class PyfmMethod:
    """pyFM: wave kernel signatures, functional map with orientation term, ZoomOut, nearest neighbours.

    signatures : number of wave kernel signatures.
    orientation : weight of the orientation term; the other weights are pyFM's defaults.
    size : of the square functional map that is fitted.
    refined : size up to which ZoomOut takes it, in steps of `step`.
    """

    name: str = "pyFM"
    signatures: int = 100
    orientation: float = 0.1
    size: int = 30
    refined: int = 200
    step: int = 5

    @property
    def settings(self) -> str:
        """Version of pyFM and a digest of the values above."""
        return f"pyfm-{_pyfm_version()}-{digest(asdict(self))}"

    def __call__(self, pair: LoadedPair) -> Outcome:
        """Match one pair; pyFM's maps go from its second mesh to its first, so the target is the first.

        Raises
        ------
        InputError
            pyFM is not installed.
        """
        _pyfm_version()
        from pyFM.functional import FunctionalMapping
        from pyFM.mesh import TriMesh

        start = time.perf_counter()
        first, second = (
            TriMesh(mesh.vertices.copy(), mesh.faces.astype(np.int64), area_normalize=True, center=True)
            for mesh in (pair.target, pair.source)
        )
        # Its optimiser and progress bars print; a benchmark's output is ours.
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            model = FunctionalMapping(first, second)
            model.preprocess(n_descr=self.signatures, descr_type="WKS", k_process=self.refined)
            prepared = time.perf_counter()
            model.fit(K=(self.size, self.size), w_orient=self.orientation)
            fitted = time.perf_counter()
            refined = model.zoomout_refine(nit=(self.refined - self.size) // self.step, step=self.step)
            target_of_source = np.asarray(model.get_p2p(refined), dtype=np.int64)
        end = time.perf_counter()
        index = pair.source.map_to_file(pair.target, target_of_source)
        stages = {"spectra": prepared - start, "fit": fitted - prepared, "zoomout": end - fitted}
        return Outcome(index, end - start, stages)


def _pyfm_version() -> str:
    try:
        return version("pyfmaps")
    except PackageNotFoundError as error:
        raise InputError(f"the comparison needs pyFM: {INSTALL}") from error
