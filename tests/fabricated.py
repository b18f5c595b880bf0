"""Results made from a known truth, for tests of what is done with results."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clalign.correspondence import Alternative, Correspondence
from clalign.geometry import operators
from clalign.geometry.spectra import Spectrum, solve
from clalign.mesh.mesh import Mesh, mesh_from_arrays
from clalign.options import Options

Arrays = tuple[NDArray[np.float64], NDArray[np.int64]]

FUNCTIONS = 12


def correspondence(source: Arrays, target: Arrays, truth: NDArray[np.int64]) -> Correspondence:
    """Return a complete result whose maps are the truth; LBO functions stand in for the scale-invariant ones."""
    source_mesh, target_mesh = mesh_from_arrays(*source, name="source"), mesh_from_arrays(*target, name="target")
    source_basis, target_basis = _basis(source_mesh), _basis(target_mesh)
    pulled = target_basis.functions[truth]
    functional_map = np.linalg.lstsq(pulled, source_basis.functions, rcond=None)[0]
    left, _, right = np.linalg.svd(functional_map.T)
    signs = np.sign(np.diag(functional_map))
    backward = np.argsort(truth)
    rolled = np.roll(truth, 1)
    return Correspondence(
        source=source_mesh,
        target=target_mesh,
        target_of_source=truth,
        source_of_target=backward,
        functional_map=functional_map * signs,
        rotation=left @ right * signs[:, None],
        source_basis=replace(source_basis, functions=source_basis.functions * signs),
        target_basis=target_basis,
        source_descriptors=replace(source_basis, functions=source_basis.functions * signs),
        target_descriptors=target_basis,
        history=(
            {"round": 0.0, "evaluation": 0.0, "total": 3.0, "align": 1.0, "unsup": 0.01},
            {"round": 0.0, "evaluation": 1.0, "total": 2.5, "align": 0.9, "unsup": 0.008, "cycle": 0.5},
        ),
        losses={"total": 2.5, "align": 0.9, "unsup": 0.008, "cycle": float("nan")},
        confidence=0.75,
        orientation=0.98,
        distortion=np.linspace(0.0, 0.1, source_mesh.n_vertices),
        alternatives=(Alternative(rolled, np.argsort(rolled), 0.5, -0.25, 0.3),),
        timings={"source": 0.5, "target": 0.25},
        warnings=("a warning with an umlaut: ü",),
        device="none",
        options=Options().replace({"alignment.weight": 50.0, "seed": 7}),
        versions={"clalign": "0.0", "numpy": np.__version__},
        source_faces=np.arange(source_mesh.file_count) % target_mesh.n_faces,
        source_barycentric=np.full((source_mesh.file_count, 3), 1 / 3),
        score=0.4,
    )


def _basis(mesh: Mesh) -> Spectrum:
    mass = operators.lumped_mass(mesh.vertices, mesh.faces)
    return solve(operators.stiffness(mesh.vertices, mesh.faces), mass, FUNCTIONS)
