"""Pointwise fields that stand beside the eigenfunctions while a map is grown, and decide what the low ones leave open.

Which way a thin part (an arm, a hand) is turned about its axis shows only in functions of a wavelength below its girth,
and by then an arbitrary choice would have been made. Curvatures and heat kernel signatures decide it where the part
differs around its axis; where it has a mirror image of itself (a snout, a foot) they cannot, and orientation must.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from clalign.geometry.operators import orientation_products
from clalign.geometry.shape import Shape
from clalign.maps.functional_maps import orthogonalised

Kind = Literal["curvatures", "signatures", "oriented"]

LARGEST_FIELD = 3.0
"""Fields are cut at so many standard deviations."""
ORIENTED_FUNCTIONS = 8
"""Low functions whose products with each other and with the signatures are taken."""
ORIENTED_SIGNATURES = (1, 4)
"""Heat kernel signatures among them, by their place in `Shape.signatures`."""
ORIENTED_TIME = 5e-4
"""Diffusion time of the products, in units of area."""


def pointwise_fields(
    source: Shape, target: Shape, functional: NDArray[np.float64], kind: Kind
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return fields at all vertices of both shapes, (n_x, f) and (n_y, f), of variance about 1 and cut at 3.

    Parameters
    ----------
    functional : (k, k), the map as far as it is known; only "oriented" reads it.
    kind : "curvatures", smoothed mean and Gaussian curvature; "signatures", with logarithms of the heat kernel
        signature; "oriented", see `oriented_fields`.
    """
    if kind == "oriented":
        return oriented_fields(source, target, functional)
    return _intrinsic_fields(source, kind == "signatures"), _intrinsic_fields(target, kind == "signatures")


def oriented_fields(
    source: Shape, target: Shape, functional: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return n · (∇f × ∇g) for pairs of functions that the map carries along.

    The functions are the lowest eigenfunctions φ_a of the source with what the map makes of them on the target, and two
    heat kernel signatures. Under an isometry that keeps the orientation the fields of both shapes are the same; on a
    part that is its own mirror image they have opposite signs on its two halves, unlike everything that distances
    know of. A map that reverses the orientation as a whole gets the fields of the target with the other sign.
    """
    low = min(ORIENTED_FUNCTIONS, len(functional))
    size = len(functional)
    carried = target.basis.functions[:, :size] @ orthogonalised(functional)[:, 1:low]
    signatures = list(ORIENTED_SIGNATURES)
    own = (
        np.concatenate([source.signatures[:, signatures], source.basis.functions[:, 1:low]], axis=1),
        np.concatenate([target.signatures[:, signatures], carried], axis=1),
    )
    first, second = np.triu_indices(own[0].shape[1], 1)
    fields, coefficients = [], []
    for shape, functions in zip((source, target), own, strict=True):
        products = orientation_products(shape.mesh.faces, shape.mass, functions, first, second)
        coefficients.append(shape.basis.coefficients(products))
        fields.append(shape.basis.diffused(coefficients[-1], ORIENTED_TIME))
    agreement = np.sum((functional @ coefficients[0][:size]) * coefficients[1][:size])
    spread = np.sqrt(0.5 * sum(shape.mass @ each**2 for shape, each in zip((source, target), fields, strict=True)))
    scales = 1.0 / np.maximum(spread, 1e-12), (-1.0 if agreement < 0 else 1.0) / np.maximum(spread, 1e-12)
    x, y = (np.clip(each * scale, -LARGEST_FIELD, LARGEST_FIELD) for each, scale in zip(fields, scales, strict=True))
    return x, y


def _intrinsic_fields(shape: Shape, signatures: bool) -> NDArray[np.float64]:
    fields = np.concatenate([shape.curvatures, shape.signatures], axis=1) if signatures else shape.curvatures
    centred = fields - shape.mass @ fields
    spread = np.sqrt(shape.mass @ centred**2)
    return np.clip(centred / np.maximum(spread, 1e-12), -LARGEST_FIELD, LARGEST_FIELD)
