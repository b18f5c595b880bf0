"""Choosing the exponent ξ of the scale-invariant metric for a pair, without ground truth."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from clalign.alignment.band import band_mask
from clalign.engine.backend import Backend
from clalign.engine.band import Band
from clalign.geometry.shape import Shape, with_scale_invariant
from clalign.maps.functional_maps import two_way_functional_map
from clalign.maps.point_maps import PointMaps
from clalign.options import SpectrumOptions
from clalign.rules import AlignmentRules

LOG = logging.getLogger(__name__)


def choose_metric(
    source: Shape,
    target: Shape,
    maps: PointMaps,
    band: Band,
    options: SpectrumOptions,
    rules: AlignmentRules,
    backend: Backend,
) -> tuple[Shape, Shape, float]:
    """Return both shapes with the eigenfunctions of the chosen ξ, and ξ.

    The more scale-invariant the metric, the better fine detail is told apart, and the less the eigenfunctions of two
    shapes that are not isometric span the same spaces. How much they do shows in the singular values of C̃ inside the
    funnel: the largest ξ is taken whose low quantile of them is large enough, the smallest if there is none.

    Parameters
    ----------
    source, target : with the eigenfunctions of the exponent that `options` names, as the metric "auto" prepares them.
    maps : a good map, from the LBO basis.
    band : the funnel.
    """
    for exponent in rules.exponents:
        chosen = replace(options, metric="power", xi=exponent)
        if exponent == options.xi:
            pair = source, target
        else:
            pair = (
                with_scale_invariant(source, chosen, smoothing=source.smoothing),
                with_scale_invariant(target, chosen, smoothing=target.smoothing),
            )
        size = min(band.size, pair[0].scale_invariant.count, pair[1].scale_invariant.count)
        functional = two_way_functional_map(pair[0].scale_invariant, pair[1].scale_invariant, maps, size, backend)
        values = np.linalg.svd(functional * band_mask(band)[:size, :size], compute_uv=False)
        quality = float(np.quantile(values, rules.quantile))
        LOG.info("xi = %g: singular value %.3f", exponent, quality)
        if quality >= rules.least_singular_value:
            break
    return *pair, exponent
