"""Choosing the exponent ξ of the scale-invariant metric for a pair, without ground truth."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from clalign.alignment.band import band_mask
from clalign.engine.backend import Backend
from clalign.engine.band import Band
from clalign.geometry.shape import Shape, with_descriptors
from clalign.maps.functional_maps import PointMaps, two_way_functional_map
from clalign.options import SpectrumOptions

LOG = logging.getLogger(__name__)

EXPONENTS = (0.5, 0.3, 0.15)
"""From the most to the least scale-invariant; outside this range the error grew on every pair tried."""
LEAST_SINGULAR_VALUE = 0.6
QUANTILE = 0.1


def choose_metric(
    backend: Backend, source: Shape, target: Shape, maps: PointMaps, band: Band, options: SpectrumOptions
) -> tuple[Shape, Shape, float]:
    """Return both shapes with the descriptors of the chosen ξ, and ξ.

    The more scale-invariant the metric, the better fine detail is told apart, and the less the eigenfunctions of two
    shapes that are not isometric span the same spaces. How much they do shows in the singular values of C̃ inside the
    funnel: the largest ξ is taken whose 10 % singular value is at least 0.6, the smallest if there is none.

    Parameters
    ----------
    source, target : with the descriptors of the exponent that `options` names, as the metric "auto" prepares them.
    maps : a good map, from the LBO basis.
    band : the funnel.
    """
    for exponent in EXPONENTS:
        chosen = replace(options, metric="power", xi=exponent)
        if exponent == options.xi:
            pair = source, target
        else:
            pair = (
                with_descriptors(source, chosen, smoothing=source.smoothing),
                with_descriptors(target, chosen, smoothing=target.smoothing),
            )
        size = min(band.size, pair[0].descriptors.count, pair[1].descriptors.count)
        functional = two_way_functional_map(backend, pair[0].descriptors, pair[1].descriptors, maps, size)
        values = np.linalg.svd(functional * band_mask(band)[:size, :size], compute_uv=False)
        quality = float(np.quantile(values, QUANTILE))
        LOG.info("xi = %g: 10 %% singular value %.3f", exponent, quality)
        if quality >= LEAST_SINGULAR_VALUE:
            break
    return *pair, exponent
