"""Pointwise descriptors that stand beside the eigenfunctions in ZoomOut, and decide what the low ones leave open.

Which way a thin part (an arm, a hand) is turned about its axis shows only in functions of a wavelength below its girth,
and by then an arbitrary choice would have been made. Curvatures and heat kernel signatures decide it where the part
differs around its axis; where it has a mirror image of itself (a snout, a foot) they cannot, and orientation must.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clalign.geometry.operators import orientation_products
from clalign.geometry.shape import Shape
from clalign.maps.functional_maps import polar_factor
from clalign.rules import PointwiseKind, RefinementRules


def pointwise_descriptors(
    source: Shape, target: Shape, functional: NDArray[np.float64], kind: PointwiseKind, rules: RefinementRules
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return descriptors at all vertices of both shapes, (n_x, f) and (n_y, f), of variance about 1 and cut.

    Parameters
    ----------
    functional : (k, k), the map as far as it is known; only "oriented" reads it.
    kind : "curvatures", smoothed mean and Gaussian curvature; "signatures", with logarithms of the heat kernel
        signature; "oriented", see `oriented_descriptors`.
    """
    if kind == "oriented":
        return oriented_descriptors(source, target, functional, rules)
    largest = rules.largest_descriptor
    return _intrinsic(source, kind == "signatures", largest), _intrinsic(target, kind == "signatures", largest)


def oriented_descriptors(
    source: Shape, target: Shape, functional: NDArray[np.float64], rules: RefinementRules
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return n · (∇f × ∇g) for pairs of functions that the map carries along.

    The functions are the lowest eigenfunctions φ_a of the source with what the map makes of them on the target, and two
    heat kernel signatures. Under an isometry that keeps the orientation the products on both shapes are the same; on a
    part that is its own mirror image they have opposite signs on its two halves, unlike everything that distances
    know of. A map that reverses the orientation as a whole gets the products of the target with the other sign.
    """
    low = min(rules.oriented_functions, len(functional))
    size = len(functional)
    carried = target.basis.functions[:, :size] @ polar_factor(functional)[:, 1:low]
    signatures = list(rules.oriented_signatures)
    own = (
        np.concatenate([source.signatures[:, signatures], source.basis.functions[:, 1:low]], axis=1),
        np.concatenate([target.signatures[:, signatures], carried], axis=1),
    )
    first, second = np.triu_indices(own[0].shape[1], 1)
    products, coefficients = [], []
    for shape, functions in zip((source, target), own, strict=True):
        values = orientation_products(shape.mesh.faces, shape.mass, functions, first, second)
        coefficients.append(shape.basis.coefficients(values))
        products.append(shape.basis.diffused(coefficients[-1], rules.oriented_time))
    agreement = np.sum((functional @ coefficients[0][:size]) * coefficients[1][:size])
    spread = np.sqrt(0.5 * sum(shape.mass @ each**2 for shape, each in zip((source, target), products, strict=True)))
    scales = 1.0 / np.maximum(spread, 1e-12), (-1.0 if agreement < 0 else 1.0) / np.maximum(spread, 1e-12)
    largest = rules.largest_descriptor
    x, y = (np.clip(each * scale, -largest, largest) for each, scale in zip(products, scales, strict=True))
    return x, y


def _intrinsic(shape: Shape, signatures: bool, largest: float) -> NDArray[np.float64]:
    values = np.concatenate([shape.curvatures, shape.signatures], axis=1) if signatures else shape.curvatures
    centred = values - shape.mass @ values
    spread = np.sqrt(shape.mass @ centred**2)
    return np.clip(centred / np.maximum(spread, 1e-12), -largest, largest)
