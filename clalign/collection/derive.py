"""The correspondence of two shapes from a functional map that is known already: no search, no optimisation."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

import clalign
from clalign.alignment.band import funnel_band
from clalign.correspondence import Correspondence
from clalign.engine.backend import Backend
from clalign.geometry.shape import Shape, equally_smoothed
from clalign.matching.pair import local_distortion
from clalign.matching.stages import Clock, grown_maps, steps_before_alignment
from clalign.options import Options
from clalign.refinement.zoomout import closed_form_rotation, coherent_steps


def derived_correspondence(
    source: Shape, target: Shape, functional: NDArray[np.float64], backend: Backend, options: Options
) -> Correspondence:
    """Return the correspondence that a functional map leads to: up-sampled, with R and the read-out in closed form.

    Parameters
    ----------
    source, target : prepared with the same options.
    functional : (L, L) orthogonal, from coefficients in the first LBO functions of the source to those of the target.
    """
    clock = Clock()
    source, target = equally_smoothed(source, target, options.spectrum)
    with clock.stage("up-sampling"):
        maps = grown_maps(backend, source, target, functional, options)
    count = min(options.spectrum.descriptors, source.descriptors.count, target.descriptors.count)
    descriptors = source.descriptors.head(count), target.descriptors.head(count)
    with clock.stage("read-out"):
        # As many steps as a match makes before and after its optimisation.
        steps = steps_before_alignment(options) + options.readout.steps
        maps = coherent_steps(backend, *descriptors, maps, steps)
    with clock.stage("closed form"):
        band = funnel_band(count, options.alignment)
        start = closed_form_rotation(backend, *descriptors, maps, band, options.alignment.sides == "one")
    return Correspondence(
        source=source.mesh,
        target=target.mesh,
        target_of_source=source.mesh.map_to_file(target.mesh, maps.target_of_source),
        source_of_target=target.mesh.map_to_file(source.mesh, maps.source_of_target),
        functional_map=functional,
        rotation=start.rotation,
        source_basis=source.basis.head(max(len(functional), options.spectrum.basis)),
        target_basis=target.basis.head(max(len(functional), options.spectrum.basis)),
        source_descriptors=descriptors[0].head(count, start.signs),
        target_descriptors=descriptors[1],
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
