"""The correspondence of two shapes from a functional map that is known already: no search, no optimisation."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

import clalign
from clalign.alignment.band import funnel_band
from clalign.alignment.rotation import least_squares_start
from clalign.correspondence import Correspondence
from clalign.engine.backend import Backend
from clalign.geometry.shape import Shape, equally_smoothed
from clalign.matching.loop import Clock
from clalign.matching.result import local_distortion
from clalign.matching.stages import refined_maps, steps_before_alignment
from clalign.matching.state import aligned_count
from clalign.options import Options
from clalign.refinement.zoomout import BoundSpectra, two_way_steps


def derived_correspondence(
    source: Shape, target: Shape, functional: NDArray[np.float64], backend: Backend, options: Options
) -> Correspondence:
    """Return the correspondence that a functional map leads to: refined, with R and the read-out by least squares.

    Parameters
    ----------
    source, target : prepared with the same options.
    functional : (L, L) orthogonal, from coefficients in the first LBO functions of the source to those of the target.
    """
    clock = Clock()
    source, target = equally_smoothed(source, target, options.spectrum)
    with clock.stage("refinement"):
        maps = refined_maps(source, target, functional, options, backend)
    count = aligned_count(source, target, options)
    scale_invariant = source.scale_invariant.head(count), target.scale_invariant.head(count)
    with clock.stage("read-out"):
        # As many steps as a match makes before and after its optimisation.
        steps = steps_before_alignment(options) + options.readout.steps
        spectra = BoundSpectra.of(*scale_invariant, backend)
        maps = two_way_steps(spectra, maps, steps, (source.order, target.order), backend)
    with clock.stage("start of R"):
        band, one_sided = funnel_band(count, options.alignment), options.alignment.sides == "one"
        start = least_squares_start(*scale_invariant, maps, band, backend, one_sided=one_sided)
    return Correspondence(
        source=source.mesh,
        target=target.mesh,
        target_of_source=source.mesh.map_to_file(target.mesh, maps.target_of_source),
        source_of_target=target.mesh.map_to_file(source.mesh, maps.source_of_target),
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
        warnings=tuple(f"{mesh.name}: {note}" for mesh in (source.mesh, target.mesh) for note in mesh.notes),
        device=backend.name,
        options=options,
        versions={"clalign": clalign.__version__, "numpy": np.__version__},
    )
